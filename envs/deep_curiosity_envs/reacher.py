"""A two-link arm whose fingertip has to find a target that pays only when touched."""

import math
from functools import partial

import numpy as np

from deep_curiosity_envs.mujoco_task import Array64, MujocoTask, load_spec
from deep_curiosity_envs.rewards import tolerance
from deep_curiosity_envs.vector import MujocoVectorEnv

TARGET_RADIUS = 0.05  # m; a twentieth of the arm's length
TARGET_DISTANCE = (0.3, 0.9)  # m from the shoulder; inside the reach of the folded to straight arm
SPEED_SCALE = 4.0  # rad/s; what the arm reaches after one to two seconds of full torque
SPEED_BOUND = 5.0  # in units of SPEED_SCALE


class ReacherSparse(MujocoTask):
    """Move the fingertip of a planar arm to a target sampled in each episode, and keep it there.

    The arm starts at rest in a random pose. A step pays one while the fingertip is within 5 cm
    of the target, else nothing. The episode is a success once the fingertip has stayed there
    for half a second.

    Observation: cosines of both joint angles, their sines, angular velocities in 4 rad/s, the
    target's position and the vector from fingertip to target, both in m.

    Args:
        action_cost: Reward lost per step at full torque on both joints.
        render_mode: `"rgb_array"` or None.
    """

    hold_time = 0.5

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            load_spec("reacher.xml").compile(),
            observation_bound=(1, 1, 1, 1, SPEED_BOUND, SPEED_BOUND, 1, 1, 2, 2),
            action_cost=action_cost,
            render_mode=render_mode,
        )
        self._upper_arm_length = self.model.body("forearm").pos[0]
        self._forearm_length = self.model.site("fingertip").pos[0]

    @property
    def target_position(self) -> Array64:
        """Place of the target in the plane, relative to the shoulder, in m."""
        return self.mocap_pos[..., 0, :2]

    @property
    def fingertip_position(self) -> Array64:
        """Place of the fingertip in the plane, relative to the shoulder, in m."""
        upper_arm = self.qpos[..., 0]
        forearm = upper_arm + self.qpos[..., 1]
        x = self._upper_arm_length * np.cos(upper_arm) + self._forearm_length * np.cos(forearm)
        y = self._upper_arm_length * np.sin(upper_arm) + self._forearm_length * np.sin(forearm)
        return np.array((x, y)).T

    @property
    def fingertip_to_target(self) -> Array64:
        """Vector in the plane from the fingertip to the middle of the target, in m."""
        return self.target_position - self.fingertip_position

    def initialize_episode(self) -> None:
        """Sample the pose of the arm and the place of the target."""
        self.qpos[:] = self.np_random.uniform(-math.pi, math.pi, size=2)
        direction = self.np_random.uniform(-math.pi, math.pi)
        distance = self.np_random.uniform(*TARGET_DISTANCE)
        self.target_position[:] = distance * np.array([math.cos(direction), math.sin(direction)])

    def get_observation(self) -> Array64:
        """Pose and scaled speed of the arm, target, and the vector to it."""
        features = (
            np.cos(self.qpos),
            np.sin(self.qpos),
            self.qvel / SPEED_SCALE,
            self.target_position,
            self.fingertip_to_target,
        )
        return np.concatenate(features, axis=-1)

    def get_reward(self) -> Array64:
        """One while the fingertip is in the target, else zero."""
        error = self.fingertip_to_target
        distance = np.hypot(error[..., 0], error[..., 1])
        return tolerance(distance, bounds=(0.0, TARGET_RADIUS))


ReacherSparseVector = partial(MujocoVectorEnv, ReacherSparse)
