"""A rover that has to come back to its charger in time, and is free to wander in between."""

from functools import partial

import numpy as np

from deep_curiosity_envs.mujoco_task import Array, Array64
from deep_curiosity_envs.room import SPEED_BOUND, Room, room_spec
from deep_curiosity_envs.vector import MujocoVectorEnv

CHARGER = (-0.7, -0.7)  # m from the middle of the room
CHARGER_RADIUS = 0.2  # m
START_NOISE = 0.05  # m
IDLE_DRAIN = 1 / 160  # of a full battery in a control step; the room is crossed in sixty
FORCE_DRAIN = 1 / 480  # the same at full force on both axes, on top
CHARGE = 0.1  # of a full battery in a control step on the charger
# What `mocap_pos` of the body "battery" holds: it has no shape, and nothing touches it.
ENERGY, CHARGED = 0, 1


class BatteryRover(Room):
    """Keep the battery alive: only the charger in the south-west corner pays, and only the hungry.

    The point starts on the charger with a full battery, which lasts for 120 to 160 control steps.
    On the charger up to a tenth of it is filled in a step, and the reward is what was filled in
    units of that, so it counts the energy that was brought home. A battery that is empty ends the
    episode. The episode is a success once a step has filled a whole tenth. Every `info` holds
    `cell`; `energy`, from 0 to 1; and `starved`, whether the battery is empty.

    Observation: position in half rooms (1 m) to the east and north, velocity in m/s, and energy.

    Args:
        action_cost: Reward lost per step at full force.
        render_mode: `"rgb_array"` or None.
    """

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        spec = room_spec(CHARGER, CHARGER_RADIUS)
        spec.worldbody.add_body(name="battery", mocap=True)
        super().__init__(
            spec.compile(),
            observation_bound=(1.0, 1.0, SPEED_BOUND, SPEED_BOUND, 1.0),
            action_cost=action_cost,
            render_mode=render_mode,
        )

    @property
    def energy(self) -> Array64:
        """Charge of the battery, from 0 to 1."""
        return self.mocap_pos[..., 0, ENERGY]

    @property
    def on_charger(self) -> Array:
        """Whether the point is on the charger."""
        return np.hypot(*(self.position - CHARGER).T).T < CHARGER_RADIUS

    def initialize_episode(self) -> None:
        """Put the point on the charger, at rest, with a full battery."""
        self.qpos[:] = CHARGER + self.np_random.uniform(-START_NOISE, START_NOISE, size=2)
        self.mocap_pos[0] = 1.0, 0.0, 0.0

    def advance(self, control: Array64) -> None:
        """Drain the battery, then fill it where the point is on the charger."""
        drain = IDLE_DRAIN + FORCE_DRAIN * np.square(control).mean(-1)
        left = np.maximum(self.energy - drain, 0.0)
        filled = np.where(self.on_charger, np.minimum(CHARGE, 1.0 - left), 0.0)
        self.mocap_pos[..., 0, ENERGY] = left + filled
        self.mocap_pos[..., 0, CHARGED] = filled

    def get_observation(self) -> Array64:
        """Scaled position and velocity, and the charge."""
        return np.concatenate((self.get_motion(), self.energy[..., None]), axis=-1)

    def get_reward(self) -> Array64:
        """What the step has filled, in units of the most that a step can."""
        return self.mocap_pos[..., 0, CHARGED] / CHARGE

    def is_terminated(self) -> Array:
        """Whether the battery is empty."""
        return np.asarray(self.energy <= 0.0)

    def get_info(self) -> dict[str, Array]:
        """Index of the cell, charge, and whether the battery is empty."""
        return super().get_info() | {
            "energy": np.array(self.energy),
            "starved": self.is_terminated(),
        }


BatteryRoverVector = partial(MujocoVectorEnv, BatteryRover)
