"""What an agent with a bonus must answer to be checked, whichever library it is from."""

from abc import ABC, abstractmethod
from pathlib import Path

from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.transitions import Transition


class Integration(ABC):
    """An agent with a bonus, as the check handles it; each adapter has its own."""

    @property
    @abstractmethod
    def bonus(self) -> Bonus:
        """The bonus in use, not a copy."""

    @abstractmethod
    def collect(self, num_steps: int, *, seed: int) -> Transition:
        """Reset the environment with a seed, act for some steps and store them; learn nothing.

        The agent's own random numbers are seeded alike, so that the same agent collects the same.

        Returns:
            What the environment gave, in the order of storing: the reward raw, the next
            observation the true one also where an episode ended, actions in [-1, 1].
        """

    @abstractmethod
    def stored(self) -> Transition:
        """All that is stored, oldest first, as it is stored, in the units of the environment."""

    @abstractmethod
    def learn(self, *, seed: int) -> None:
        """Update critic and actor from what is stored, once each or some times.

        Seeds all random numbers, so that the same agent learns the same.
        """

    @abstractmethod
    def critic(self) -> list[Tensor]:
        """Parameters of the critic that learns from the bonus."""

    @abstractmethod
    def actor(self) -> list[Tensor]:
        """Parameters of the actor."""

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Save agent, bonus and what is stored, as a user of the adapter would."""

    @abstractmethod
    def load(self, folder: Path) -> "Integration":
        """Another agent, as `save` left it in the folder, with an environment of its own."""

    def release(self) -> None:  # noqa: B027  # most change nothing
        """Give back what was changed of the agent for the check alone; by default nothing was."""
