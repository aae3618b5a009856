"""Windows of the latest observations and actions, for tasks that show only part of their state.

A window is the latest observations with the actions between them, flattened in the order in which
they came: observation, action, observation, and so on, the newest observation last. When an
episode begins, its first observation stands for those before it, and zero for the actions.
"""

import numpy as np


def window_dim(observation_dim: int, action_dim: int, num_frames: int) -> int:
    """Length of a window of so many observations."""
    return num_frames * observation_dim + (num_frames - 1) * action_dim


def first_window(observation: np.ndarray, action_dim: int, num_frames: int) -> np.ndarray:
    """Windows at the start of episodes, `(*batch, window_dim)`."""
    idle = np.zeros((*observation.shape[:-1], action_dim), observation.dtype)
    past = np.concatenate((observation, idle), axis=-1)
    return np.concatenate((np.tile(past, num_frames - 1), observation), axis=-1)


def next_window(window: np.ndarray, action: np.ndarray, observation: np.ndarray) -> np.ndarray:
    """Windows one step later, `(*batch, window_dim)`."""
    longer = np.concatenate((window, action, observation), axis=-1, dtype=window.dtype)
    return longer[..., -window.shape[-1] :]
