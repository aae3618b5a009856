"""Replay: one preallocated tensor, its rows views of raw transitions."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from deep_curiosity.requirements import require
from deep_curiosity.transitions import (
    MOST,
    Sequences,
    Transition,
    check_counts,
    check_scalars,
    check_single_steps,
    is_whole_number,
)

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torchrl.data import ReplayBuffer as TorchRLReplayBuffer

Vector = np.ndarray | Sequence[float] | float
SEEDS = -(2**63), 2**64  # what torch's generators take, the last excluded
FLAGS = "terminated", "truncated"
SIZES = "observation_dim", "action_dim", "num_envs"
UNENDED = 2**62  # in the place of the number of a row by which an episode ends
REPEATED = 2.0  # in the place of 1 in the flags of a row that stands for a step that was none


class ReplayBuffer:
    """Ring of the newest transitions in one float32 tensor `(capacity, row)`.

    The memory is reserved at once and taken from the system only as rows are written. Sampling is
    one `index_select`; the fields of a batch are views of it.

    Args:
        capacity: Number of transitions kept.
        observation_dim: Length of an observation.
        action_dim: Length of an action.
        num_envs: Environments that are stored side by side, one row of each after the other.
        seed: Seed of the generator that samples batches.
        device: Where rows are kept and batches come out.

    Raises:
        TypeError: If a size or the seed is no whole number.
        ValueError: If a size is below 1, or the seed none that torch takes.
    """

    def __init__(
        self,
        capacity: int,
        observation_dim: int,
        action_dim: int,
        *,
        num_envs: int = 1,
        seed: int = 0,
        device: str | torch.device = "cpu",
    ) -> None:
        check_counts(
            capacity=capacity,
            observation_dim=observation_dim,
            action_dim=action_dim,
            num_envs=num_envs,
        )
        check_seed(seed)
        self.capacity = capacity
        self.num_envs = num_envs
        self.observation_dim = observation_dim
        self.action_dim = action_dim
        self._widths = [observation_dim, action_dim, 1, observation_dim, 1, 1]
        shape = capacity, sum(self._widths)
        self._rows = torch.empty(shape, dtype=torch.float32, device=device)
        self.bonus = torch.full((capacity,), math.nan, dtype=torch.float32, device=device)
        """Of the transition in each slot, as it last was; NaN until it is known."""
        self._num_added = 0
        self._num_taken = 0  # of those added, by `take_new`
        self._last: Tensor | None = None  # by slot, the number of the row that ends its episode
        self._num_searched = 0  # rows among which ends of episodes were looked for
        self._generator = torch.Generator(device).manual_seed(int(seed))

    def __len__(self) -> int:
        """Number of transitions held."""
        return min(self._num_added, self.capacity)

    def add(
        self,
        observation: Vector,
        action: Vector,
        reward: float,
        next_observation: Vector,
        terminated: bool,
        truncated: bool,
    ) -> None:
        """Append one transition, in place of the oldest when full.

        Raises:
            TypeError: If a value is no real number; nothing is then stored.
            ValueError: If a shape is wrong, a value is NaN or infinite, or a flag neither False
                nor True; nothing is then stored.
        """
        fields = observation, action, reward, next_observation, terminated, truncated
        try:
            with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused
                row = np.concatenate(fields, axis=None, dtype=np.float32, casting="same_kind")
            fits = type(row) is np.ndarray  # one with a masked field is none
            fits = fits and [*map(np.size, fields)] == self._widths
            fits = fits and bool(np.isfinite(row).all())
            fits = fits and terminated in (0, 1) and truncated in (0, 1)
        except (TypeError, ValueError, RuntimeError):
            fits = False
        if not fits:
            columns = zip(Transition._fields, fields, self._widths, strict=True)
            row = np.concatenate([_as_vector(*column) for column in columns])
        slot = self._num_added % self.capacity
        if self._rows.is_cpu:
            self._rows.numpy()[slot] = row  # half the price of going through torch
        else:
            self._rows[slot].copy_(torch.from_numpy(row), non_blocking=True)
        self.bonus[slot] = math.nan
        self._num_added += 1

    def extend(
        self,
        observation: np.ndarray,
        action: np.ndarray,
        reward: np.ndarray,
        next_observation: np.ndarray,
        terminated: np.ndarray,
        truncated: np.ndarray,
        sound: np.ndarray | None = None,
    ) -> None:
        """Append several transitions at once, their axis leading, as if they came one by one.

        Args:
            observation: `(num_rows, observation_dim)`.
            action: `(num_rows, action_dim)`.
            reward: `(num_rows,)`, as are the flags.
            next_observation: `(num_rows, observation_dim)`.
            terminated: Whether the task ended.
            truncated: Whether the episode was cut off.
            sound: False where there was no step to learn from: what that environment stored last
                stands there once more, in both places as the end of its episode. Where it has
                stored nothing yet, the steps of the others beside it are left out as well.

        Raises:
            TypeError: If a value is no real number; nothing is then stored.
            ValueError: If a shape is wrong or there is no row, a value is NaN or infinite, or a
                flag neither False nor True; nothing is then stored.
        """
        num_rows = _count_rows(observation)
        fields = observation, action, reward, next_observation, terminated, truncated
        vectors, actions = (num_rows, self.observation_dim), (num_rows, self.action_dim)
        shapes = [vectors, actions, (num_rows,), vectors, (num_rows,), (num_rows,)]
        try:
            with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused
                columns = [np.asanyarray(f).reshape(num_rows, -1) for f in fields]
                rows = np.concatenate(columns, axis=1, dtype=np.float32, casting="same_kind")
            fits = type(rows) is np.ndarray  # one with a masked field is none
            fits = fits and [*map(np.shape, fields)] == shapes
            fits = fits and bool(np.isfinite(rows).all())
            fits = fits and columns[-2].dtype == columns[-1].dtype == bool
        except (TypeError, ValueError, RuntimeError):
            fits = False
        if not fits:
            named = zip(Transition._fields, fields, shapes, strict=True)
            rows = np.concatenate([_as_rows(*column) for column in named], axis=1)
        if sound is not None:
            sound = _as_sound(sound, num_rows)
            rows = rows if sound.all() else self._end_before(rows, sound)
        newest = rows[-self.capacity :]
        self._num_added += len(rows)
        slot = np.arange(self._num_added - len(newest), self._num_added) % self.capacity
        if self._rows.is_cpu:
            self._rows.numpy()[slot] = newest  # half the price of going through torch
        else:
            self._rows[torch.from_numpy(slot)] = torch.from_numpy(newest).to(self._rows.device)
        self.bonus[torch.from_numpy(slot)] = math.nan

    def _end_before(self, rows: np.ndarray, sound: np.ndarray) -> np.ndarray:
        """Rows in which what is not sound is the row before once more, as an end.

        Every environment keeps its place in memory, by which a sequence finds its next step.
        """
        num_first, begin = max(0, self.num_envs - self._num_added), 0  # before which nothing came
        while not sound[begin : begin + num_first].all():  # begin with the next round
            begin += self.num_envs
        rows, sound = rows[begin:], sound[begin:]
        for index in np.flatnonzero(~sound).tolist():
            before = index - self.num_envs
            if before >= 0:
                last = rows[before]
            else:
                last = self._rows[(self._num_added + before) % self.capacity]
            if not last[-2:].any():
                last[-1] = 1.0
            rows[index] = last if before >= 0 else last.cpu().numpy()
            rows[index, -2:] = REPEATED * (rows[index, -2:] > 0)
        return rows

    def sample(self, batch_size: int) -> Transition:
        """Sample transitions uniformly, with replacement.

        Raises:
            ValueError: If the buffer is empty or `batch_size` is below 1.
        """
        return self.sample_sequences(batch_size).steps

    def sample_sequences(self, batch_size: int, num_steps: int = 1) -> Sequences:
        """Sample transitions uniformly, with replacement, each with those that followed it.

        Args:
            batch_size: Number of sequences.
            num_steps: Longest that a sequence may be.

        Raises:
            ValueError: If the buffer is empty or a count is below 1.
        """
        rows, alive, _ = self.sample_rows(batch_size, num_steps)
        return self.sequences(rows, alive)

    def sample_rows(
        self, batch_size: int, num_steps: int = 1
    ) -> tuple[Float[Tensor, "steps row"], Bool[Tensor, "num_steps batch"], Int[Tensor, " steps"]]:
        """Sequences as they lie in memory, for `sequences` to take apart: in a graph, for nothing.

        Returns:
            Rows, the first of every sequence, then the second of every sequence, and so on; which
            of them belong to their sequence; and the slot of each.

        Raises:
            ValueError: If the buffer is empty or a count is below 1.
        """
        self._check_sample(batch_size=batch_size, num_steps=num_steps)
        size = len(self)
        start = self._sample_below(size, batch_size)
        if num_steps == 1:
            alive = torch.ones(1, batch_size, dtype=torch.bool, device=start.device)
            return self._rows.index_select(0, start), alive, start
        step = torch.arange(num_steps, device=start.device).unsqueeze(-1)
        age = start + self.num_envs * step  # from the oldest
        known = age < size
        newest = start + (size - 1 - start) // self.num_envs * self.num_envs  # of its environment
        slot = self._num_added - size + torch.minimum(age, newest)
        slot = (slot % self.capacity).flatten()
        rows = self._rows.index_select(0, slot)
        # behind the newest of an environment is what it led to
        observation, _, _, next_observation, *_ = rows.split(self._widths, dim=-1)
        there = known[1:].flatten().unsqueeze(-1)
        behind = torch.where(there, observation[batch_size:], next_observation[:-batch_size])
        observation[batch_size:] = behind
        ended = (rows[:, -2:] > 0).any(-1).unflatten(0, (num_steps, batch_size))
        goes_on = ~ended[:-1] & known[1:]
        alive = torch.cat([torch.ones_like(ended[:1]), goes_on]).cumprod(0).bool()
        return rows, alive, slot

    def sequences(
        self, rows: Float[Tensor, "steps row"], alive: Bool[Tensor, "num_steps batch"]
    ) -> Sequences:
        """Sequences of rows that were sampled, their fields views of them."""
        observation, action, reward, next_observation, terminated, truncated = rows.split(
            self._widths, dim=-1
        )
        steps = Transition(
            observation=observation,
            action=action,
            reward=reward.squeeze(-1),
            next_observation=next_observation,
            terminated=terminated.squeeze(-1) > 0,
            truncated=truncated.squeeze(-1) > 0,
        )
        return Sequences(steps, alive)

    def sample_fading(self, batch_size: int, *, half_life: int) -> Transition:
        """Sample transitions whose weight halves with every `half_life` that came after them.

        Raises:
            ValueError: If the buffer is empty or a count is below 1.
        """
        self._check_sample(batch_size=batch_size, half_life=half_life)
        rate = math.log(2) / half_life
        held = -math.expm1(-rate * len(self))  # weight of what is held, as a share of all
        share = torch.rand(
            batch_size,
            generator=self._generator,
            dtype=torch.float64,
            device=self._rows.device,
        )
        age = (torch.log1p(-held * share) / -rate).long().clamp_(max=len(self) - 1)
        return self._at((self._num_added - 1 - age) % self.capacity)

    def sample_later(self, slot: Int[Tensor, " batch"]) -> Transition:
        """Sample for each slot a transition of the same episode: that one or one after it.

        All are equally likely, up to the end of the episode or, while it goes on, to its newest.

        Args:
            slot: Of transitions that are held, as `sample_rows` gives them.
        """
        oldest = self._num_added - len(self)
        number = oldest + (slot - oldest) % self.capacity  # of all rows that were ever added
        last = self._last_numbers()[slot]
        last = torch.where(number < self._num_searched, last, UNENDED)
        num_later = (last.clamp(max=self._num_added - 1) - number) // self.num_envs
        share = torch.rand(
            len(slot), generator=self._generator, dtype=torch.float64, device=slot.device
        )
        step = (share * (num_later + 1)).long()
        return self._at((number + self.num_envs * step) % self.capacity)

    def _last_numbers(self) -> Int[Tensor, " capacity"]:
        """By slot, the number of the row that ends its episode, for the rows that were searched.

        All are searched anew once another episode has ended.
        """
        oldest = self._num_added - len(self)
        new = self._arange(max(oldest, self._num_searched), self._num_added) % self.capacity
        if self._last is None or (self._rows[new, -2:] > 0).any():
            self._last = self._find_last_numbers()
            self._num_searched = self._num_added
        return self._last

    def _find_last_numbers(self) -> Int[Tensor, " capacity"]:
        """The same, of all rows that are held."""
        size = len(self)
        number = self._num_added - size + self._arange(size)
        slot = number % self.capacity
        ends = torch.where((self._rows[slot, -2:] > 0).any(-1), number, UNENDED)
        ends = torch.nn.functional.pad(ends, (0, -size % self.num_envs), value=UNENDED)
        ends = ends.unflatten(0, (-1, self.num_envs)).flip(0).cummin(0).values.flip(0)
        last = torch.full((self.capacity,), UNENDED, device=self._rows.device)
        last[slot] = ends.flatten()[:size]
        return last

    def newest(self, num_rows: int) -> Transition:
        """The newest transitions, oldest first: so many, or all while there are fewer.

        Raises:
            ValueError: If the buffer is empty or `num_rows` is below 1.
        """
        self._check_sample(num_rows=num_rows)
        return self._newest(num_rows)

    def take_new(self) -> Transition:
        """The transitions stored since the last call, oldest first: each is taken once."""
        number = self._num_added - self._num_taken
        self._num_taken = self._num_added
        return self._newest(number)

    def _newest(self, num_rows: int) -> Transition:
        age = self._arange(min(num_rows, len(self))).flip(0)
        return self._at((self._num_added - 1 - age) % self.capacity)

    def cut_off(self) -> None:
        """End the episodes in progress by the clock: nothing is known of what follows."""
        age = torch.arange(min(self.num_envs, len(self)), device=self._rows.device)
        slot = (self._num_added - 1 - age) % self.capacity
        goes_on = (self._rows[slot, -2:] == 0).all(-1)
        self._rows[slot[goes_on], -1] = 1.0
        self._last, self._num_searched = None, 0

    def mean_episode_length(self) -> float:
        """Transitions held for each episode that ended among them, or all while none did.

        Those that `extend` repeats, where there was no sound step, are held but end no episode.
        """
        ended = (self._rows[: len(self), -2:].amax(-1) == 1).sum()
        return len(self) / max(1, int(ended))

    def evenly_spaced(self, num_rows: int) -> Transition:
        """Transitions at equal distances over all that is held, the same at every call.

        Raises:
            ValueError: If the buffer is empty or `num_rows` is below 1.
        """
        self._check_sample(num_rows=num_rows)
        return self._at(self._arange(num_rows) * len(self) // num_rows)

    def all(self) -> Transition:
        """Every transition held, oldest first."""
        split = self._num_added % self.capacity if self._num_added > self.capacity else 0
        held = self._rows[: len(self)]
        return self._transition(torch.cat([held[split:], held[:split]]))

    def state_dict(self) -> dict[str, Any]:
        """Rows held, the sizes of the buffer and the state of the generator."""
        return {
            **{name: int(getattr(self, name)) for name in SIZES},
            "rows": self._rows[: len(self)].clone(),
            "bonus": self.bonus[: len(self)].clone(),
            "num_added": self._num_added,
            "num_taken": self._num_taken,
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore what `state_dict` gave, into a buffer of the same sizes and environments.

        Raises:
            TypeError: If an entry has the wrong kind; nothing is then restored.
            ValueError: If an entry is missing or does not fit the others, or this buffer; nothing
                is then restored.
        """
        _check_state(state, "rows", "bonus", "num_added", "generator")
        rows, bonus, num_added = state["rows"], state["bonus"], state["num_added"]
        # an older state does not say: what it held was taken then
        num_taken = state.get("num_taken", num_added)
        if rows.shape != (min(num_added, self.capacity), self._rows.shape[1]):
            raise ValueError(
                f"`rows` must fit a buffer of shape {tuple(self._rows.shape)} after "
                f"{num_added} additions, got {tuple(rows.shape)}."
            )
        self._check_sizes(state)
        check_scalars("bonus", bonus, torch.float32)
        if len(bonus) != len(rows):
            raise ValueError(
                f"`bonus` must have one number for each of {len(rows)} rows, got {len(bonus)}."
            )
        _check_number_of("num_taken", num_taken, num_added)
        try:
            self._generator.set_state(state["generator"])
        except (RuntimeError, TypeError):
            raise ValueError(
                f"`generator` must be the state of one on {self._generator.device}, "
                f"got {state['generator']!r}."
            ) from None
        self._rows[: len(rows)] = rows
        self.bonus[: len(rows)] = bonus
        self._num_added, self._num_taken = num_added, num_taken
        self._last = None
        self._num_searched = 0

    def take_over(self, state: dict[str, Any]) -> None:
        """Begin with the newest transitions of another buffer, as many as there is room for.

        What was an episode in progress there is cut off here: nothing is known of what followed.
        Nor is any bonus known of these transitions here.

        Args:
            state: Of a buffer with transitions of the same sizes, from as many environments.

        Raises:
            TypeError: If an entry has the wrong kind.
            ValueError: If an entry is missing, or the buffer has other sizes or environments;
                nothing is then taken over.
        """
        _check_state(state, "rows", "num_added")
        rows = state["rows"]
        if rows.shape[1:] != self._rows.shape[1:]:
            raise ValueError(
                f"`rows` must have {self._rows.shape[1]} entries, got {rows.shape[1:].numel()}."
            )
        self._check_sizes(state)
        split = state["num_added"] % max(1, len(rows))
        rows = torch.cat([rows[split:], rows[:split]])  # oldest first
        held = rows[-self.capacity :]
        self._rows[: len(held)] = held
        self.bonus.fill_(math.nan)  # which was of what stood there before
        self._num_added = len(held)
        self._num_taken = 0
        self.cut_off()

    def _check_sizes(self, state: Mapping[str, Any]) -> None:
        """Reject the state of a buffer of other sizes; one that is older does not say."""
        for name in SIZES:
            own = getattr(self, name)
            other = state.get(name, own)
            if other != own:
                raise ValueError(f"`{name}` must be {own}, that of this buffer, got {other!r}.")

    def to_torchrl(self) -> "TorchRLReplayBuffer":
        """Copy into a torchrl buffer under torchrl's usual keys.

        Of several environments its storage has two dimensions, time and environment, and each goes
        on in a place of its own. The oldest transitions are left out where not all environments
        have one. The copy of an empty buffer is empty.

        Raises:
            ImportError: If torchrl is missing.
        """
        require("torchrl", extra="torchrl")
        from tensordict import TensorDict
        from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

        held = self.all()
        storage = LazyTensorStorage(self.capacity, ndim=1 if self.num_envs == 1 else 2)
        buffer = TensorDictReplayBuffer(storage=storage, batch_size=256)
        next_step = {
            "observation": held.next_observation,
            "reward": held.reward.unsqueeze(-1),
            "terminated": held.terminated.unsqueeze(-1),
            "truncated": held.truncated.unsqueeze(-1),
            "done": (held.terminated | held.truncated).unsqueeze(-1),
        }
        steps = TensorDict(
            {"observation": held.observation, "action": held.action, "next": next_step},
            batch_size=len(self),
        )
        num_rounds, num_left_over = divmod(len(self), self.num_envs)
        if self.num_envs > 1:
            steps = steps[num_left_over:].unflatten(0, (num_rounds, self.num_envs))
        if num_rounds:
            buffer.writer.extend(steps)  # `buffer.extend` fails on a single round
        return buffer

    @classmethod
    def from_torchrl(
        cls, buffer: "TorchRLReplayBuffer", *, capacity: int | None = None, seed: int = 0
    ) -> "ReplayBuffer":
        """Copy the transitions of a torchrl buffer that uses torchrl's usual keys.

        Args:
            buffer: A torchrl buffer of tensordicts. Where its storage has several dimensions, time
                comes first, and each place of the others is an environment.
            capacity: Of the new buffer; that of the old one's contents when `None`.
            seed: Seed of the generator that samples batches.

        Raises:
            TypeError: If it holds something else than tensordicts.
            ValueError: If it is empty, an entry has the wrong shape or holds NaN or infinity, or
                the next observations are those of several steps later, the rewards hold a bonus,
                or a storage of several dimensions holds padding, which is else left out.
        """
        held = _without_padding(oldest_first(buffer))
        next_step = held["next"]
        if next_step.get("reward_holds_bonus", None) is not None:
            raise ValueError(
                "`reward` must be that of the environment, got one to which a CuriosityTransform "
                "has added a bonus: store what was collected, not what was sampled."
            )
        vectors = held["observation"], held["action"], next_step["observation"]
        names = ("reward", "terminated", "truncated")
        scalars = (next_step[name].cpu().flatten().numpy() for name in names)
        observation, action, next_observation = (
            each.cpu().flatten(0, -2).numpy() for each in vectors
        )
        copy = cls(
            len(observation) if capacity is None else capacity,
            observation.shape[-1],
            action.shape[-1],
            num_envs=held.batch_size[1:].numel(),
            seed=seed,
        )
        reward, terminated, truncated = scalars
        copy.extend(observation, action, reward, next_observation, terminated, truncated)
        return copy

    def _check_sample(self, **counts: int) -> None:
        check_counts(**counts)
        if self._num_added == 0:
            raise ValueError("the replay must hold a transition before it is sampled, got 0.")

    def _arange(self, *bounds: int) -> Int[Tensor, " numbers"]:
        return torch.arange(*bounds, device=self._rows.device)

    def _sample_below(self, bound: int, batch_size: int) -> Int[Tensor, " batch"]:
        """Whole numbers below a bound, where the rows are: nothing waits for a device."""
        return torch.randint(
            bound, (batch_size,), generator=self._generator, device=self._rows.device
        )

    def _at(self, slot: Int[Tensor, " batch"]) -> Transition:
        """The transitions in some slots."""
        return self._transition(self._rows.index_select(0, slot))

    def _transition(self, rows: Float[Tensor, "batch row"]) -> Transition:
        alive = torch.ones(1, len(rows), dtype=torch.bool, device=rows.device)
        return self.sequences(rows, alive).steps


def _check_state(state: Any, *names: str) -> None:
    """Reject what is no state of a buffer, or one without the entries of some names."""
    if not isinstance(state, Mapping):
        kind = type(state).__name__
        raise TypeError(f"`state` must be a dictionary as `state_dict` gives it, got {kind}.")
    missing = [name for name in names if name not in state]
    if missing:
        raise ValueError(
            f"`state` must hold {', '.join(names)}, got one without {', '.join(missing)}."
        )
    rows = state["rows"]
    if not isinstance(rows, Tensor) or rows.dtype != torch.float32:
        dtype = getattr(rows, "dtype", type(rows).__name__)
        raise TypeError(f"`rows` must be a tensor of torch.float32, got {dtype}.")
    _check_number_of("num_added", state["num_added"], MOST)


def _check_number_of(name: str, number: Any, most: int) -> None:
    """Reject what is no whole number from 0 to the most."""
    if not is_whole_number(number) or not 0 <= number <= most:
        raise ValueError(f"`{name}` must be a whole number from 0 to {most}, got {number!r}.")


def _as_vector(name: str, value: Vector | bool, dim: int) -> np.ndarray:
    """A field of a transition as float32, `(dim,)`.

    Raises:
        TypeError: If it is not of real numbers.
        ValueError: If it has another length, NaN or infinity, or a flag is neither False nor True.
    """
    vector = as_float32(name, value).reshape(-1)
    if vector.shape != (dim,):
        raise ValueError(f"`{name}` must have {dim} entries, got {vector.shape[0]}.")
    if not np.isfinite(vector).all():
        raise ValueError(f"`{name}` must be finite, got {vector.tolist()}.")
    if name in FLAGS and vector[0] not in (0, 1):
        raise ValueError(f"`{name}` must be False or True, got {value!r}.")
    return vector


def _as_rows(name: str, value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The same of several transitions, `(num_rows, dim)`, from an array of a given shape."""
    array = as_float32(name, value)
    if array.shape != shape:
        raise ValueError(f"`{name}` must have shape {shape}, got {array.shape}.")
    rows = array.reshape(len(array), -1)
    finite = np.isfinite(rows).all(1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ValueError(f"`{name}` must be finite, got {rows[row].tolist()} in row {row}.")
    if name in FLAGS and not np.isin(array, (0, 1)).all():
        row = int(np.argmin(np.isin(array, (0, 1))))
        raise ValueError(f"`{name}` must be False or True, got {array[row]:g} in row {row}.")
    return rows


def as_float32(name: str, value: Any) -> np.ndarray:
    """Real numbers as float32; those in an array of objects as well.

    Raises:
        TypeError: If they are text, complex numbers, hidden by a mask, no numbers at all, or a
            tensor that NumPy cannot read.
        ValueError: If there is not the same number of them in every row, or one is too large.
    """
    if isinstance(value, Tensor) and (value.requires_grad or not value.is_cpu):
        raise TypeError(f"`{name}` must be detached and on the CPU, got {value!r}.")
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biufO" or np.ma.is_masked(value):
            raise TypeError
        with np.errstate(over="raise"):
            return array.astype(np.float32)
    except (TypeError, RuntimeError):
        raise TypeError(f"`{name}` must be of real numbers, got {value!r}.") from None
    except ArithmeticError:
        raise ValueError(f"`{name}` must be finite in float32, got {value!r}.") from None
    except ValueError:
        raise ValueError(f"`{name}` must be an array of real numbers, got {value!r}.") from None


def _count_rows(observation: Any) -> int:
    """Number of rows, at least 1."""
    try:
        shape = np.shape(observation)
    except (TypeError, ValueError, RuntimeError):
        shape = as_float32("observation", observation).shape  # which says what is wrong
    if len(shape) < 2 or not shape[0]:
        raise ValueError(
            "`observation` must have shape (num_rows, observation_dim) with at least 1 row, "
            f"got {shape}."
        )
    return shape[0]


def _as_sound(sound: Any, num_rows: int) -> np.ndarray:
    """Which rows are steps to learn from."""
    try:
        flags = np.asarray(sound)
    except ValueError:
        raise ValueError(f"`sound` must be an array of bool, got {sound!r}.") from None
    if flags.dtype != bool:
        raise TypeError(f"`sound` must be an array of bool, got {flags.dtype}.")
    if flags.shape != (num_rows,):
        raise ValueError(f"`sound` must have shape ({num_rows},), got {flags.shape}.")
    return flags


def check_seed(seed: Any) -> None:
    """Reject what is no seed of torch's generators.

    Raises:
        TypeError: If it is no whole number.
        ValueError: If it is none that torch takes.
    """
    if not is_whole_number(seed):
        raise TypeError(f"`seed` must be a whole number, got {seed!r}.")
    if not SEEDS[0] <= int(seed) < SEEDS[1]:
        raise ValueError(f"`seed` must lie in [-2**63, 2**64), got {seed}.")


def oldest_first(buffer: "TorchRLReplayBuffer") -> "TensorDictBase":
    """Contents of a torchrl buffer in the order of writing, also where it has gone round.

    Raises:
        TypeError: If it holds something else than tensordicts.
        ValueError: If it is empty, or holds outcomes of several steps, or rows that are no single
            transitions.
    """
    if len(buffer) == 0:
        raise ValueError("`buffer` must hold a transition, got an empty one.")
    held = _as_tensordict(buffer.storage[:])  # `buffer[:]` would pass through its transforms
    check_single_steps(held.get("steps_to_next_obs", None))
    if len(held) < buffer.storage.shape[0]:
        return held
    next_slot = buffer.writer._cursor % len(held)
    return torch.cat([held[next_slot:], held[:next_slot]])  # type: ignore[return-value]


def real_rows(tensordict: "TensorDictBase", leading: torch.Size) -> Bool[Tensor, " rows"] | None:
    """Which rows are steps, and not the padding that brings trajectories to one length.

    Args:
        tensordict: Says so under `"mask"` or `("collector", "mask")`, where torchrl writes it.
        leading: All dimensions of its observations but the last; these make the rows.

    Returns:
        A flag for each row, or `None` where there is no padding.
    """
    shape = tensordict.batch_size
    masks = [tensordict.get(key, None) for key in ("mask", ("collector", "mask"))]
    real = [
        mask.reshape(shape)
        for mask in masks
        if isinstance(mask, Tensor) and mask.dtype == torch.bool
        if mask.numel() == shape.numel()  # others are about something else, such as actions
    ]
    if not real or (both := real[0] & real[-1]).all():
        return None
    return both.reshape(*shape, *[1] * (len(leading) - len(shape))).expand(leading).flatten()


def _without_padding(held: "TensorDictBase") -> "TensorDictBase":
    """The steps among what a storage holds."""
    rows = real_rows(held, held.batch_size)
    if rows is None:
        return held
    if held.ndim > 1:
        raise ValueError(
            "`buffer` must hold no padding where its storage has several dimensions, "
            f"got {int((~rows).sum())} padding steps of {len(rows)}."
        )
    return held[rows]


def _as_tensordict(held: Any) -> "TensorDictBase":
    """What a storage holds as one tensordict, also where it keeps a list of rows."""
    from tensordict import TensorDictBase, lazy_stack

    rows = held if isinstance(held, list) else [held]
    for row in rows:
        if not isinstance(row, TensorDictBase):
            raise TypeError(f"`buffer` must hold tensordicts, got {type(row).__name__}.")
        if held is rows and row.batch_size:
            raise ValueError(
                "`buffer` must hold single transitions where its storage is a list, "
                f"got a row of shape {tuple(row.batch_size)}."
            )
    return lazy_stack(rows) if held is rows else held
