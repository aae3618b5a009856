"""A point mass in a square room without inner walls: the base of the tasks in such a room."""

from collections.abc import Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np

from deep_curiosity_envs.mujoco_task import Array, Array64, MujocoTask

HALF_ROOM = 1.0  # m; from the middle to a wall
CELLS_PER_SIDE = 10
CELL_SIZE = 2 * HALF_ROOM / CELLS_PER_SIDE  # m
SPEED_SCALE = 1.0  # m/s; what full force reaches against the damping
SPEED_BOUND = 2.0  # in units of SPEED_SCALE
START_NOISE = 0.2  # of a cell


class PointRoom(MujocoTask):
    """A point, pushed along both axes, that starts at rest near the middle of the room.

    The room is divided into `num_cells` square cells, numbered in rows from the top left corner.

    Args:
        spec: Editable model of the point and the room.
        extra_bound: Largest magnitude of each observation after position and velocity.
        action_cost: Reward lost per step at full action.
        render_mode: `"rgb_array"` or None.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium declares it on the instance)
        **MujocoTask.metadata,
        "picture_features": (0, 1),
    }
    num_cells: ClassVar[int] = CELLS_PER_SIDE**2

    def __init__(
        self,
        spec: mujoco.MjSpec,
        *,
        extra_bound: Sequence[float],
        action_cost: float = 0.0,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(
            spec.compile(),
            observation_bound=(1.0, 1.0, SPEED_BOUND, SPEED_BOUND, *extra_bound),
            action_cost=action_cost,
            render_mode=render_mode,
        )

    @property
    def position(self) -> Array64:
        """Place of the point to the right of and above the middle of the room, in m."""
        return self.qpos

    @property
    def cell(self) -> Array:
        """Index of the cell the point is in."""
        column = np.floor((HALF_ROOM + self.position[..., 0]) / CELL_SIZE)
        row = np.floor((HALF_ROOM - self.position[..., 1]) / CELL_SIZE)
        return (CELLS_PER_SIDE * row + column).astype(int)

    @property
    def scaled_motion(self) -> Array64:
        """Position in half rooms and scaled velocity, `(*batch, 4)`."""
        return np.concatenate((self.position / HALF_ROOM, self.qvel / SPEED_SCALE), axis=-1)

    def initialize_episode(self) -> None:
        """Put the point near the middle, at rest."""
        self.qpos[:] = self.np_random.uniform(-START_NOISE, START_NOISE, size=2) * CELL_SIZE
