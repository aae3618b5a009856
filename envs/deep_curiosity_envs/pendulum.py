"""A pendulum whose motor is too weak to lift it in one go."""

import math
from functools import partial
from typing import ClassVar

import mujoco
import numpy as np

from deep_curiosity_envs.mujoco_task import Array64, MujocoTask, load_spec
from deep_curiosity_envs.rewards import tolerance, wrap_angle
from deep_curiosity_envs.vector import MujocoVectorEnv

UPRIGHT_ANGLE = 0.3  # rad; a tenth of the circle pays
SLOW_SPEED = 1.0  # rad/s; a free fall through the bottom is nine times as fast
SPEED_SCALE = 8.0  # rad/s; about the speed at the bottom of a fall from upright
SPEED_BOUND = 4.0  # in units of SPEED_SCALE; the motor cannot spin the pole faster
START_NOISE = 0.01  # rad and rad/s; breaks the symmetry between left and right


class PendulumSwingup(MujocoTask):
    """Swing a pole up and hold it, with a third of the torque that would lift it directly.

    The pole starts hanging at rest. A step pays one while the pole is within 0.3 rad of upright
    and slower than 1 rad/s, else nothing. The episode is a success once the pole has been held
    so for one second in a row. With an action cost, doing nothing earns zero and random actions
    lose.

    Observation: cosine and sine of the pole's angle from upright, angular velocity in 8 rad/s.

    Args:
        action_cost: Reward lost per step at full torque.
        render_mode: `"rgb_array"` or None.
    """

    hold_time = 1.0
    observation_bound: ClassVar[tuple[float, ...]] = (1.0, 1.0, SPEED_BOUND)

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            self.make_model(),
            observation_bound=self.observation_bound,
            action_cost=action_cost,
            render_mode=render_mode,
        )

    @staticmethod
    def make_model() -> mujoco.MjModel:
        """The pole with its motor."""
        return load_spec("pendulum.xml").compile()

    @property
    def pole_angle(self) -> Array64:
        """Angle from upright, in [-pi, pi] rad."""
        return wrap_angle(self.qpos[..., 0])

    @property
    def pole_speed(self) -> Array64:
        """Angular velocity, in rad/s."""
        return self.qvel[..., 0]

    def initialize_episode(self) -> None:
        """Let the pole hang at rest, but for a little noise."""
        angle_noise, speed_noise = self.np_random.uniform(-START_NOISE, START_NOISE, size=2)
        self.qpos[0] = math.pi + angle_noise
        self.qvel[0] = speed_noise

    def get_observation(self) -> Array64:
        """Direction of the pole and its scaled speed."""
        angle, speed = self.pole_angle, self.pole_speed
        return np.array((np.cos(angle), np.sin(angle), speed / SPEED_SCALE)).T

    def get_reward(self) -> Array64:
        """One while upright and slow, else zero."""
        upright = tolerance(self.pole_angle, bounds=(-UPRIGHT_ANGLE, UPRIGHT_ANGLE))
        slow = tolerance(self.pole_speed, bounds=(-SLOW_SPEED, SLOW_SPEED))
        return upright * slow


PendulumSwingupVector = partial(MujocoVectorEnv, PendulumSwingup)
