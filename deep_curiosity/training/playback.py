"""Playing a trained agent back: its weights from a checkpoint, its episodes as video."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.arguments import check_file
from deep_curiosity.requirements import require
from deep_curiosity.training.checkpoint import load_checkpoint, load_weights, usual_observation_of
from deep_curiosity.training.collector import Collector, Episode, as_batch
from deep_curiosity.training.config import Config, EnvironmentConfig
from deep_curiosity.training.divergence import DivergedError, broken_weight
from deep_curiosity.training.environments import action_dim, make_environment, observation_dim
from deep_curiosity.training.hunger import make_hunger_controller
from deep_curiosity.training.interfaces import Policy
from deep_curiosity.training.learner import make_evaluation_policy
from deep_curiosity.training.log import written_whole
from deep_curiosity.training.parts import make_agent


def load_agent(folder: Path, config: Config, environment: gymnasium.Env) -> CuriousSAC:
    """Agent of a finished or interrupted run, as its newest checkpoint has it.

    Raises:
        DivergedError: If its policy is not finite.
        FileNotFoundError: If the folder holds no readable checkpoint.
        ValueError: If the settings are not those of the run.
    """
    return _agent_of(load_checkpoint(folder), folder, config, environment)


def _agent_of(
    state: dict[str, Any], folder: Path, config: Config, environment: gymnasium.Env
) -> CuriousSAC:
    agent = make_agent(config, observation_dim(environment), action_dim(environment))
    load_weights(agent, state["learner"]["agent"], folder)
    broken = broken_weight(policy=agent.policy)
    if broken is not None:
        raise DivergedError(f"{broken}, in the checkpoint in {folder}: the run has diverged.")
    return agent


def load_usual_observation(folder: Path) -> NDArray[Any] | None:
    """Sizes that the run has found usual, `(observation_dim,)`; `None` where it is too old to say.

    Raises:
        FileNotFoundError: If the folder holds no readable checkpoint.
    """
    usual = usual_observation_of(load_checkpoint(folder))
    return None if usual is None else usual.numpy()


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
    state = load_checkpoint(folder)
    agent = _agent_of(state, folder, config, environment)
    if hunger is None:
        if state["learner"].get("has_hunger_function"):
            warnings.warn(
                f"`hunger` was a function of the caller's own in the run in {folder}; it is "
                f"played at {config.agent.hunger}.",
                stacklevel=2,
            )
        return make_evaluation_policy(
            config, agent, make_hunger_controller(config, agent.observation_dim, agent.action_dim)
        )
    if not isinstance(config.agent.hunger, ConditionedHunger):
        raise ValueError(
            "`hunger` can only be chosen where the agent is conditioned on it (--hunger random, "
            f"bandit, battery or conditioned:VALUE), got {hunger} for {config.agent.hunger}."
        )
    agent.hunger = hunger
    return lambda observation, info: agent.act(observation, deterministic=True, greedy=True)


def make_screen(config: EnvironmentConfig) -> gymnasium.Env:
    """Environment that can be filmed, which it has shown by a frame.

    Args:
        config: Of a task that can be made; how it is rendered is the question.

    Raises:
        ValueError: If the task renders nothing.
    """
    try:
        screen = make_environment(config, render_mode="rgb_array")
    except ValueError as error:  # of a class that takes no such argument, or not this mode
        raise _unfilmed(config.env_id) from error
    screen.reset(seed=0)
    try:
        _frame(screen)
    except NotImplementedError as error:
        raise _unfilmed(config.env_id) from error
    return screen


def record_episode(
    act: Policy,
    environment: gymnasium.Env,
    *,
    seed: int,
    usual_observation: NDArray[Any] | None = None,
) -> list[NDArray[np.uint8]]:
    """Frames, height x width x RGB, of one episode.

    Args:
        act: The policy that is played.
        environment: Made with `render_mode="rgb_array"`.
        seed: Of the reset.
        usual_observation: That of the policy's run, see `load_usual_observation`.

    Raises:
        ValueError: If the environment renders something else than a frame.
    """
    collector = Collector(environment, seed, usual_observation=usual_observation)
    frames = [_frame(environment)]
    finished: list[Episode] = []
    while not finished:
        action = act(as_batch(collector.observation), collector.present_info).numpy()
        _, finished = collector.step(action)
        if not finished:
            frames.append(_frame(environment))
    return frames


def check_video(path: Path | None) -> None:
    """Refuse a video that could not be written, before anything is played.

    Raises:
        FileExistsError: If the file is there.
        ImportError: If imageio is missing.
        ValueError: If it is no file of a known format, or its folder cannot be one.
    """
    if path is None:
        return
    require("imageio", extra="video")
    check_file("video", path)
    if path.suffix not in (".mp4", ".gif"):
        raise ValueError(f"`video` must be a file .mp4 or .gif, got {path}.")
    check_new(path)


def write_video(path: Path, frames: list[NDArray[np.uint8]], *, fps: float) -> None:
    """Write frames to a new file, whose suffix names the format, whole or not at all.

    Raises:
        FileExistsError: If the file is there.
        ImportError: If imageio is missing.
    """
    require("imageio", extra="video")
    import imageio.v2 as imageio

    check_new(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    pace: dict[str, Any] = {"duration": 1000 / fps} if path.suffix == ".gif" else {"fps": fps}
    with written_whole(path) as partial:
        imageio.mimwrite(partial, list(frames), **pace)


def check_new(path: Path) -> None:
    """Refuse to write over a video.

    Raises:
        FileExistsError: If the file is there.
    """
    if path.exists():
        raise FileExistsError(f"`video` must name a new file, got {path}, which is there.")


def _frame(environment: gymnasium.Env) -> NDArray[np.uint8]:
    frame = environment.render()
    if not isinstance(frame, np.ndarray):
        raise _unfilmed(f"{environment}, whose frame is {frame!r:.60}")
    return frame.copy()  # a renderer may draw the next one into the same array


def _unfilmed(task: str) -> ValueError:
    return ValueError(
        f"`video` must be left out for a task that renders no rgb_array, got {task}."
    )
