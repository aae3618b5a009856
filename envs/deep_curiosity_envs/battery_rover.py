"""A rover that has to return to its charger before its battery is empty."""

from functools import partial

import mujoco
import numpy as np

from deep_curiosity_envs.mujoco_task import CONTROL_STEP, Array, Array64, load_spec
from deep_curiosity_envs.point_room import PointRoom
from deep_curiosity_envs.vector import MujocoVectorEnv

CHARGER_POSITION = (0.5, 0.5)  # m to the right of and above the middle
CHARGER_RADIUS = 0.2  # m; four control steps at full speed, so the point cannot jump over it
CHARGE_PER_STEP = 0.1  # of the battery
DRAIN_PER_STEP = 1 / 200  # of the battery at rest; twice that at full force on both axes

ENERGY, CHARGED = range(2)  # in `userdata`, both in batteries


class BatteryRover(PointRoom):
    """Wander as far as the battery carries, and be back at the charger before it is empty.

    The rover starts at rest near the middle of the room with a full battery, of which every step
    drains 1/200, plus as much again times the mean square of the action: it lasts for 100 steps
    at full force, 150 of random pushes, 200 at rest. The charger, a disc in the top right quarter,
    gives back a tenth of the battery per step, and nothing drains there. A step pays what it has
    charged in tenths of the battery, so one at most and nothing once the battery is full. An
    empty battery ends the episode. The episode is a success once the rover has filled half of its
    battery in one go, as one does that has ranged far and come back. Every `info` holds `energy`,
    1 for a full battery, `starved`, whether it is empty, and `cell`, the index in
    `range(num_cells)` of the cell the rover is in.

    Observation: position in half rooms (1 m) to the right and up, velocity in m/s, and energy.

    Args:
        action_cost: Reward lost per step at full force on both axes.
        render_mode: `"rgb_array"` or None.
    """

    hold_time = 5 * CONTROL_STEP  # half a battery, at a tenth for every step

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            battery_rover_spec(),
            extra_bound=(1.0,),
            action_cost=action_cost,
            render_mode=render_mode,
        )

    @property
    def energy(self) -> Array64:
        """Charge of the battery, 1 when full."""
        return self.userdata[..., ENERGY]

    @property
    def starved(self) -> Array:
        """Whether the battery is empty."""
        return self.energy <= 0

    @property
    def on_charger(self) -> Array:
        """Whether the middle of the rover is over the charger."""
        x, y = CHARGER_POSITION
        distance = np.hypot(self.position[..., 0] - x, self.position[..., 1] - y)
        return distance < CHARGER_RADIUS

    def initialize_episode(self) -> None:
        """Put the rover near the middle, its battery full."""
        super().initialize_episode()
        self.userdata[ENERGY] = 1.0

    def after_step(self, control: Array64) -> None:
        """Charge on the charger, drain elsewhere."""
        energy, charging = self.energy, self.on_charger
        charged = np.minimum(1.0 - energy, CHARGE_PER_STEP)
        drained = DRAIN_PER_STEP * (1.0 + np.square(control).mean(-1))
        fuller, emptier = np.minimum(energy + charged, 1.0), np.maximum(energy - drained, 0.0)
        self.userdata[..., CHARGED] = np.where(charging, charged, 0.0)
        self.userdata[..., ENERGY] = np.where(charging, fuller, emptier)

    def get_observation(self) -> Array64:
        """Position, velocity and energy."""
        return np.concatenate((self.scaled_motion, self.energy[..., None]), axis=-1)

    def get_reward(self) -> Array64:
        """Charge gained in the step, as a share of the largest possible."""
        return self.userdata[..., CHARGED] / CHARGE_PER_STEP

    def is_terminated(self) -> Array:
        """Whether the rover has starved."""
        return self.starved

    def get_task_info(self) -> dict[str, Array]:
        """State of the battery, and the cell of the rover."""
        return {"energy": self.energy.copy(), "starved": self.starved, "cell": self.cell}


def battery_rover_spec() -> mujoco.MjSpec:
    """The room with the charger in its place."""
    spec = load_spec("room.xml")
    spec.nuserdata = 2
    spec.worldbody.add_site(
        name="charger",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=[*CHARGER_POSITION, -0.045],
        size=[CHARGER_RADIUS, 0.005, 0],
        rgba=[0.2, 0.7, 0.3, 1],
    )
    return spec


BatteryRoverVector = partial(MujocoVectorEnv, BatteryRover)
