"""Playing a trained agent back: its weights from a checkpoint, its episodes as video."""

from pathlib import Path
from typing import Any

import gymnasium
import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.training.checkpoint import load_checkpoint
from deep_curiosity.training.collector import Collector, Episode, Policy, as_batch
from deep_curiosity.training.config import Config
from deep_curiosity.training.divergence import DivergedError, broken_weight
from deep_curiosity.training.environments import action_dim, observation_dim
from deep_curiosity.training.hunger import make_hunger_controller
from deep_curiosity.training.learner import make_agent, make_evaluation_policy


def load_agent(folder: Path, config: Config, environment: gymnasium.Env) -> CuriousSAC:
    """Agent of a finished or interrupted run, as its newest checkpoint has it.

    Raises:
        DivergedError: If its policy is not finite.
        FileNotFoundError: If the folder holds no readable checkpoint.
    """
    agent = make_agent(config, observation_dim(environment), action_dim(environment))
    agent.load_state_dict(load_checkpoint(folder)["learner"]["agent"])
    broken = broken_weight(policy=agent.policy)
    if broken is not None:
        raise DivergedError(f"{broken}, in the checkpoint in {folder}: the run has diverged.")
    return agent


def load_policy(
    folder: Path, config: Config, environment: gymnasium.Env, *, hunger: float | None = None
) -> Policy:
    """Deterministic policy of a run, as its newest checkpoint has it.

    Args:
        folder: Of a finished or interrupted run.
        config: Settings of the run.
        environment: To be acted in.
        hunger: Of an agent that is conditioned on it, in [0, 1]; by default as in the run's own
            evaluations.

    Raises:
        DivergedError: If its policy is not finite.
        FileNotFoundError: If the folder holds no readable checkpoint.
        ValueError: If a hunger is given to an agent that is not conditioned on it.
    """
    agent = load_agent(folder, config, environment)
    if hunger is None:
        return make_evaluation_policy(agent, make_hunger_controller(config, agent.observation_dim))
    if not isinstance(config.agent.hunger, ConditionedHunger):
        raise ValueError(
            "`hunger` can only be chosen where the agent is conditioned on it (--hunger random, "
            f"bandit, battery or conditioned:VALUE), got {hunger} for {config.agent.hunger}."
        )
    agent.hunger = hunger
    return lambda observation, info: agent.act(observation, deterministic=True, greedy=True)


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
        action = act(as_batch(collector.observation), collector.present_info).numpy()
        _, finished = collector.step(action)
        if not finished:
            frames.append(_frame(environment))
    return frames


def write_video(path: Path, frames: list[NDArray[np.uint8]], *, fps: int) -> None:
    """Write frames to a new file whose suffix names the format, such as .mp4 or .gif.

    Raises:
        FileExistsError: If the file is there.
    """
    check_new(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pace: dict[str, Any] = {"duration": 1000 / fps} if path.suffix == ".gif" else {"fps": fps}
    imageio.mimwrite(path, list(frames), **pace)


def check_new(path: Path) -> None:
    """Refuse to write over a video.

    Raises:
        FileExistsError: If the file is there.
    """
    if path.exists():
        raise FileExistsError(f"`video` must name a new file, got {path}, which is there.")


def _frame(environment: gymnasium.Env) -> NDArray[np.uint8]:
    frame = environment.render()
    assert isinstance(frame, np.ndarray)
    return frame
