"""The pendulum's swing-up with twelve small motors in place of one."""

from functools import partial

import mujoco

from deep_curiosity_envs.mujoco_task import load_spec
from deep_curiosity_envs.pendulum import PendulumSwingup
from deep_curiosity_envs.vector import MujocoVectorEnv

NUM_MOTORS = 12


class ManyMotors(PendulumSwingup):
    """`PendulumSwingup` with a motor too many eleven times over: only their mean command counts.

    Every motor gives a twelfth of the torque of `PendulumSwingup`'s, so that equal commands do
    what the one command does there and cost as much; but a torque can be had in many ways, of
    which equal commands are the cheapest. The other eleven directions of the action do nothing.

    Observation: cosine and sine of the pole's angle from upright, angular velocity in 8 rad/s.

    Args:
        action_cost: Reward lost per step at full torque of all motors.
        render_mode: `"rgb_array"` or None.
    """

    @staticmethod
    def make_model() -> mujoco.MjModel:
        """The pole with its motor divided by twelve."""
        spec = load_spec("pendulum.xml")
        motor = spec.actuator("torque")
        torque, joint = motor.gear[0], motor.target
        spec.delete(motor)
        for number in range(NUM_MOTORS):
            spec.add_actuator(
                name=f"torque_{number}",
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
                target=joint,
                gear=[torque / NUM_MOTORS, 0, 0, 0, 0, 0],
                ctrlrange=[-1, 1],
                ctrllimited=True,
            )
        return spec.compile()


ManyMotorsVector = partial(MujocoVectorEnv, ManyMotors)
