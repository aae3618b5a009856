"""A short profile of an environment: range and tails of its observations."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require

require("gymnasium", extra="envs")

from dataclasses import dataclass

import gymnasium
import numpy as np

HEAVY_TAIL = 10.0  # excess kurtosis; 0 for a Gaussian, 3 for a Laplace distribution
STILL_STD = 1e-6  # below it a feature is constant


@dataclass(frozen=True)
class Profile:
    """Observations of an environment under uniformly random actions."""

    observation: np.ndarray
    """`(num_steps, observation_dim)`, in the environment's units."""
    num_episodes: int
    """That ended."""
    num_not_finite: int
    """Observations and rewards that were NaN or infinite, and are left out."""
    reward_range: tuple[float, float]

    def features(self) -> list[dict[str, str]]:
        """A row for every feature: range, standard deviation, tails, and a warning if any."""
        rows = []
        for index, value in enumerate(self.observation.T.astype(np.float64)):
            std = value.std()
            still = not std > STILL_STD
            kurtosis = 0.0 if still else (((value - value.mean()) / std) ** 4).mean() - 3
            note = "never moves" if still else "heavy tail" if kurtosis > HEAVY_TAIL else ""
            rows.append(
                {
                    "feature": str(index),
                    "lowest": f"{value.min():.4g}",
                    "highest": f"{value.max():.4g}",
                    "std": f"{std:.3g}",
                    "excess kurtosis": f"{kurtosis:.2g}",
                    "note": note,
                }
            )
        return rows


def profile(environment: gymnasium.Env, *, num_steps: int = 2_000, seed: int = 0) -> Profile:
    """Take uniformly random actions and record the observations.

    Args:
        environment: With vector observations and actions in [-1, 1].
        num_steps: Steps to take.
        seed: Of the first reset and of the actions.

    Raises:
        ValueError: If no observation was finite.
    """
    random = np.random.default_rng(seed)
    environment.reset(seed=seed)
    observations, rewards = [], []
    num_episodes = num_not_finite = 0
    for _ in range(num_steps):
        action = random.uniform(-1, 1, environment.action_space.shape).astype(np.float32)
        observation, reward, terminated, truncated, _ = environment.step(action)
        if np.isfinite(observation).all() and np.isfinite(float(reward)):
            observations.append(np.array(observation))
            rewards.append(float(reward))
        else:
            num_not_finite += 1
        if terminated or truncated:
            num_episodes += 1
            environment.reset()
    if not observations:
        raise ValueError(f"`observation` must be finite, got none that is in {num_steps} steps.")
    return Profile(
        np.stack(observations), num_episodes, num_not_finite, (min(rewards), max(rewards))
    )
