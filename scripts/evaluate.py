"""Replay a run: episodes of its deterministic policy, and a video of one if asked for."""

import statistics
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.training.collector import evaluate
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.playback import load_policy, record_episode, write_video
from deep_curiosity.training.log import read_settings


@dataclass(frozen=True)
class Args:
    """What to replay."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    episodes: int = 10
    """Episodes to play."""
    seed: int = 7
    """Of the resets."""
    hunger: tuple[float, ...] = ()
    """Of a run with a dial: one or several to play with, 0 purely curious to 1 purely greedy."""
    video: Path | None = None
    """File for a video of the first episode, at the last hunger, .mp4 or .gif; needs MUJOCO_GL=egl
    or osmesa on a machine without a screen."""


def main() -> None:
    """Play the episodes and print their returns."""
    args = tyro.cli(Args, description=__doc__)
    try:
        play(args)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")


def play(args: Args) -> None:
    """Print returns, and write the video."""
    settings = read_settings(args.folder)
    make_one = partial(
        make_environment, settings.env_id, settings.env_kwargs, history=settings.history
    )
    environment = make_one()
    for hunger in args.hunger or (None,):
        act = load_policy(args.folder, settings, environment, hunger=hunger)
        episodes = evaluate(act, environment, episodes=args.episodes, seed=args.seed)
        returns = [episode.episode_return for episode in episodes]
        spread = statistics.stdev(returns) if len(returns) > 1 else 0.0
        at = "" if hunger is None else f" at hunger {hunger:g}"
        print(f"{settings.env_id}{at}: return {statistics.mean(returns):.2f} +- {spread:.2f}")
    if args.video is not None:
        screen = make_one(render_mode="rgb_array")
        frames = record_episode(act, screen, seed=args.seed)
        write_video(args.video, frames, fps=screen.metadata.get("render_fps", 30))
        screen.close()
        print(f"video of {len(frames)} frames in {args.video}")
    environment.close()


if __name__ == "__main__":
    main()
