"""The batch that every part speaks: raw transitions, nothing derived."""

import math
import numbers
from operator import itemgetter
from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

MOST = 2**40  # of whatever is counted: more has no place in any memory
LARGEST = 1e14  # of what is learned from; beyond it, squares of whitened values leave float32
LARGEST_ACTION = 1e3  # of what is not whitened: a gradient grows with its cube, Adam squares that
LIMITS = dict.fromkeys(("action", "visited.action", "policy(observation)"), LARGEST_ACTION)


class Transition(NamedTuple):
    """A batch of environment steps, as the environment gave them.

    The reward holds no bonus, `next_observation` is the true one also where an episode was cut
    off, and `terminated` (the episode ended for good: nothing to bootstrap) is kept apart from
    `truncated` (a clock ended the episode: the value goes on).
    """

    observation: Float[Tensor, "batch observation_dim"]
    action: Float[Tensor, "batch action_dim"]
    reward: Float[Tensor, " batch"]
    next_observation: Float[Tensor, "batch observation_dim"]
    terminated: Bool[Tensor, " batch"]
    truncated: Bool[Tensor, " batch"]


class Sequences(NamedTuple):
    """Transitions that follow one another, as many in each of several sequences.

    A sequence lives on until its episode ends or nothing is known of what follows; what stands
    behind its end is of no meaning.
    """

    steps: Transition
    """The first of every sequence, then the second of every sequence, and so on."""
    alive: Bool[Tensor, "num_steps batch"]
    """Which steps belong to their sequence; the first always does."""

    @property
    def first(self) -> Transition:
        """The first transition of every sequence."""
        return self.head(1)

    def head(self, num_steps: int) -> Transition:
        """The first steps of every sequence, so many or as many as there are."""
        if num_steps >= len(self.alive):
            return self.steps
        rows = slice(num_steps * self.alive.shape[1])
        return Transition(*map(itemgetter(rows), self.steps))

    def known(self, bonus: Float[Tensor, " steps"]) -> "Sequences":
        """The same sequences as far as their bonus is known, which is not NaN."""
        alive = self.alive.clone(memory_format=torch.contiguous_format)  # written to as one row
        alive.view(-1)[: len(bonus)] &= ~bonus.isnan()
        return Sequences(self.steps, alive.cumprod(0).bool())

    def last(self, num_steps: int) -> Transition:
        """The last transition of every sequence within so many steps."""
        if num_steps == 1:
            return self.head(1)
        rows = self._rows(self.alive[:num_steps].sum(0) - 1)
        return Transition(*map(itemgetter(rows), self.steps))

    def continuation(self, num_steps: int) -> Float[Tensor, "batch observation_dim"]:
        """Where one is after the last transition within so many steps, in another episode or not.

        It is the observation of the step behind it, where the sequences hold that; else the last
        transition's own next observation.
        """
        if len(self.alive) <= num_steps:
            return self.last(num_steps).next_observation
        return self.steps.observation[self._rows(self.alive[:num_steps].sum(0))]

    def _rows(self, number: Int[Tensor, " batch"]) -> Int[Tensor, " batch"]:
        """Where the step of a number, from 0, of every sequence lies."""
        batch = self.alive.shape[1]
        return number * batch + torch.arange(batch, device=number.device)

    def check(self, observation_dim: int, action_dim: int, dtype: torch.dtype) -> None:
        """Reject sequences whose steps are no transitions, or do not fit `alive`.

        Raises:
            TypeError: If a field has the wrong kind.
            ValueError: If a field has the wrong shape or holds NaN or infinity, or a sequence has
                no first step or lives again. Values are not looked at inside a compiled graph.
        """
        check_transition(self.steps, observation_dim, action_dim, dtype)
        if not isinstance(self.alive, Tensor) or self.alive.dtype != torch.bool:
            raise TypeError(f"`alive` must be a tensor of torch.bool, got {_kind(self.alive)}.")
        if self.alive.ndim != 2 or self.alive.numel() != len(self.steps.reward):
            raise ValueError(
                f"`alive` must have shape (num_steps, batch) of {len(self.steps.reward)} steps, "
                f"got {tuple(self.alive.shape)}."
            )
        if torch.compiler.is_compiling():
            return
        falls = self.alive[1:] <= self.alive[:-1]
        if not self.alive[0].all() & falls.all():  # one wait for a device
            wrong = torch.cat([~self.alive[:1], ~falls]).any(0).nonzero()[0, 0]
            raise ValueError(
                "`alive` must be True at the first step of every sequence and never again once it "
                f"is False, got {self.alive[:, wrong].tolist()} in sequence {int(wrong)}."
            )


def as_sequences(batch: Transition | Sequences) -> Sequences:
    """Sequences as they are, transitions as sequences of one step."""
    if isinstance(batch, Sequences):
        return batch
    if not isinstance(batch, Transition):
        raise TypeError(f"`batch` must be a Transition or Sequences, got {type(batch).__name__}.")
    check_scalars("terminated", batch.terminated, torch.bool)
    return Sequences(batch, torch.ones_like(batch.terminated).unsqueeze(0))


def every_second(transition: Transition, first: int) -> Transition:
    """Every second row, from row `first` on."""
    return Transition(*(field[first::2] for field in transition))


def check_batch(name: str, value: Tensor, dim: int, dtype: torch.dtype = torch.float32) -> None:
    """Reject what is not a batch of vectors of length `dim` in the precision of the networks.

    Raises:
        TypeError: If `value` is no tensor or has another dtype.
        ValueError: If the shape is not `(batch, dim)`.
    """
    if not isinstance(value, Tensor) or value.dtype != dtype:
        raise TypeError(f"`{name}` must be a tensor of {dtype}, got {_kind(value)}.")
    if value.ndim != 2 or value.shape[1] != dim:
        raise ValueError(f"`{name}` must have shape (batch, {dim}), got {tuple(value.shape)}.")


def check_inputs(dtype: torch.dtype, **inputs: tuple[Any, int]) -> None:
    """Reject what are not batches of vectors that belong together and can be computed with.

    Args:
        dtype: Of the networks.
        **inputs: What is given, and the length that its vectors must have, by name.

    Raises:
        TypeError: If one is no tensor or has another dtype.
        ValueError: If one has the wrong shape or another number of rows than the first, or holds
            NaN, infinity or numbers beyond 1e14, actions beyond 1e3. Values are not looked at
            inside a compiled graph or a transform of `torch.func`, where they may stand for many.
    """
    total: Any = None
    first: Any = None
    has_values = not (torch.compiler.is_compiling() or torch._C._are_functorch_transforms_active())
    for name, (value, dim) in inputs.items():
        fits = isinstance(value, Tensor) and value.dtype == dtype
        if not fits or value.ndim != 2 or value.shape[1] != dim:
            check_batch(name, value, dim, dtype)  # which says what is wrong
        first = value if first is None else first
        if len(value) != len(first):
            raise ValueError(
                f"`{name}` must have as many rows as `{next(iter(inputs))}`, {len(first)}, "
                f"got {len(value)}."
            )
        if has_values:
            norm = torch.linalg.vector_norm(value.detach())
            share = LARGEST / LIMITS.get(name, LARGEST)
            total = norm * share if total is None else torch.add(total, norm, alpha=share)
    if has_values and not total <= LARGEST:  # one wait for a device
        check_moderate(**{name: value for name, (value, _) in inputs.items()})


def check_scalars(name: str, value: Tensor, dtype: torch.dtype) -> None:
    """Reject what is not one number for each transition.

    Raises:
        TypeError: If `value` is no tensor or has another dtype.
        ValueError: If the shape is not `(batch,)`.
    """
    if not isinstance(value, Tensor) or value.dtype != dtype:
        raise TypeError(f"`{name}` must be a tensor of {dtype}, got {_kind(value)}.")
    if value.ndim != 1:
        raise ValueError(f"`{name}` must have shape (batch,), got {tuple(value.shape)}.")


def is_number(value: Any) -> bool:
    """Whether a value is a number of Python or NumPy, finite as a float.

    `True` and `False` are none, nor are fractions, which tensors do not take.
    """
    try:
        return _is_real(value) and math.isfinite(value)
    except OverflowError:  # a whole number beyond all floats
        return False


def check_flags(**flags: Any) -> None:
    """Reject what is no answer to yes or no.

    Raises:
        TypeError: Naming the first one that is neither True nor False.
    """
    for name, flag in flags.items():
        if not isinstance(flag, bool):
            raise TypeError(f"`{name}` must be True or False, got {flag!r}.")


def is_whole_number(value: Any) -> bool:
    """Whether a value is a whole number; `True` and `False` are none."""
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)


def check_kind(name: str, value: Any, kind: type) -> None:
    """Reject what is no object of a class.

    Raises:
        TypeError: Naming the argument, the class and what it is.
    """
    if not isinstance(value, kind):
        raise TypeError(f"`{name}` must be a {kind.__name__}, got {type(value).__name__}.")


def check_counts(**counts: Any) -> None:
    """Reject counts and sizes that are no whole numbers, or below 1.

    Raises:
        TypeError: Naming the first one that is no whole number.
        ValueError: Naming the first one that is below 1, and its value.
    """
    for name, count in counts.items():
        # as in `is_whole_number`, which would be a call more at every update
        if isinstance(count, bool) or not isinstance(count, numbers.Integral):
            raise TypeError(f"`{name}` must be a whole number, got {count!r}.")
        if int(count) < 1:
            raise ValueError(f"`{name}` must be at least 1, got {count}.")
        if int(count) > MOST:
            raise ValueError(f"`{name}` must be at most {MOST}, got {count}.")


def check_number_kind(**values: Any) -> None:
    """Reject what is no number, finite or not, as tensors take them.

    Raises:
        TypeError: Naming the first one, and its value.
    """
    for name, value in values.items():
        if not _is_real(value):
            raise TypeError(f"`{name}` must be an int or a float, got {value!r}.")


def check_positive(**values: Any) -> None:
    """Reject what is not a positive, finite number.

    Raises:
        TypeError: Naming the first one that is no number.
        ValueError: Naming the first one that is not positive and finite, and its value.
    """
    for name, value in values.items():
        if not (is_number(value) and value > 0):
            check_number_kind(**{name: value})
            raise ValueError(f"`{name}` must be positive and finite, got {value}.")


def check_single_steps(num_steps: Tensor | None) -> None:
    """Reject outcomes of several steps, from which a model would learn them as one.

    Args:
        num_steps: From each observation to what is called its next; `None` where each is one.

    Raises:
        ValueError: If any is more than one.
    """
    if num_steps is not None and (num_steps > 1).any():
        raise ValueError(
            "`next_observation` must be that of one step later, got one of "
            f"{int(num_steps.max())} steps: leave MultiStepTransform, or MultiStep, to another "
            "buffer than the one that a bonus learns from."
        )


def check_finite(**values: Tensor) -> None:
    """Reject NaN and infinity, naming the first row that has one.

    Raises:
        ValueError: If any entry is NaN or infinite.
    """
    for name, value in values.items():
        finite = torch.isfinite(value)
        if not finite.all():
            row = int((~finite).nonzero()[0, 0])
            raise ValueError(f"`{name}` must be finite, got {value[row].tolist()} in row {row}.")


def check_moderate(**values: Tensor) -> None:
    """Reject NaN, infinity and numbers beyond 1e14, actions beyond 1e3, naming the first such row.

    Raises:
        ValueError: If any entry is none that can be learned from.
    """
    check_finite(**values)
    for name, value in values.items():
        limit = LIMITS.get(name, LARGEST)
        beyond = value.abs() > limit
        if beyond.any():
            row = int(beyond.nonzero()[0, 0])
            raise ValueError(
                f"`{name}` must lie within {limit:g} of zero, "
                f"got {value[row].tolist()} in row {row}."
            )


def check_transition_kind(transition: Any, name: str = "transition") -> None:
    """Reject what is no `Transition`.

    Raises:
        TypeError: If it is something else.
    """
    if not isinstance(transition, Transition):
        kind = type(transition).__name__
        raise TypeError(f"`{name}` must be a Transition, got {kind}.")


def check_transition(
    transition: Transition,
    observation_dim: int,
    action_dim: int,
    dtype: torch.dtype = torch.float32,
    name: str = "transition",
) -> None:
    """Reject a transition whose shapes, kinds or values would spoil statistics for good.

    Args:
        transition: What is given.
        observation_dim: Length that its observations must have.
        action_dim: Length that its actions must have.
        dtype: Of the networks.
        name: The argument that it was given by; `"visited"` names its fields so too.

    Raises:
        TypeError: If it is no `Transition`, or a field has the wrong kind.
        ValueError: If a field has the wrong shape or holds NaN or infinity, or the batch is empty.
            Not inside a compiled graph, which cannot look at values: check before.
    """
    if torch.compiler.is_compiling():
        return
    if not isinstance(transition, Transition):  # no call where it is one, as in every update
        check_transition_kind(transition, name)
    try:
        observation, action, reward, next_observation, terminated, truncated = transition
        batch = len(reward)
        fits = (
            observation.dtype == action.dtype == reward.dtype == next_observation.dtype == dtype
            and terminated.dtype == truncated.dtype == torch.bool
            and observation.shape == next_observation.shape == (batch, observation_dim)
            and action.shape == (batch, action_dim)
            and reward.shape == terminated.shape == truncated.shape == (batch,)
        )
        # one wait for a device; a norm that is too large only needs another look
        norm, share = torch.linalg.vector_norm, LARGEST / LARGEST_ACTION
        total = torch.add(norm(observation), norm(action), alpha=share)
        total = total + norm(next_observation) + norm(reward)
        if fits and batch and total <= LARGEST:
            return
    except (AttributeError, TypeError, ValueError, RuntimeError):
        pass  # what is wrong is said below
    _explain(transition, observation_dim, action_dim, dtype, name)


def _explain(
    transition: Transition, observation_dim: int, action_dim: int, dtype: torch.dtype, name: str
) -> None:
    """Say what is wrong with a transition, field by field; nothing where only a norm is large."""
    of = "" if name == "transition" else f"{name}."  # whose fields are arguments by themselves
    dims = {
        "observation": observation_dim,
        "action": action_dim,
        "next_observation": observation_dim,
    }
    for field, dim in dims.items():
        check_batch(of + field, getattr(transition, field), dim, dtype)
    check_scalars(f"{of}reward", transition.reward, dtype)
    check_scalars(f"{of}terminated", transition.terminated, torch.bool)
    check_scalars(f"{of}truncated", transition.truncated, torch.bool)
    num_rows = {field: getattr(transition, field).shape[0] for field in transition._fields}
    if len(set(num_rows.values())) != 1 or num_rows["observation"] == 0:
        raise ValueError(
            f"`{name}` must have fields of one batch size of at least 1, got {num_rows}."
        )
    check_moderate(**{of + field: getattr(transition, field) for field in (*dims, "reward")})


def _is_real(value: Any) -> bool:
    """Whether a value is a number of Python or NumPy, and neither a bool nor a fraction."""
    if isinstance(value, numbers.Rational):
        return is_whole_number(value)
    return isinstance(value, numbers.Real)


def _kind(value: Any) -> str:
    """What a value is, as an error names it."""
    return str(value.dtype) if isinstance(value, Tensor) else type(value).__name__
