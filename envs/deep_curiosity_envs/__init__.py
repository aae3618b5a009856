"""Small MuJoCo tasks whose rewards are sparse or absent, and the paper's two illustrations.

Both are registered with Gymnasium on import.

Example:
    >>> import gymnasium
    >>> import deep_curiosity_envs
    >>> env = gymnasium.make("deep_curiosity/PendulumSwingup-v0", action_cost=0.1)
    >>> envs = gymnasium.make_vec("deep_curiosity/PendulumSwingup-v0", num_envs=64)
"""

# ruff: noqa: E402, MuJoCo has to be loaded before the tasks import it

from deep_curiosity.requirements import require

require("gymnasium", "mujoco", extra="envs")

import gymnasium

from deep_curiosity_envs.engine import load_engine

load_engine()

from deep_curiosity_envs.battery_rover import BatteryRover
from deep_curiosity_envs.cartpole import CartpoleSwingup
from deep_curiosity_envs.hidden_velocity import CartpoleHiddenVelocity, PendulumHiddenVelocity
from deep_curiosity_envs.illustrations import CleverRandom, ReliableUnreliable
from deep_curiosity_envs.many_motors import ManyMotors
from deep_curiosity_envs.mujoco_task import MujocoTask
from deep_curiosity_envs.noisy_room import NoisyRoom
from deep_curiosity_envs.pendulum import PendulumSwingup
from deep_curiosity_envs.point_maze import PointMaze
from deep_curiosity_envs.reacher import ReacherSparse
from deep_curiosity_envs.variants import ActionCost, NoiseSwitch
from deep_curiosity_envs.vector import MujocoVectorEnv

__all__ = [
    "ILLUSTRATION_IDS",
    "TASK_IDS",
    "VARIANT_IDS",
    "ActionCost",
    "BatteryRover",
    "CartpoleHiddenVelocity",
    "CartpoleSwingup",
    "CleverRandom",
    "ManyMotors",
    "MujocoTask",
    "MujocoVectorEnv",
    "NoiseSwitch",
    "NoisyRoom",
    "PendulumHiddenVelocity",
    "PendulumSwingup",
    "PointMaze",
    "ReacherSparse",
    "ReliableUnreliable",
]

# Control steps after which Gymnasium truncates an episode.
_EPISODE_STEPS: dict[type[MujocoTask], int] = {
    PendulumSwingup: 200,
    CartpoleSwingup: 200,
    PointMaze: 300,
    ReacherSparse: 100,
    NoisyRoom: 300,
    BatteryRover: 400,
    PendulumHiddenVelocity: 200,
    CartpoleHiddenVelocity: 200,
    ManyMotors: 200,
}


def _register(task: type[gymnasium.Env], num_steps: int | None) -> str:
    """Register the task with Gymnasium, once, and return its id."""
    task_id = f"deep_curiosity/{task.__name__}-v0"
    if task_id not in gymnasium.registry:
        entry_point = f"{task.__module__}:{task.__name__}"
        gymnasium.register(
            task_id,
            entry_point=entry_point,
            vector_entry_point=f"{entry_point}Vector" if issubclass(task, MujocoTask) else None,
            max_episode_steps=num_steps,
        )
    return task_id


ILLUSTRATION_IDS = tuple(_register(task, 100) for task in (CleverRandom, ReliableUnreliable))
"""The paper's two illustrations, for the deep agent: two states, no reward."""
TASK_IDS = tuple(_register(task, num_steps) for task, num_steps in _EPISODE_STEPS.items())
"""The MuJoCo tasks, each of which also has a vector environment of its own."""
VARIANT_IDS = tuple(_register(task, None) for task in (ActionCost, NoiseSwitch))
"""Any other task, made harder; it is given as `env_id`, and its limit of steps stays."""
