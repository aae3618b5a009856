"""Play an agent that comes with the package, by what it takes to use any trained one."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Literal

import gymnasium
import numpy as np
import tyro
from numpy.typing import NDArray

from deep_curiosity.arguments import read_arguments
from deep_curiosity.configuration import MOST_SEED, Group, setting
from deep_curiosity.trained.policy import TrainedPolicy, load
from deep_curiosity.training.config import EnvironmentConfig
from deep_curiosity.training.environments import registered_id
from deep_curiosity.training.playback import check_video, write_video

DEMOS = files("deep_curiosity") / "demos"


@dataclass(frozen=True)
class Args(Group):
    """What to play."""

    agent: Annotated[Literal["maze", "pendulum", "rover"], tyro.conf.Positional] = "maze"
    """Finds a goal behind two walls; swings a pole up by a motor too weak to lift it; or roams
    while its battery lasts."""
    episodes: int = setting(3)
    """Episodes to play."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Seed of the first reset; each episode has the next."""
    video: Path | None = None
    """File for a video of the first episode, .mp4 or .gif; needs MUJOCO_GL=egl or osmesa on a
    machine without a screen."""


def main(arguments: Sequence[str]) -> int:
    """Print the return of every episode, and write the video."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity demo")
    check_video(args.video)
    with as_file(DEMOS / args.agent) as folder:
        policy = load(folder)
    task = policy.config.environment
    environment = make_task(task)
    for number in range(args.episodes):
        rewards = list(play(policy, environment, seed=args.seed + number))
        print(f"{task.env_id}: return {sum(rewards):.2f} in {len(rewards)} steps")
    environment.close()
    if args.video is not None:
        film(policy, args.video, seed=args.seed)
        print(f"video of the first episode in {args.video}")
    return 0


def make_task(task: EnvironmentConfig, *, filmed: bool = False) -> gymnasium.Env:
    """The task as Gymnasium makes it: a policy needs none of the trainer's wrappers."""
    env_kwargs: dict[str, Any] = {
        **task.env_kwargs,
        "render_mode": "rgb_array" if filmed else None,
    }
    return gymnasium.make(registered_id(task.env_id), **env_kwargs)


def play(policy: TrainedPolicy, environment: gymnasium.Env, *, seed: int) -> Iterator[float]:
    """Rewards of one episode."""
    observation, _ = environment.reset(seed=seed)
    ended = False
    while not ended:
        action, _ = policy.predict(observation)
        observation, reward, terminated, truncated, _ = environment.step(action)
        ended = terminated or truncated
        yield float(reward)


def film(policy: TrainedPolicy, path: Path, *, seed: int) -> None:
    """Write a video of one episode."""
    environment = make_task(policy.config.environment, filmed=True)
    frames: list[NDArray[np.uint8]] = []
    for _ in play(policy, environment, seed=seed):
        frame = environment.render()
        assert isinstance(frame, np.ndarray)
        frames.append(frame)
    write_video(path, frames, fps=environment.metadata["render_fps"])
    environment.close()
