"""Replay a run: episodes of its deterministic policy, and a video of one if asked for."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.arguments import check_folder, read_arguments
from deep_curiosity.configuration import MOST_SEED, Group, setting
from deep_curiosity.training.collector import Episode, evaluate
from deep_curiosity.training.environments import make_environment, task_spaces
from deep_curiosity.training.log import read_config
from deep_curiosity.training.playback import (
    check_video,
    load_policy,
    load_usual_observation,
    make_screen,
    record_episode,
    write_video,
)
from deep_curiosity.training.spaces import check_same_task


@dataclass(frozen=True)
class Args(Group):
    """What to replay."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    episodes: int = setting(10)
    """Episodes to play."""
    seed: int = setting(7, at_least=0, at_most=MOST_SEED)
    """Seed of the resets."""
    hunger: tuple[float, ...] = setting((), at_least=0, at_most=1)
    """Of an agent that is conditioned on it: one or several to play with, from 0, purely curious,
    to 1, purely greedy."""
    video: Path | None = None
    """File for a video of the first episode, at the last hunger, .mp4 or .gif, at the pace of the
    task, a frame for every action; needs MUJOCO_GL=egl
    or osmesa on a machine without a screen."""

    def __post_init__(self) -> None:
        """Refuse a file that could not be written, before anything is played."""
        super().__post_init__()
        check_folder("folder", self.folder)
        check_video(self.video)


def main(arguments: Sequence[str]) -> int:
    """Print returns, and write the video."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity evaluate")
    config = read_config(args.folder)
    environment = make_environment(config.environment)
    check_same_task(task_spaces(environment), args.folder)
    hungers = args.hunger or (None,)
    policies = [load_policy(args.folder, config, environment, hunger=hunger) for hunger in hungers]
    usual = load_usual_observation(args.folder)
    screen = None if args.video is None else make_screen(config.environment)
    for hunger, act in zip(hungers, policies, strict=True):
        episodes = evaluate(
            act, environment, episodes=args.episodes, seed=args.seed, usual_observation=usual
        )
        at = "" if hunger is None else f" at hunger {hunger:g}"
        print(f"{config.environment.env_id}{at}: {describe_returns(episodes)}")
    if screen is not None and args.video is not None:
        frames = record_episode(act, screen, seed=args.seed, usual_observation=usual)
        fps = (screen.metadata.get("render_fps") or 30) / config.environment.action_repeat
        write_video(args.video, frames, fps=fps)
        print(f"video of {len(frames)} frames in {args.video}")
    return 0


def describe_returns(episodes: Sequence[Episode]) -> str:
    """Mean and standard deviation of the returns, in words; broken episodes do not count."""
    returns = [episode.episode_return for episode in episodes if not episode.broken]
    num_broken = len(episodes) - len(returns)
    broken = f" ({num_broken} of {len(episodes)} episodes broke off)" if num_broken else ""
    if not returns:
        return f"return unknown{broken}"
    std = statistics.stdev(returns) if len(returns) > 1 else 0.0
    return f"return {statistics.mean(returns):.2f} +- {std:.2f}{broken}"
