"""A cart on a rail that has to swing up the pole hanging from it."""

import math

import numpy as np

from deep_curiosity_envs.mujoco_task import CONTROL_STEP, Array32, MujocoTask, load_spec
from deep_curiosity_envs.rewards import Hold, tolerance

UPRIGHT_ANGLE = 0.3  # rad; as in the pendulum
SLOW_SPEED = 1.0  # rad/s; a free fall through the bottom is nine times as fast
RAIL_LIMIT = 2.0  # m; largest distance of the cart from the middle
CENTRED_POSITION = RAIL_LIMIT / 4  # m; so the middle quarter of the rail pays
CART_SPEED_SCALE = 4.0  # m/s; about what full force reaches from the middle to the end
POLE_SPEED_SCALE = 8.0  # rad/s; about the speed at the bottom of a fall from upright
OBSERVATION_BOUND = (1.1, 1.0, 1.0, 2.0, 5.0)  # the rail's ends give way by a few centimetres
START_NOISE = 0.01  # m, rad, m/s and rad/s; breaks the symmetry between left and right
HOLD_TIME = 1.0  # s


class CartpoleSwingup(MujocoTask):
    """Swing a pole up by moving the cart it hangs from, and hold it near the middle of the rail.

    The pole starts hanging at rest. A step pays one while the pole is within 0.3 rad of upright
    and slower than 1 rad/s, and the cart on the middle quarter of the rail, else nothing. The
    episode is a success once that has lasted for one second in a row.

    Observation: cart position in half rails (2 m), cosine and sine of the pole's angle from
    upright, cart speed in 4 m/s, angular velocity in 8 rad/s.

    Args:
        action_cost: Reward lost per step at full force.
        render_mode: `"rgb_array"` or None.
    """

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            load_spec("cartpole.xml").compile(),
            observation_bound=OBSERVATION_BOUND,
            action_cost=action_cost,
            render_mode=render_mode,
        )
        self._slider = self.data.joint("slider")
        self._hinge = self.data.joint("hinge")
        self._hold = Hold(round(HOLD_TIME / CONTROL_STEP))

    @property
    def cart_position(self) -> float:
        """Distance to the right of the rail's middle, in m."""
        return float(self._slider.qpos[0])

    @property
    def cart_speed(self) -> float:
        """Speed to the right, in m/s."""
        return float(self._slider.qvel[0])

    @property
    def pole_angle(self) -> float:
        """Angle from upright, in [-pi, pi] rad."""
        return math.remainder(float(self._hinge.qpos[0]), math.tau)

    @property
    def pole_speed(self) -> float:
        """Angular velocity, in rad/s."""
        return float(self._hinge.qvel[0])

    def initialize_episode(self) -> None:
        """Let the pole hang at rest from a cart in the middle, but for a little noise."""
        noise = self.np_random.uniform(-START_NOISE, START_NOISE, size=4)
        self._slider.qpos[0], self._hinge.qpos[0] = noise[0], math.pi + noise[1]
        self._slider.qvel[0], self._hinge.qvel[0] = noise[2], noise[3]
        self._hold.reset()

    def get_observation(self) -> Array32:
        """Position of the cart, direction of the pole and both scaled speeds."""
        angle = self.pole_angle
        features = (
            self.cart_position / RAIL_LIMIT,
            math.cos(angle),
            math.sin(angle),
            self.cart_speed / CART_SPEED_SCALE,
            self.pole_speed / POLE_SPEED_SCALE,
        )
        return np.array(features, np.float32)

    def get_reward(self) -> float:
        """One while upright, slow and centred, else zero."""
        upright = tolerance(self.pole_angle, bounds=(-UPRIGHT_ANGLE, UPRIGHT_ANGLE))
        slow = tolerance(self.pole_speed, bounds=(-SLOW_SPEED, SLOW_SPEED))
        centred = tolerance(self.cart_position, bounds=(-CENTRED_POSITION, CENTRED_POSITION))
        return upright * slow * centred

    def track_episode(self) -> None:
        """Count how long the pole has been held."""
        self._hold.update(self.get_reward() == 1.0)

    def is_success(self) -> bool:
        """Whether the pole has been held, slow and centred, for a second in a row."""
        return self._hold.achieved
