"""Episodes in which the agent acts greedily, among those in which it is curious."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


class GreedyEpisodes:
    """Chooses for each episode whether the greedy policy acts in it.

    Args:
        num_envs: Number of environments.
        share: Share of the episodes; random numbers are torch's own.
    """

    def __init__(self, num_envs: int, share: float) -> None:
        self.share = share
        self.is_greedy: NDArray[np.bool_] = np.zeros(num_envs, dtype=bool)
        """Whether the episode in each environment is greedy; the first ones never are."""

    def record(self, ended: np.ndarray) -> None:
        """Choose again where an episode has ended."""
        if self.share == 0:
            return
        for index in np.flatnonzero(ended):
            self.is_greedy[index] = float(torch.rand(())) < self.share

    def state_dict(self) -> dict[str, Any]:
        """Which episodes are greedy."""
        return {"is_greedy": self.is_greedy.tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self.is_greedy = np.array(state["is_greedy"], dtype=bool)
