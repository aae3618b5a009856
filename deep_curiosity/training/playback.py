"""Playing a trained agent back: its weights from a checkpoint, its episodes as video."""

from pathlib import Path

import gymnasium
import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray

from deep_curiosity.agent import CuriousActorCritic
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collection import Collector, Episode, as_batch
from deep_curiosity.training.environments import action_dim, observation_dim
from deep_curiosity.training.learner import make_agent
from deep_curiosity.training.settings import Settings


def load_agent(folder: Path, settings: Settings, environment: gymnasium.Env) -> CuriousActorCritic:
    """Agent of a finished or interrupted run, as its newest checkpoint has it.

    Raises:
        FileNotFoundError: If the folder holds no readable checkpoint.
    """
    agent = make_agent(settings, observation_dim(environment), action_dim(environment))
    agent.load_state_dict(load_checkpoint(folder)["learner"]["agent"])
    return agent


def record_episode(
    agent: CuriousActorCritic, environment: gymnasium.Env, *, seed: int
) -> list[NDArray[np.uint8]]:
    """Frames, height x width x RGB, of one episode of the deterministic policy.

    Args:
        agent: Whose policy is played.
        environment: Made with `render_mode="rgb_array"`.
        seed: Of the reset.
    """
    collector = Collector(environment, seed)
    frames = [_frame(environment)]
    finished: list[Episode] = []
    while not finished:
        action = agent.act(as_batch(collector.observation), deterministic=True)[0].numpy()
        _, finished = collector.step(action)
        if not finished:
            frames.append(_frame(environment))
    return frames


def write_video(path: Path, frames: list[NDArray[np.uint8]], *, fps: int) -> None:
    """Write frames to a file whose suffix names the format, such as .mp4 or .gif."""
    path.parent.mkdir(parents=True, exist_ok=True)
    imageio.mimwrite(path, list(frames), fps=fps)


def _frame(environment: gymnasium.Env) -> NDArray[np.uint8]:
    frame = environment.render()
    assert isinstance(frame, np.ndarray)
    return frame
