"""A pendulum whose motor is too weak to lift it in one go."""

import math

import numpy as np

from deep_curiosity_envs.mujoco_task import CONTROL_STEP, Array32, MujocoTask, load_spec
from deep_curiosity_envs.rewards import Hold, tolerance

UPRIGHT_ANGLE = 0.3  # rad; a tenth of the circle pays
SLOW_SPEED = 1.0  # rad/s; a free fall through the bottom is nine times as fast
SPEED_SCALE = 8.0  # rad/s; about the speed at the bottom of a fall from upright
SPEED_BOUND = 4.0  # in units of SPEED_SCALE; the motor cannot spin the pole faster
START_NOISE = 0.01  # rad and rad/s; breaks the symmetry between left and right
HOLD_TIME = 1.0  # s


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

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            load_spec("pendulum.xml").compile(),
            observation_bound=(1.0, 1.0, SPEED_BOUND),
            action_cost=action_cost,
            render_mode=render_mode,
        )
        self._hinge = self.data.joint("hinge")
        self._hold = Hold(round(HOLD_TIME / CONTROL_STEP))

    @property
    def pole_angle(self) -> float:
        """Angle from upright, in [-pi, pi] rad."""
        return math.remainder(float(self._hinge.qpos[0]), math.tau)

    @property
    def pole_speed(self) -> float:
        """Angular velocity, in rad/s."""
        return float(self._hinge.qvel[0])

    def initialize_episode(self) -> None:
        """Let the pole hang at rest, but for a little noise."""
        angle_noise, speed_noise = self.np_random.uniform(-START_NOISE, START_NOISE, size=2)
        self._hinge.qpos[0] = math.pi + angle_noise
        self._hinge.qvel[0] = speed_noise
        self._hold.reset()

    def get_observation(self) -> Array32:
        """Direction of the pole and its scaled speed."""
        angle, speed = self.pole_angle, self.pole_speed
        return np.array([math.cos(angle), math.sin(angle), speed / SPEED_SCALE], np.float32)

    def get_reward(self) -> float:
        """One while upright and slow, else zero."""
        upright = tolerance(self.pole_angle, bounds=(-UPRIGHT_ANGLE, UPRIGHT_ANGLE))
        slow = tolerance(self.pole_speed, bounds=(-SLOW_SPEED, SLOW_SPEED))
        return upright * slow

    def track_episode(self) -> None:
        """Count how long the pole has been held."""
        self._hold.update(self.get_reward() == 1.0)

    def is_success(self) -> bool:
        """Whether the pole has been held upright and slow for a second in a row."""
        return self._hold.achieved
