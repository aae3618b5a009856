"""A trained policy for use: NumPy in, actions in the task's own units out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.agent.networks import GaussianPolicy
from deep_curiosity.nn.statistics import InputScaling
from deep_curiosity.replay import as_float32
from deep_curiosity.trained.source import Trained, Weights, read_trained
from deep_curiosity.training.checkpoint import load_weights
from deep_curiosity.training.hunger import battery_hunger
from deep_curiosity.training.outliers import cut_absurd
from deep_curiosity.training.spaces import SPACES, TaskSpaces
from deep_curiosity.training.windows import first_window, next_window
from deep_curiosity.transitions import check_flags

State = tuple[np.ndarray, ...]
"""What a policy on a frame stack remembers: its windows, and the actions it gave, in [-1, 1]."""
Numbers = np.ndarray | np.generic | Sequence[float | int] | float | int
ActionBounds = tuple[Numbers, Numbers]
Real = TypeVar("Real", bound=np.floating)


class TrainedPolicy:
    """The policy of a run. `predict` has the arguments of Stable-Baselines3's.

    Args:
        trained: Settings and weights of a run.
        action_bounds: Least and largest action of the task, `(action_dim,)` each, where the run
            did not write them down.

    Raises:
        ValueError: If the bounds are missing, or given twice, or are none.
    """

    def __init__(self, trained: Trained, action_bounds: ActionBounds | None = None) -> None:
        self.config = trained.config
        self.network = make_policy(trained)
        self.scaling = make_scaling(trained)
        self.usual_observation = trained.usual_observation
        self.num_frames = trained.config.environment.frame_stack
        self.spaces = task_spaces(trained, self.network, action_bounds)

    @property
    def is_conditioned(self) -> bool:
        """Whether `predict` takes a hunger."""
        return self.config.agent.is_conditioned

    @property
    def has_curious_policy(self) -> bool:
        """Whether there is a curious policy beside the greedy one."""
        return self.network.network.members > 1

    @torch.no_grad()
    def predict(
        self,
        observation: Any,
        state: State | None = None,
        episode_start: Numbers | None = None,
        deterministic: bool = True,
        *,
        curious: bool = False,
        hunger: Numbers | None = None,
    ) -> tuple[NDArray[Any], State | None]:
        """Choose actions.

        An entry of an observation that is absurd, beyond a hundred times its usual size in the
        run, is taken to be of that size, as it was in training.

        Args:
            observation: `(observation_dim,)` or `(batch, observation_dim)`, or dictionaries as the
                task gives them; always a single observation of the task, also where the run
                stacked frames.
            state: Returned by the call before, where the run stacked frames: the window is kept in
                it. `None` where every episode begins, or there is no stack.
            episode_start: Where the state is to be forgotten: one flag, or `(batch,)`.
            deterministic: Take the centre of the policy; otherwise sample, from torch's own
                random stream.
            curious: Act by the curious policy in the place of the greedy one, which wants reward
                alone and acts in the run's own evaluations.
            hunger: Of a run that is conditioned on it: from 0, purely curious, to 1, purely
                greedy; one or `(batch,)`. By default as in the run's own evaluations.

        Returns:
            Actions in the task's own units and type, `(action_dim,)` or `(batch, action_dim)`; and
            what is to be given as `state` to the next call, `None` without a stack.

        Raises:
            TypeError: If an argument is not of real numbers, or `deterministic` or `curious` is
                neither True nor False.
            ValueError: If the observation has another shape, or an entry that is NaN, infinite or
                beyond float32, or an argument is out of place in this run.
        """
        check_flags(deterministic=deterministic, curious=curious)
        if curious and not self.has_curious_policy:
            raise ValueError("`curious` must be False for a run with one policy, got True.")
        vector = self.spaces.to_vector(observation)
        batch = as_batch("observation", vector, self.spaces.observation_dim)
        begins = _flags("episode_start", episode_start, len(batch))
        window = self._window(batch, state, begins)
        entered = self._policy_input(self._cut(window), hunger)
        mixture = self.network(torch.from_numpy(entered), -1 if curious else 0)
        if deterministic:
            pre_action = mixture.select(mixture.log_weight.argmax(-1))[0]
        else:
            pre_action = mixture.sample()
        action = torch.tanh(pre_action).numpy()
        chosen = self.spaces.to_task(action)
        state = (window, action) if self.num_frames > 1 else None
        return (chosen[0] if vector.ndim == 1 else chosen), state

    def _window(
        self, batch: NDArray[np.float32], state: State | None, begins: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """What the policy is shown: the observations, or windows of them."""
        if self.num_frames == 1:
            return batch
        first = first_window(batch, len(self.spaces.action_low), self.num_frames)
        if state is None:
            return first
        window, action = _as_state(state, first.shape, (len(batch), len(self.spaces.action_low)))
        later = next_window(window, action, batch)
        return np.where(begins[:, None], first, later)

    def _cut(self, window: NDArray[np.float32]) -> NDArray[np.float32]:
        """The windows with nothing absurd in them, as the run was shown them."""
        usual = self.usual_observation
        return window if usual is None else cut_absurd(window, usual.numpy())

    def _policy_input(
        self, window: NDArray[np.float32], hunger: Numbers | None
    ) -> NDArray[np.float32]:
        """The windows as they are seen, and behind them the hunger of a run conditioned on it."""
        seen = window
        if self.scaling is not None:
            seen = self.scaling(torch.from_numpy(window)).numpy()
        if not self.is_conditioned:
            if hunger is not None:
                raise ValueError(
                    "`hunger` must be left out for a run that is not conditioned on it "
                    f"(--hunger random, bandit, battery or conditioned:VALUE), got {hunger}."
                )
            return seen
        chosen = self._default_hunger(window) if hunger is None else _hunger(hunger, len(window))
        column = np.broadcast_to(chosen, len(window))[:, None]
        return np.concatenate([seen, column], axis=-1, dtype=np.float32)

    def _default_hunger(self, window: NDArray[np.float32]) -> NDArray[Any]:
        """As in the run's own evaluations: all for reward, or as a battery says."""
        source = self.config.agent.hunger
        assert isinstance(source, ConditionedHunger)
        if source.source != "battery":
            return np.ones(())
        if isinstance(source.entry, str):
            raise ValueError(
                f"`hunger` must be given where it depends on {source.entry!r}, which is no part "
                "of the observation, got None."
            )
        return np.asarray(battery_hunger(source.entry, self.spaces.observation_dim)(window, {}))


def load(folder: str | Path, *, action_bounds: ActionBounds | None = None) -> TrainedPolicy:
    """Load the policy of a run, as its newest checkpoint has it, or one that was exported.

    Args:
        folder: Of a finished or interrupted run, or of an export of safetensors.
        action_bounds: Least and largest action of the task, for a run that did not write them
            down.

    Returns:
        The policy, on the CPU, whose `predict` gives actions.

    Raises:
        FileNotFoundError: If the folder holds neither.
        TypeError: If `folder` is no path.
        ValueError: If the bounds are missing, or given twice, or are none.
    """
    return TrainedPolicy(read_trained(folder), action_bounds)


def make_policy(trained: Trained) -> GaussianPolicy:
    """Policies of a run, stacked; all sizes are those of the weights."""
    weights = hidden_weights(trained.policy)
    policies, input_dim, _ = weights[0].shape
    components = trained.config.agent.mixture_components
    policy = GaussianPolicy(
        input_dim,
        ((weights[-1].shape[-1] + 1) // components - 1) // 2,
        policies=policies,
        mixture_components=components,
        hidden_dims=[weight.shape[-1] for weight in weights[:-1]],
    )
    load_weights(policy, trained.policy, trained.folder)
    policy.float()  # whatever the default is here
    return policy.eval().requires_grad_(False)


def make_scaling(trained: Trained) -> InputScaling | None:
    """What brings the policy's observations to a size; `None` where it sees them as they are."""
    if not trained.scaling:
        return None
    scaling = InputScaling(len(trained.scaling["square"]))
    scaling.load_state_dict(trained.scaling)
    return scaling.float().eval()


def hidden_weights(policy: Weights) -> list[Tensor]:
    """Weights of the layers of stacked policies, `(policies, in, out)` each."""
    return [value for name, value in policy.items() if name.endswith(".weight")]


def sizes(trained: Trained) -> tuple[int, int]:
    """Length of what policy and models observe, a window where frames are stacked, and of actions.

    Args:
        trained: Settings and weights of a run.
    """
    policy = make_policy(trained)
    input_dim = policy.network.layers[0].weight.shape[1]
    return input_dim - int(trained.config.agent.is_conditioned), policy.action_dim


def task_spaces(
    trained: Trained, policy: GaussianPolicy, action_bounds: ActionBounds | None = None
) -> TaskSpaces:
    """Spaces of the task of a run, with its bounds of actions as they were written, or given.

    Raises:
        ValueError: If the bounds are missing, or given twice, or are none.
    """
    if trained.spaces is not None:
        if action_bounds is not None:
            raise ValueError(
                f"`action_bounds` must be left out for a run that has a {SPACES}, got "
                f"{action_bounds}."
            )
        return trained.spaces
    if action_bounds is None:
        raise ValueError(
            f"`action_bounds` must be given for a run without a {SPACES}, such as (-1, 1) for the "
            f"tasks of this package, got None for {trained.folder}; load and export of Python "
            "take them, and a run that is continued writes the file."
        )
    low, high = _bounds(action_bounds, policy.action_dim)
    frames = trained.config.environment.frame_stack
    window = sizes(trained)[0]
    observation_dim = (window - (frames - 1) * policy.action_dim) // frames
    return TaskSpaces(observation_dim, tuple(low.tolist()), tuple(high.tolist()), "float32")


def _bounds(action_bounds: ActionBounds, action_dim: int) -> NDArray[np.float64]:
    """The least and the largest action, `(2, action_dim)`.

    Raises:
        ValueError: If they are none.
    """
    try:
        low, high = (np.asarray(bound, dtype=np.float64) for bound in action_bounds)
        bounds = np.stack([np.broadcast_to(bound, action_dim) for bound in (low, high)])
        if not (np.isfinite(bounds).all() and (bounds[0] < bounds[1]).all()):
            raise ValueError
    except (OverflowError, TypeError, ValueError):
        raise ValueError(
            "`action_bounds` must be low and high, finite numbers, one each or "
            f"{action_dim}, got {action_bounds!r}."
        ) from None
    return bounds


def as_batch(name: str, vector: NDArray[Real], dim: int) -> NDArray[Real]:
    """Vectors as a batch of them.

    Raises:
        ValueError: If they have another length, or an entry that is NaN or infinite.
    """
    if vector.ndim not in (1, 2) or vector.shape[-1] != dim:
        raise ValueError(
            f"`{name}` must have shape ({dim},) or (batch, {dim}), got {vector.shape}."
        )
    if not np.isfinite(vector).all():
        raise ValueError(f"`{name}` must be finite, got {vector.tolist()}.")
    return np.atleast_2d(vector)


def _as_state(state: Any, *shapes: tuple[int, ...]) -> list[NDArray[np.float32]]:
    """A state in single precision: finite windows and actions of such shapes, or it is refused."""
    is_sequence = isinstance(state, Sequence)
    got: Any = [np.shape(array) for array in state] if is_sequence else repr(state)
    if got != [*shapes]:
        raise ValueError(
            "`state` must be what the call before returned for as many observations, arrays of "
            f"shapes {shapes[0]} and {shapes[1]}, got {got}."
        )
    arrays = [as_float32("state", array) for array in state]
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError(f"`state` must be finite, got {state}.")
    return arrays


def _flags(name: str, value: Numbers | None, batch: int) -> NDArray[np.bool_]:
    """Flags of a batch, all False without any.

    Raises:
        TypeError: If they are no numbers.
        ValueError: If there are not one or as many as the batch is long, or they are no flags.
    """
    flags = as_float32(name, False if value is None else value)
    if flags.shape not in ((), (batch,)) or not np.isin(flags, (0, 1)).all():
        raise ValueError(f"`{name}` must be False or True, or {batch} of them, got {value!r}.")
    return np.broadcast_to(flags.astype(bool), batch)


def _hunger(hunger: Numbers, batch: int) -> NDArray[np.float32]:
    values = as_float32("hunger", hunger)
    if values.shape not in ((), (batch,)) or not ((values >= 0) & (values <= 1)).all():
        raise ValueError(
            f"`hunger` must be one number in [0, 1], or {batch} of them, got {values}."
        )
    return values
