"""Stretches in which the agent acts greedily, among those in which it is curious."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


class GreedyStretches:
    """Chooses before each step whether the greedy policy acts.

    It takes over anywhere in an episode, where curiosity has led as well as at the start, and lets
    go again after a while: a chain of two states that is left with a fixed probability.

    Args:
        num_envs: Number of environments.
        length: Mean length of a greedy stretch, in steps; longer where the share asks for it,
            since a curious stretch has one step at least.

    Reference: Pislar et al., "When should agents explore?" (2022), on switching within episodes.
    """

    def __init__(self, num_envs: int, length: float) -> None:
        self.length = length
        self.is_greedy: NDArray[np.bool_] = np.zeros(num_envs, dtype=bool)
        """Whether the greedy policy acts in each environment; at first it does in none."""

    def record(self, ended: np.ndarray, share: float) -> None:
        """Choose for the next step, afresh where an episode has ended.

        Args:
            ended: Whether the episode has, in each environment.
            share: Of the steps, that are to be greedy, from 0 and below 1; random numbers are
                torch's own, and none is taken at 0.
        """
        if share == 0:
            return
        odds = share / (1 - share)
        stop = 1 / max(self.length, odds)
        chance = torch.rand(len(ended)).numpy()
        stays = self.is_greedy & ~ended
        threshold = np.where(ended, share, np.where(stays, 1 - stop, stop * odds))
        self.is_greedy = chance < threshold

    def state_dict(self) -> dict[str, Any]:
        """Where the greedy policy acts."""
        return {"is_greedy": self.is_greedy.tolist()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave."""
        self.is_greedy = np.array(state["is_greedy"], dtype=bool)
