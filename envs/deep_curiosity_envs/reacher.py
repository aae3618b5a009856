"""A two-link arm whose fingertip has to find a target that pays only when touched."""

import math

import numpy as np
from numpy.typing import NDArray

from deep_curiosity_envs.mujoco_task import CONTROL_STEP, Array32, MujocoTask, load_spec
from deep_curiosity_envs.rewards import Hold, tolerance

TARGET_RADIUS = 0.05  # m; a twentieth of the arm's length
TARGET_DISTANCE = (0.3, 0.9)  # m from the shoulder; inside the reach of the folded to straight arm
SPEED_SCALE = 4.0  # rad/s; what the arm reaches after one to two seconds of full torque
SPEED_BOUND = 5.0  # in units of SPEED_SCALE
HOLD_TIME = 0.5  # s


class ReacherSparse(MujocoTask):
    """Move the fingertip of a planar arm to a target drawn anew each episode, and keep it there.

    The arm starts at rest in a random pose. A step pays one while the fingertip is within 5 cm
    of the target, else nothing. The episode is a success once the fingertip has stayed there
    for half a second.

    Observation: cosines of both joint angles, their sines, angular velocities in 4 rad/s, the
    target's position and the vector from fingertip to target, both in m.

    Args:
        action_cost: Reward lost per step at full torque on both joints.
        render_mode: `"rgb_array"` or None.
    """

    def __init__(self, action_cost: float = 0.0, render_mode: str | None = None) -> None:
        super().__init__(
            load_spec("reacher.xml").compile(),
            observation_bound=(1, 1, 1, 1, SPEED_BOUND, SPEED_BOUND, 1, 1, 2, 2),
            action_cost=action_cost,
            render_mode=render_mode,
        )
        self._fingertip = self.data.site("fingertip")
        self._target_position = self.data.mocap_pos[0, :2]
        self._hold = Hold(round(HOLD_TIME / CONTROL_STEP))

    @property
    def fingertip_to_target(self) -> NDArray[np.float64]:
        """Vector in the plane from the fingertip to the middle of the target, in m."""
        return self._target_position - self._fingertip.xpos[:2]

    def initialize_episode(self) -> None:
        """Draw the pose of the arm and the place of the target."""
        self.data.qpos[:] = self.np_random.uniform(-math.pi, math.pi, size=2)
        direction = self.np_random.uniform(-math.pi, math.pi)
        distance = self.np_random.uniform(*TARGET_DISTANCE)
        self._target_position[:] = distance * np.array([math.cos(direction), math.sin(direction)])
        self._hold.reset()

    def get_observation(self) -> Array32:
        """Pose and scaled speed of the arm, target, and what is missing to it."""
        features = (
            np.cos(self.data.qpos),
            np.sin(self.data.qpos),
            self.data.qvel / SPEED_SCALE,
            self._target_position,
            self.fingertip_to_target,
        )
        return np.concatenate(features, dtype=np.float32)

    def get_reward(self) -> float:
        """One while the fingertip is in the target, else zero."""
        return tolerance(math.hypot(*self.fingertip_to_target), bounds=(0.0, TARGET_RADIUS))

    def track_episode(self) -> None:
        """Count how long the fingertip has stayed in the target."""
        self._hold.update(self.get_reward() == 1.0)

    def is_success(self) -> bool:
        """Whether the fingertip has stayed in the target for half a second."""
        return self._hold.achieved
