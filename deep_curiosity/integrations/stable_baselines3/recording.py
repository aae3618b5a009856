"""What really happens in a vector environment, written down where it happens."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from deep_curiosity.integrations.stable_baselines3.attachment import BonusAttachment
from deep_curiosity.integrations.stable_baselines3.normalization import end_of
from deep_curiosity.integrations.stable_baselines3.spaces import batch_of, mask_of, scaled
from deep_curiosity.transitions import Transition


@contextmanager
def recorded(env: VecEnv, attachment: BonusAttachment) -> Iterator[list[Transition]]:
    """Record each step of a vector environment, before what is above it can change it."""
    steps: list[Transition] = []
    latest: dict[str, Any] = {}
    reset, step_async, step_wait = env.reset, env.step_async, env.step_wait

    def reset_and_note() -> Any:
        latest["observation"] = reset()
        return latest["observation"]

    def note_action(action: np.ndarray) -> None:
        latest["action"] = np.array(action)
        step_async(action)

    def step_and_record() -> Any:
        next_observation, reward, done, infos = step_wait()
        step = latest["observation"], latest["action"], reward, next_observation, done, infos
        steps.append(_ground_truth(attachment, *step))
        latest["observation"] = next_observation
        return next_observation, reward, done, infos

    spies = {"reset": reset_and_note, "step_async": note_action, "step_wait": step_and_record}
    own = vars(env)
    before = {name: own[name] for name in spies if name in own}
    own.update(spies)
    try:
        yield steps
    finally:
        for name in spies:
            del own[name]
        own.update(before)


def _ground_truth(
    attachment: BonusAttachment,
    observation: Any,
    action: np.ndarray,
    reward: np.ndarray,
    next_observation: Any,
    done: np.ndarray,
    infos: list[dict[str, Any]],
) -> Transition:
    """A step of all environments, copied before any wrapper can change it."""
    final = np.array(attachment.select_observation(next_observation))
    for index in np.flatnonzero(done):
        final[index] = attachment.select_observation(end_of(infos[index]))
    timeout = np.array([info.get("TimeLimit.truncated", False) for info in infos])
    return Transition(
        observation=batch_of(attachment.select_observation(observation)),
        action=batch_of(scaled(action, attachment.action_space)),
        reward=batch_of(reward),
        next_observation=batch_of(final),
        terminated=mask_of(done & ~timeout),
        truncated=mask_of(done & timeout),
    )


@contextmanager
def postponed(owner: object, name: str) -> Iterator[None]:
    """Let a method do nothing for a while."""
    setattr(owner, name, lambda *_, **__: None)
    try:
        yield
    finally:
        delattr(owner, name)
