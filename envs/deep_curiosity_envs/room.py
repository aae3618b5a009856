"""A square room without inner walls, and the point that moves in it."""

import abc
from typing import Any, ClassVar

import mujoco
import numpy as np

from deep_curiosity_envs.mujoco_task import Array, Array64, MujocoTask, load_spec

HALF_ROOM = 1.0  # m; from the middle to each wall
WALL = 0.05  # m; half the thickness of a wall
CELLS_PER_SIDE = 10
SPEED_SCALE = 1.0  # m/s; what full force reaches against the damping
SPEED_BOUND = 2.0  # in units of SPEED_SCALE


def room_spec(marked: tuple[float, float], radius: float) -> mujoco.MjSpec:
    """The point between four walls, with a disc on the floor where something happens.

    Args:
        marked: Middle of the disc, in m from the middle of the room.
        radius: Of the disc, in m.
    """
    spec = load_spec("point_maze.xml")
    reach = HALF_ROOM + WALL
    for name, place, size in (
        ("east", (reach, 0.0), (WALL, reach)),
        ("west", (-reach, 0.0), (WALL, reach)),
        ("north", (0.0, reach), (reach, WALL)),
        ("south", (0.0, -reach), (reach, WALL)),
    ):
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[*place, 0.0],
            size=[*size, WALL],
        )
    site = spec.site("goal")
    site.pos[:2], site.size[0] = marked, radius
    return spec


class Room(MujocoTask, abc.ABC):
    """A point that is pushed about in a square room, divided into ten by ten cells.

    Every `info` holds `cell`, the index in `range(num_cells)` of the cell the point is in, row by
    row from the south-west corner.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it on the instance)
        **MujocoTask.metadata,
        "picture_features": (0, 1),
    }
    num_cells: ClassVar[int] = CELLS_PER_SIDE**2

    @property
    def position(self) -> Array64:
        """Place of the point to the east and north of the middle of the room, in m."""
        return self.qpos

    @property
    def cell(self) -> Array:
        """Index of the cell the point is in."""
        place = (self.position / HALF_ROOM + 1) / 2 * CELLS_PER_SIDE
        column, row = np.clip(place.astype(int), 0, CELLS_PER_SIDE - 1).T
        return (row * CELLS_PER_SIDE + column).T

    def get_motion(self) -> Array64:
        """Scaled position and velocity, `(*worlds, 4)`."""
        return np.concatenate((self.position / HALF_ROOM, self.qvel / SPEED_SCALE), axis=-1)

    def get_info(self) -> dict[str, Array]:
        """Index of the cell the point is in."""
        return {"cell": self.cell}
