"""Model and bonus of a run for use: predictions in units of the task, and the bonus, frozen."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from deep_curiosity.bonuses.base import Bonus
from deep_curiosity.bonuses.dynamics import DynamicsEnsemble
from deep_curiosity.bonuses.frozen import FrozenBonus
from deep_curiosity.replay import as_float32, check_seed
from deep_curiosity.trained.policy import (
    ActionBounds,
    as_batch,
    make_policy,
    sizes,
    task_spaces,
)
from deep_curiosity.trained.source import Trained, read_trained
from deep_curiosity.training.checkpoint import load_weights
from deep_curiosity.training.parts import make_run_bonus
from deep_curiosity.training.spaces import TaskSpaces
from deep_curiosity.transitions import check_counts


class Prediction(NamedTuple):
    """The next observation as an ensemble predicts it, in its own units.

    All are `(observation_dim,)` for one observation, `(batch, observation_dim)` for a batch, the
    samples behind an axis of their own. `std ** 2 == epistemic ** 2 + aleatoric ** 2`.
    """

    mean: NDArray[np.float64]
    std: NDArray[np.float64]
    """Standard deviation of all that is not known."""
    epistemic: NDArray[np.float64]
    """Standard deviation between the members' means: what more data would tell."""
    aleatoric: NDArray[np.float64]
    """Standard deviation within the members, root mean square: what no data would tell."""
    samples: NDArray[np.float64]
    """Next observations, each from one member that is chosen by chance."""


class TrainedModel:
    """The dynamics ensemble of a run.

    Args:
        dynamics: Trained ensemble.
        spaces: Of the task.
        num_frames: Observations in a window; the model then predicts windows.
    """

    def __init__(self, dynamics: DynamicsEnsemble, spaces: TaskSpaces, num_frames: int) -> None:
        self.dynamics = dynamics.eval().requires_grad_(False)
        self.spaces = spaces
        self.num_frames = num_frames

    @torch.no_grad()
    def predict(
        self, observation: Any, action: Any, *, num_samples: int = 16, seed: int = 0
    ) -> Prediction:
        """Predict the observation that follows an action.

        Args:
            observation: `(observation_dim,)` or `(batch, observation_dim)`, or dictionaries as the
                task gives them; windows, as `FrameStack` makes them, where the run stacked frames.
            action: `(action_dim,)` or `(batch, action_dim)`, in the task's own units; beyond its
                bounds it counts as at them.
            num_samples: Next observations that are sampled for each.
            seed: Of the samples.

        Raises:
            TypeError: If observation or action is not of real numbers, or the number of samples or
                the seed is no whole number.
            ValueError: If a shape is wrong, a value NaN or infinite, no sample is wanted, or the
                seed is none that torch takes.
        """
        check_counts(num_samples=num_samples)
        check_seed(seed)
        vector = self._vector(observation)
        batch = as_batch("observation", vector, self.dynamics.observation_dim)
        as_float32("action", action)  # refuses what are no numbers
        given = np.asarray(action, dtype=np.float64)  # a box far from zero is wider than float32
        actions = self.spaces.from_task(as_batch("action", given, self.dynamics.action_dim))
        if len(batch) != len(actions):
            raise ValueError(
                f"`action` must be one for each observation, {len(batch)}, got {len(actions)}."
            )
        found = self._predict(
            torch.from_numpy(batch), torch.from_numpy(actions), int(num_samples), seed
        )
        single = vector.ndim == 1
        return Prediction(*(value[..., 0, :] if single else value for value in found))

    def _vector(self, observation: Any) -> NDArray[np.float32]:
        vector = self.spaces.to_vector(observation)
        dim = self.dynamics.observation_dim
        if self.num_frames > 1 and vector.shape[-1:] != (dim,):
            raise ValueError(
                f"`observation` must be a window of {self.num_frames} observations with the "
                f"actions between them, {dim} entries as `FrameStack` makes it, got shape "
                f"{vector.shape}."
            )
        return vector

    def _predict(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        num_samples: int,
        seed: int,
    ) -> list[NDArray[np.float64]]:
        """Mean, the three standard deviations, and samples, `(batch, observation_dim)` each."""
        means, variances = self.dynamics.change(observation, action)
        epistemic, aleatoric = means.var(0, correction=0), variances.mean(0)
        generator = torch.Generator().manual_seed(int(seed))
        shape = num_samples, *observation.shape
        noise = torch.randn(shape, generator=generator, dtype=torch.float64)
        choice = torch.rand(num_samples, len(observation), generator=generator)
        samples = self.dynamics.sample_change(observation, action, noise, choice)
        values = [
            observation + means.mean(0),
            (epistemic + aleatoric).sqrt(),
            epistemic.sqrt(),
            aleatoric.sqrt(),
            observation + samples,
        ]
        return [value.numpy() for value in values]


def load_model(folder: str | Path, *, action_bounds: ActionBounds | None = None) -> TrainedModel:
    """Load the model of the next observation that a run has learned.

    Args:
        folder: Of a finished or interrupted run, or of an export of safetensors.
        action_bounds: As for `load`.

    Raises:
        FileNotFoundError: If the folder holds neither.
        TypeError: If `folder` is no path.
        ValueError: If the bonus of the run learns no such model, or the bounds are missing.
    """
    trained = read_trained(folder)
    dynamics = getattr(_make_bonus(trained), "dynamics", None)
    if not isinstance(dynamics, DynamicsEnsemble):
        raise ValueError(
            "`folder` must be of a run whose bonus predicts the next observation, such as "
            f"curiosity, got bonus {trained.config.bonus.kind!r} in {folder}."
        )
    spaces = task_spaces(trained, make_policy(trained), action_bounds)
    return TrainedModel(dynamics, spaces, trained.config.environment.frame_stack)


def load_bonus(folder: str | Path) -> FrozenBonus:
    """Load the bonus of a run as it is now, for good: it neither learns nor observes.

    Args:
        folder: Of a finished or interrupted run, or of an export of safetensors.

    Returns:
        The bonus, on the CPU: it takes tensors, actions in [-1, 1], and may be given to whatever
        takes a bonus.

    Raises:
        FileNotFoundError: If the folder holds neither.
        TypeError: If `folder` is no path.
        ValueError: If the run has no bonus.
    """
    trained = read_trained(folder)
    bonus = _make_bonus(trained)
    if bonus is None:
        raise ValueError(f"`folder` must be of a run with a bonus, got bonus 'none' in {folder}.")
    return FrozenBonus(bonus)


def _make_bonus(trained: Trained) -> Bonus | None:
    """Bonus of a run with its weights, or `None` where it has none."""
    bonus = make_run_bonus(trained.config, *sizes(trained), trained.spaces)
    if bonus is not None:
        load_weights(bonus, trained.bonus, trained.folder)
    return bonus
