"""A point mass that has to find its way through three corridors to a goal it cannot see."""

from collections import deque
from functools import partial
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from deep_curiosity_envs.checks import check_flag
from deep_curiosity_envs.mujoco_task import Array, Array64, MujocoTask, load_spec
from deep_curiosity_envs.vector import MujocoVectorEnv

# Seen from above: S is the start, G the goal, # a wall.
MAZE = (
    "####################",
    "#S.................#",
    "#..................#",
    "#..................#",
    "#..................#",
    "#..................#",
    "###############....#",
    "#..................#",
    "#..................#",
    "#..................#",
    "#..................#",
    "#..................#",
    "#..................#",
    "#....###############",
    "#..................#",
    "#..................#",
    "#..................#",
    "#..................#",
    "#G.................#",
    "####################",
)
CELL_SIZE = 0.1  # m; the point, 6 cm wide, fits through every gap
WALL_HEIGHT = 0.05  # m above and below the middle of the point, which is thinner
GOAL_RADIUS = 0.2  # m; four control steps at full speed, so the point cannot jump over it
SPEED_SCALE = 1.0  # m/s; what full force reaches against the damping
SPEED_BOUND = 2.0  # in units of SPEED_SCALE
START_NOISE = 0.2  # of a cell

Cell = tuple[int, int]  # row from the top, column from the left


def find_cell(mark: str) -> Cell:
    """Cell of the maze that bears a mark."""
    row = next(row for row, line in enumerate(MAZE) if mark in line)
    return row, MAZE[row].index(mark)


def reachable_cells(start: Cell) -> dict[Cell, int]:
    """Free cells that can be reached from a cell, numbered by their distance from it."""
    index, frontier = {start: 0}, deque([start])
    while frontier:
        row, column = frontier.popleft()
        for cell in ((row, column + 1), (row + 1, column), (row, column - 1), (row - 1, column)):
            if MAZE[cell[0]][cell[1]] != "#" and cell not in index:
                index[cell] = len(index)
                frontier.append(cell)
    return index


def cell_centre(cell: Cell) -> tuple[float, float]:
    """Middle of a cell, in m to the right of and above the middle of the arena."""
    row, column = cell
    x = (column + 0.5 - len(MAZE[0]) / 2) * CELL_SIZE
    y = (len(MAZE) / 2 - row - 0.5) * CELL_SIZE
    return x, y


def cell_at(x: Array64, y: Array64) -> tuple[Array, Array]:
    """Rows and columns of the cells that hold points of the arena, coordinates in m."""
    row = np.floor(len(MAZE) / 2 - y / CELL_SIZE)
    column = np.floor(x / CELL_SIZE + len(MAZE[0]) / 2)
    return row.astype(int), column.astype(int)


def number_cells() -> NDArray[np.int64]:
    """Numbers of the cells by row and column, in order of distance from the start; walls -1."""
    number = np.full((len(MAZE), len(MAZE[0])), -1)
    for cell, index in reachable_cells(find_cell("S")).items():
        number[cell] = index
    return number


def maze_model() -> mujoco.MjModel:
    """The point's model with the maze's walls and goal in place."""
    spec = load_spec("point_maze.xml")
    half = CELL_SIZE / 2
    for row, line in enumerate(MAZE):
        for column, mark in enumerate(line):
            if mark == "#":
                spec.worldbody.add_geom(
                    name=f"wall_{row}_{column}",
                    type=mujoco.mjtGeom.mjGEOM_BOX,
                    pos=[*cell_centre((row, column)), 0.0],
                    size=[half, half, WALL_HEIGHT],
                )
    spec.site("goal").pos[:2] = cell_centre(find_cell("G"))
    spec.site("goal").size[0] = GOAL_RADIUS
    return spec.compile()


class PointMaze(MujocoTask):
    """Push a point through an S of three corridors, from its upper end to past the second bend.

    The point starts at rest in the top left corner. Every step in the goal, in the bottom left
    corner behind both walls, pays one; nothing else pays. At full force the way takes a third of
    an episode, and random pushes do not get there. Every `info` holds `cell`, the index in
    `range(num_cells)` of the cell the point is in, numbered by distance from the start.

    Observation: position in half arenas (1 m) to the right and up, and velocity in m/s.

    Args:
        action_cost: Reward lost per step at full force on both axes.
        goal_terminates: Whether the goal ends the episode, so that it pays only once.
        render_mode: `"rgb_array"` or None.

    Raises:
        ValueError: If `goal_terminates` is neither true nor false.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it on the instance)
        **MujocoTask.metadata,
        "picture_features": (0, 1),
    }
    _goal_position: ClassVar[tuple[float, float]] = cell_centre(find_cell("G"))
    _cell_number: ClassVar[NDArray[np.int64]] = number_cells()
    num_cells: ClassVar[int] = int(_cell_number.max()) + 1

    def __init__(
        self,
        action_cost: float = 0.0,
        goal_terminates: bool = False,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(
            maze_model(),
            observation_bound=(1.0, 1.0, SPEED_BOUND, SPEED_BOUND),
            action_cost=action_cost,
            render_mode=render_mode,
        )
        self.goal_terminates = check_flag("goal_terminates", goal_terminates)

    @property
    def position(self) -> Array64:
        """Place of the point to the right of and above the middle of the arena, in m."""
        return self.qpos

    @property
    def goal_distance(self) -> Array64:
        """Distance as the crow flies from the point to the middle of the goal, in m."""
        x, y = self._goal_position
        return np.hypot(self.position[..., 0] - x, self.position[..., 1] - y)

    @property
    def cell(self) -> Array:
        """Index of the cell the point is in."""
        return self._cell_number[cell_at(self.position[..., 0], self.position[..., 1])]

    def initialize_episode(self) -> None:
        """Put the point near the middle of the start cell, at rest."""
        noise = self.np_random.uniform(-START_NOISE, START_NOISE, size=2) * CELL_SIZE
        self.qpos[:] = cell_centre(find_cell("S")) + noise

    def get_observation(self) -> Array64:
        """Scaled position and velocity."""
        half_arena = len(MAZE) * CELL_SIZE / 2
        return np.concatenate((self.position / half_arena, self.qvel / SPEED_SCALE), axis=-1)

    def get_reward(self) -> Array64:
        """One in the goal, else zero."""
        return np.where(self.goal_distance < GOAL_RADIUS, 1.0, 0.0)

    def is_terminated(self) -> Array:
        """Whether the goal has been reached and ends the episode."""
        return self.goal_terminates & self.is_success()

    def get_task_info(self) -> dict[str, Array]:
        """Index of the cell the point is in."""
        return {"cell": self.cell}


PointMazeVector = partial(MujocoVectorEnv, PointMaze)
