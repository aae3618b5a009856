"""A cart on a rail that has to swing up the pole hanging from it."""

import math
from functools import partial
from typing import ClassVar

import numpy as np

from deep_curiosity_envs.mujoco_task import Array64, MujocoTask, load_spec
from deep_curiosity_envs.rewards import tolerance, wrap_angle
from deep_curiosity_envs.vector import MujocoVectorEnv

UPRIGHT_ANGLE = 0.3  # rad; as in the pendulum
SLOW_SPEED = 1.0  # rad/s; a free fall through the bottom is nine times as fast
RAIL_LIMIT = 2.0  # m; largest distance of the cart from the middle
CENTRED_POSITION = RAIL_LIMIT / 4  # m; so the middle quarter of the rail pays
CART_SPEED_SCALE = 4.0  # m/s; about what full force reaches from the middle to the end
POLE_SPEED_SCALE = 8.0  # rad/s; about the speed at the bottom of a fall from upright
START_NOISE = 0.01  # m, rad, m/s and rad/s; breaks the symmetry between left and right


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

    hold_time = 1.0
    # The rail's ends give way by a few centimetres.
    observation_bound: ClassVar[tuple[float, ...]] = (1.1, 1.0, 1.0, 2.0, 5.0)

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            load_spec("cartpole.xml").compile(),
            observation_bound=self.observation_bound,
            action_cost=action_cost,
            render_mode=render_mode,
        )

    @property
    def cart_position(self) -> Array64:
        """Distance to the right of the rail's middle, in m."""
        return self.qpos[..., 0]

    @property
    def cart_speed(self) -> Array64:
        """Speed to the right, in m/s."""
        return self.qvel[..., 0]

    @property
    def pole_angle(self) -> Array64:
        """Angle from upright, in [-pi, pi] rad."""
        return wrap_angle(self.qpos[..., 1])

    @property
    def pole_speed(self) -> Array64:
        """Angular velocity, in rad/s."""
        return self.qvel[..., 1]

    def initialize_episode(self) -> None:
        """Let the pole hang at rest from a cart in the middle, but for a little noise."""
        noise = self.np_random.uniform(-START_NOISE, START_NOISE, size=4)
        self.qpos[:] = noise[0], math.pi + noise[1]
        self.qvel[:] = noise[2:]

    def get_observation(self) -> Array64:
        """Position of the cart, direction of the pole and both scaled speeds."""
        angle = self.pole_angle
        features = (
            self.cart_position / RAIL_LIMIT,
            np.cos(angle),
            np.sin(angle),
            self.cart_speed / CART_SPEED_SCALE,
            self.pole_speed / POLE_SPEED_SCALE,
        )
        return np.array(features).T

    def get_reward(self) -> Array64:
        """One while upright, slow and centred, else zero."""
        upright = tolerance(self.pole_angle, bounds=(-UPRIGHT_ANGLE, UPRIGHT_ANGLE))
        slow = tolerance(self.pole_speed, bounds=(-SLOW_SPEED, SLOW_SPEED))
        centred = tolerance(self.cart_position, bounds=(-CENTRED_POSITION, CENTRED_POSITION))
        return upright * slow * centred


CartpoleSwingupVector = partial(MujocoVectorEnv, CartpoleSwingup)
