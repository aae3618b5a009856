"""Playing a trained agent back: its weights from a checkpoint, its episodes as video."""

from pathlib import Path

import gymnasium
import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray

from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collector import Collector, Episode, Policy, as_batch
from deep_curiosity.training.environments import action_dim, observation_dim
from deep_curiosity.training.hunger import make_hunger_controller
from deep_curiosity.training.learner import evaluation_policy, make_agent
from deep_curiosity.training.config import Settings


def load_agent(folder: Path, settings: Settings, environment: gymnasium.Env) -> CuriousSAC:
    """Agent of a finished or interrupted run, as its newest checkpoint has it.

    Raises:
        FileNotFoundError: If the folder holds no readable checkpoint.
    """
    agent = make_agent(settings, observation_dim(environment), action_dim(environment))
    agent.load_state_dict(load_checkpoint(folder)["learner"]["agent"])
    return agent


def load_policy(
    folder: Path, settings: Settings, environment: gymnasium.Env, *, hunger: float | None = None
) -> Policy:
    """Deterministic policy of a run, as its newest checkpoint has it.

    Args:
        folder: Of a finished or interrupted run.
        settings: Of the run.
        environment: To be acted in.
        hunger: Of a run with a dial, in [0, 1]; by default as in the run's own evaluations.

    Raises:
        FileNotFoundError: If the folder holds no readable checkpoint.
        ValueError: If a hunger is given that the agent cannot be told.
    """
    if hunger is not None and not settings.has_dial:
        raise ValueError(
            "`hunger` can only be chosen where the run has a dial (--hunger-control dial, draws, "
            f"bandit or battery), got {hunger} for {settings.hunger_control!r}."
        )
    agent = load_agent(folder, settings, environment)
    if hunger is None:
        return evaluation_policy(agent, make_hunger_controller(settings, agent.observation_dim))
    agent.hunger = hunger
    return lambda observation, info: agent.act(observation, deterministic=True)


def record_episode(
    act: Policy, environment: gymnasium.Env, *, seed: int
) -> list[NDArray[np.uint8]]:
    """Frames, height x width x RGB, of one episode.

    Args:
        act: The policy that is played.
        environment: Made with `render_mode="rgb_array"`.
        seed: Of the reset.
    """
    collector = Collector(environment, seed)
    frames = [_frame(environment)]
    finished: list[Episode] = []
    while not finished:
        action = act(as_batch(collector.observation), collector.present_info)[0].numpy()
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
