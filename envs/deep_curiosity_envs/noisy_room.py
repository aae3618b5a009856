"""A room with pure noise in one corner: what a curious agent should not care for."""

from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from deep_curiosity_envs.mujoco_task import Array, Array64
from deep_curiosity_envs.room import (
    CELLS_PER_SIDE,
    HALF_ROOM,
    SPEED_BOUND,
    Room,
    room_spec,
)
from deep_curiosity_envs.vector import MujocoVectorEnv

NOISY_CELLS = 3  # on each side of the corner
NOISY_FROM = HALF_ROOM * (1 - 2 * NOISY_CELLS / CELLS_PER_SIDE)  # m, on both axes
START_NOISE = 0.1  # m
NUM_CHANNELS = 2
KEYS = 2**31
# What `mocap_pos` of the body "noise" holds: it has no shape, and nothing touches it.
KEY, STEP, SWITCH = 0, 1, 2


def draws(key: Array64, step: Array64) -> Array64:
    """Numbers in [-1, 1), two for each key and step, that look independent: splitmix64."""
    counter = np.stack([NUM_CHANNELS * step + channel for channel in range(NUM_CHANNELS)], -1)
    word = key.astype(np.uint64)[..., None] << np.uint64(32) | counter.astype(np.uint64)
    return 2.0 * _scrambled(word) - 1.0


def _scrambled(word: NDArray[np.uint64]) -> Array64:
    """A number in [0, 1) for each word."""
    word = word * np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((word ^ (word >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) / 2.0**53


class NoisyRoom(Room):
    """Wander about a room in whose north-east corner two senses show nothing but noise.

    Nothing pays. The point starts near the middle. In the corner, nine cells of a hundred, the two
    noise channels are drawn anew at every step, uniformly; elsewhere they are zero. With `switch`
    there is no such corner: a third action above zero turns the noise on, wherever the point is.
    Every `info` holds `cell`, and `noisy`, whether there is noise at this step.

    Observation: position in half rooms (1 m) to the east and north, velocity in m/s, and the two
    noise channels.

    Args:
        action_cost: Reward lost per step at full action.
        switch: Whether an action turns the noise on instead of a place.
        render_mode: `"rgb_array"` or None.
    """

    noisy_share: ClassVar[float] = (NOISY_CELLS / CELLS_PER_SIDE) ** 2

    def __init__(
        self, action_cost: float = 0.0, switch: bool = False, render_mode: str | None = None
    ) -> None:
        middle = (NOISY_FROM + HALF_ROOM) / 2
        spec = room_spec((middle, middle), HALF_ROOM - middle)
        spec.worldbody.add_body(name="noise", mocap=True)
        if switch:
            idle = spec.actuator("force_x")
            spec.add_actuator(
                name="switch",
                trntype=idle.trntype,
                target=idle.target,
                gear=np.zeros(6),
                ctrllimited=idle.ctrllimited,
                ctrlrange=idle.ctrlrange,
            )
        super().__init__(
            spec.compile(),
            observation_bound=(1.0, 1.0, SPEED_BOUND, SPEED_BOUND, 1.0, 1.0),
            action_cost=action_cost,
            render_mode=render_mode,
        )
        self.switch = switch

    @property
    def noisy(self) -> Array:
        """Whether there is noise at this step."""
        if self.switch:
            return np.asarray(self.mocap_pos[..., 0, SWITCH] > 0)
        return np.asarray((self.position > NOISY_FROM).all(-1))

    def initialize_episode(self) -> None:
        """Put the point near the middle, at rest, and draw the key of the episode's noise."""
        self.qpos[:] = self.np_random.uniform(-START_NOISE, START_NOISE, size=2)
        self.mocap_pos[0] = self.np_random.integers(KEYS), 0, 0

    def advance(self, control: Array64) -> None:
        """Count the step, and remember the switch."""
        self.mocap_pos[..., 0, STEP] += 1
        if self.switch:
            self.mocap_pos[..., 0, SWITCH] = control[..., 2] > 0

    def get_observation(self) -> Array64:
        """Scaled position and velocity, and the noise channels."""
        noise = draws(self.mocap_pos[..., 0, KEY], self.mocap_pos[..., 0, STEP])
        return np.concatenate((self.get_motion(), noise * self.noisy[..., None]), axis=-1)

    def get_reward(self) -> Array64:
        """Nothing pays."""
        return np.zeros(self.position.shape[:-1])

    def get_info(self) -> dict[str, Array]:
        """Index of the cell the point is in, and whether there is noise."""
        return super().get_info() | {"noisy": self.noisy}


NoisyRoomVector = partial(MujocoVectorEnv, NoisyRoom)
