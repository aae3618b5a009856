"""Swing-ups whose observations hold positions but no velocities."""

from functools import partial

from deep_curiosity_envs.cartpole import CartpoleSwingup
from deep_curiosity_envs.mujoco_task import Array64
from deep_curiosity_envs.pendulum import PendulumSwingup
from deep_curiosity_envs.vector import MujocoVectorEnv

NUM_PENDULUM_POSITIONS = 2  # cosine and sine, before the speed
NUM_CARTPOLE_POSITIONS = 3  # cart, cosine and sine, before both speeds


class PendulumHiddenVelocity(PendulumSwingup):
    """`PendulumSwingup` without the speed: the full state takes two observations.

    Observation: cosine and sine of the pole's angle from upright.

    Args:
        action_cost: Reward lost per step at full torque.
        render_mode: `"rgb_array"` or None.
    """

    observation_bound = PendulumSwingup.observation_bound[:NUM_PENDULUM_POSITIONS]

    def get_observation(self) -> Array64:
        """Direction of the pole."""
        return super().get_observation()[..., :NUM_PENDULUM_POSITIONS]


class CartpoleHiddenVelocity(CartpoleSwingup):
    """`CartpoleSwingup` without the speeds: the full state takes two observations.

    Observation: cart position in half rails (2 m), cosine and sine of the pole's angle from
    upright.

    Args:
        action_cost: Reward lost per step at full force.
        render_mode: `"rgb_array"` or None.
    """

    observation_bound = CartpoleSwingup.observation_bound[:NUM_CARTPOLE_POSITIONS]

    def get_observation(self) -> Array64:
        """Position of the cart and direction of the pole."""
        return super().get_observation()[..., :NUM_CARTPOLE_POSITIONS]


PendulumHiddenVelocityVector = partial(MujocoVectorEnv, PendulumHiddenVelocity)
CartpoleHiddenVelocityVector = partial(MujocoVectorEnv, CartpoleHiddenVelocity)
