"""Exploration noise that is correlated in time, in the place of the curious policy's own samples.

The greedy policy acts by samples of its own all the same.
All of it has unit variance at every single step, so that the policy's own standard deviation
holds; what differs is how one step's noise is related to the next one's.
"""

import math
from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.requirements import require

REVERSION = 0.15  # of an Ornstein-Uhlenbeck process, per step: that of Lillicrap et al. (2016)
RESAMPLED_STEPS = 64  # of state-dependent noise, until it depends on the state in another way
PINK_STEPS = 1_000  # the longest period in pink noise; an episode's usual length or more


class Noise(ABC):
    """A stream of noise for several environments; random numbers are torch's own.

    Args:
        num_envs: Number of environments.
        action_dim: Length of an action.
    """

    def __init__(self, num_envs: int, action_dim: int) -> None:
        self.shape = (num_envs, action_dim)

    @abstractmethod
    def sample(self, hidden: Float[Tensor, "num_envs width"]) -> Float[Tensor, "num_envs dim"]:
        """Noise of the next step, where the policy's last hidden layer has these activations."""

    @abstractmethod
    def begin(self, index: int) -> None:
        """Forget the past of an environment whose episode begins."""

    @abstractmethod
    def state_dict(self) -> dict[str, Any]:
        """All that the noise to come depends on, but for torch's generator."""

    @abstractmethod
    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""


class OrnsteinUhlenbeckNoise(Noise):
    """Noise that falls back to zero by a share of its distance at every step.

    Reference: Lillicrap et al., "Continuous control with deep reinforcement learning" (2016),
    https://arxiv.org/abs/1509.02971; here with unit variance.
    """

    def __init__(self, num_envs: int, action_dim: int) -> None:
        super().__init__(num_envs, action_dim)
        self._value = torch.randn(self.shape)

    def sample(self, hidden: Float[Tensor, "num_envs width"]) -> Float[Tensor, "num_envs dim"]:
        """A step of the process."""
        kept = 1 - REVERSION
        self._value = kept * self._value + math.sqrt(1 - kept**2) * torch.randn(self.shape)
        return self._value

    def begin(self, index: int) -> None:
        """Start anywhere."""
        self._value[index] = torch.randn(self.shape[1])

    def state_dict(self) -> dict[str, Any]:
        """Value of the process."""
        return {"value": self._value.clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self._value = state["value"].clone()


class StateDependentNoise(Noise):
    """Noise that is a linear function of the policy's last hidden layer, resampled now and then.

    Like states are pushed alike, so that noise is smooth where the policy is. Of the original the
    dependence is kept, and the policy's own standard deviation in the place of learned ones.

    Reference: Raffin et al., "Smooth Exploration for Robotic Reinforcement Learning" (2021),
    https://arxiv.org/abs/2005.05719.
    """

    def __init__(self, num_envs: int, action_dim: int) -> None:
        super().__init__(num_envs, action_dim)
        self._matrix = torch.zeros(num_envs, 0, action_dim)
        self._age = torch.full((num_envs,), RESAMPLED_STEPS)

    def sample(self, hidden: Float[Tensor, "num_envs width"]) -> Float[Tensor, "num_envs dim"]:
        """The function's value, of unit variance over functions."""
        hidden = hidden.cpu()
        num_envs, action_dim = self.shape
        if self._matrix.shape[1] != hidden.shape[1]:
            self._matrix = torch.zeros(num_envs, hidden.shape[1], action_dim)
        for index in torch.nonzero(self._age >= RESAMPLED_STEPS).flatten().tolist():
            self._matrix[index] = torch.randn(hidden.shape[1], action_dim)
            self._age[index] = 0
        self._age += 1
        direction = torch.nn.functional.normalize(hidden, dim=-1)
        return torch.einsum("nw,nwa->na", direction, self._matrix)

    def begin(self, index: int) -> None:
        """Sample another function at the next step."""
        self._age[index] = RESAMPLED_STEPS

    def state_dict(self) -> dict[str, Any]:
        """The functions and their ages."""
        return {"matrix": self._matrix.clone(), "age": self._age.clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self._matrix, self._age = state["matrix"].clone(), state["age"].clone()


class PinkNoise(Noise):
    """Noise whose power falls as one over the frequency: between white and a random walk.

    Raises:
        ImportError: If pink-noise-rl is missing.

    Reference: Eberhard et al., "Pink Noise Is All You Need: Colored Noise Exploration in Deep
    Reinforcement Learning" (2023).
    """

    def __init__(self, num_envs: int, action_dim: int) -> None:
        super().__init__(num_envs, action_dim)
        require("pink", extra="noise")
        from pink import PinkNoiseProcess

        self._make = PinkNoiseProcess
        self._seed = torch.zeros(num_envs, dtype=torch.long)
        self._num_sampled = torch.zeros(num_envs, dtype=torch.long)
        self._processes: list[Any] = [None] * num_envs
        for index in range(num_envs):
            self.begin(index)

    def sample(self, hidden: Float[Tensor, "num_envs width"]) -> Float[Tensor, "num_envs dim"]:
        """The next value of every environment's series."""
        self._num_sampled += 1
        sample = np.stack([process.sample() for process in self._processes])
        return torch.from_numpy(sample.astype(np.float32))

    def begin(self, index: int) -> None:
        """Begin another series."""
        self._restart(index, int(torch.randint(2**31, ())), num_sampled=0)

    def state_dict(self) -> dict[str, Any]:
        """Seed of every series, and how much of it has been sampled."""
        return {"seed": self._seed.clone(), "num_sampled": self._num_sampled.clone()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        for index, (seed, num_sampled) in enumerate(
            zip(state["seed"].tolist(), state["num_sampled"].tolist(), strict=True)
        ):
            self._restart(index, seed, num_sampled)

    def _restart(self, index: int, seed: int, num_sampled: int) -> None:
        self._seed[index], self._num_sampled[index] = seed, num_sampled
        process = self._make((self.shape[1], PINK_STEPS), rng=np.random.default_rng(seed))
        for _ in range(num_sampled):
            process.sample()
        self._processes[index] = process


NOISES: dict[str, type[Noise]] = {
    "gsde": StateDependentNoise,
    "pink": PinkNoise,
    "ou": OrnsteinUhlenbeckNoise,
}
"""By the names of the setting `exploration`."""


def make_noise(name: str, num_envs: int, action_dim: int) -> Noise | None:
    """Noise by the name of the setting `exploration`; `None` for the policy's own samples."""
    return None if name == "policy" else NOISES[name](num_envs, action_dim)
