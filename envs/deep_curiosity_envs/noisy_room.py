"""A room with a corner in which two observation channels are noise."""

from functools import partial
from typing import ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from deep_curiosity_envs.checks import check_flag
from deep_curiosity_envs.mujoco_task import Array, Array64, load_spec
from deep_curiosity_envs.point_room import CELL_SIZE, CELLS_PER_SIDE, HALF_ROOM, PointRoom
from deep_curiosity_envs.vector import MujocoVectorEnv

NOISY_CELLS_PER_SIDE = 3
CORNER = HALF_ROOM - NOISY_CELLS_PER_SIDE * CELL_SIZE  # m; right of and above it there is noise
NUM_CHANNELS = 2
KEYS = 2**53  # float64, the kind of `userdata`, holds the integers below exactly

KEY, STEP, SWITCHED_ON = range(3)  # in `userdata`


def split_mix(key: NDArray[np.uint64], index: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Member `index` of the random bits that `key` seeds, for arrays of one axis or more.

    Being a function of both, it needs no generator to be kept for every environment.

    Reference: Steele, Lea and Flood, "Fast Splittable Pseudorandom Number Generators" (2014),
    https://doi.org/10.1145/2714064.2660195; the generator known as SplitMix64.
    """
    bits = key + (index + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


class NoisyRoom(PointRoom):
    """A room without reward, in whose top right corner two observation channels are noise.

    The point starts at rest near the middle. There is no reward, and no episode is a success. Two
    channels of the observation are zero, but independent and uniform in [-1, 1) at every step
    that the point is in the corner, three by three cells large; the noise is a function of the
    seed given to `reset` and of the step. Every `info` holds `noisy`, whether the channels now
    flicker, and `cell`, the index in `range(num_cells)` of the cell the point is in.

    Observation: position in half rooms (1 m) to the right and up, velocity in m/s, and both
    channels.

    Args:
        switch: Let the agent make the noise instead of the corner: a third coordinate of the
            action switches it on, wherever the point is, for every step that it is positive.
        action_cost: Reward lost per step at full action.
        render_mode: `"rgb_array"` or None.

    Raises:
        ValueError: If `switch` is neither true nor false.
    """

    noisy_share: ClassVar[float] = NOISY_CELLS_PER_SIDE**2 / CELLS_PER_SIDE**2
    """Share of the cells that are in the noisy corner."""

    def __init__(
        self,
        switch: bool = False,
        action_cost: float = 0.0,
        render_mode: str | None = None,
    ) -> None:
        self.switch = check_flag("switch", switch)
        super().__init__(
            noisy_room_spec(self.switch),
            extra_bound=(1.0,) * NUM_CHANNELS,
            action_cost=action_cost,
            render_mode=render_mode,
        )

    @property
    def noisy(self) -> Array:
        """Whether the channels flicker."""
        if self.switch:
            return self.userdata[..., SWITCHED_ON] > 0
        return self.position.min(-1) > CORNER

    @property
    def noise(self) -> Array64:
        """Values of the channels when they flicker, in [-1, 1), `(*batch, 2)`."""
        key = self.userdata[..., KEY, None].astype(np.uint64)
        index = NUM_CHANNELS * self.userdata[..., STEP, None] + np.arange(NUM_CHANNELS)
        bits = split_mix(key, index.astype(np.uint64)) >> np.uint64(11)
        return bits.astype(np.float64) * 2.0**-52 - 1.0

    def initialize_episode(self) -> None:
        """Put the point near the middle, and sample the key of the episode's noise."""
        super().initialize_episode()
        self.userdata[KEY] = self.np_random.integers(KEYS)

    def after_step(self, control: Array64) -> None:
        """Count the step, and read the switch."""
        self.userdata[..., STEP] += 1
        if self.switch:
            self.userdata[..., SWITCHED_ON] = control[..., -1] > 0

    def get_observation(self) -> Array64:
        """Position, velocity and the channels."""
        channels = np.where(self.noisy[..., None], self.noise, 0.0)
        return np.concatenate((self.scaled_motion, channels), axis=-1)

    def get_reward(self) -> Array64:
        """Zero."""
        return np.zeros(self.position.shape[:-1])

    def get_task_info(self) -> dict[str, Array]:
        """Whether there is noise, and the cell of the point."""
        return {"noisy": self.noisy, "cell": self.cell}


def noisy_room_spec(switch: bool) -> mujoco.MjSpec:
    """The room with its corner marked, or with an actuator for the switch that moves nothing."""
    spec = load_spec("room.xml")
    spec.nuserdata = 3
    if switch:
        spec.add_actuator(
            name="switch",
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            target="x",
            gear=[0, 0, 0, 0, 0, 0],
            ctrlrange=[-1, 1],
            ctrllimited=True,
        )
        return spec
    half, middle = (HALF_ROOM - CORNER) / 2, (HALF_ROOM + CORNER) / 2
    spec.worldbody.add_site(
        name="noisy_corner",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[middle, middle, -0.045],
        size=[half, half, 0.005],
        rgba=[0.6, 0.6, 0.8, 1],
    )
    return spec


NoisyRoomVector = partial(MujocoVectorEnv, NoisyRoom)
