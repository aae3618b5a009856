"""Replay a run: episodes of its deterministic policy, and a video of one if asked for."""

import statistics
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.training.collector import evaluate
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.log import read_config
from deep_curiosity.training.playback import (
    check_new,
    load_policy,
    record_episode,
    write_video,
)


@dataclass(frozen=True)
class Args:
    """What to replay."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    episodes: int = 10
    """Episodes to play."""
    seed: int = 7
    """Seed of the resets."""
    hunger: tuple[float, ...] = ()
    """Of an agent that is conditioned on it: one or several to play with, from 0, purely curious,
    to 1, purely greedy."""
    video: Path | None = None
    """New file for a video of the first episode, at the last hunger, .mp4 or .gif; needs
    MUJOCO_GL=egl or osmesa on a machine without a screen."""


def main(args: Args) -> None:
    """Print returns, and write the video."""
    config = read_config(args.folder)
    if args.video is not None:
        check_new(args.video)  # before anything is played
    environment = make_environment(config.environment)
    for hunger in args.hunger or (None,):
        act = load_policy(args.folder, config, environment, hunger=hunger)
        episodes = evaluate(act, environment, episodes=args.episodes, seed=args.seed)
        returns = [episode.episode_return for episode in episodes]
        std = statistics.stdev(returns) if len(returns) > 1 else 0.0
        at = "" if hunger is None else f" at hunger {hunger:g}"
        mean = statistics.mean(returns)
        print(f"{config.environment.env_id}{at}: return {mean:.2f} +- {std:.2f}")
    if args.video is not None:
        screen = make_environment(config.environment, render_mode="rgb_array")
        frames = record_episode(act, screen, seed=args.seed)
        write_video(args.video, frames, fps=screen.metadata.get("render_fps", 30))
        print(f"video of {len(frames)} frames in {args.video}")


if __name__ == "__main__":
    try:
        main(tyro.cli(Args, description=__doc__))
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")
