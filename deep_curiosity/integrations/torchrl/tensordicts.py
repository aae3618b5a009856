"""Between tensordicts and bonuses: keys, flat batches, and fresh actions of a policy."""

from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import Any

import torch
from jaxtyping import Bool, Float
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.integrations.torchrl.action_box import ActionBox, Key
from deep_curiosity.nn.networks import evaluating
from deep_curiosity.replay import real_rows
from deep_curiosity.transitions import Transition, check_single_steps


@dataclass
class TransitionKeys:
    """Where a tensordict holds a transition; what belongs to the outcome is under `"next"`."""

    observation: Key = "observation"
    action: Key = "action"
    reward: Key = "reward"
    terminated: Key = "terminated"
    truncated: Key = "truncated"

    @property
    def reward_holds_bonus(self) -> Key:
        """Where, beside the reward, is written that a bonus has been added to it."""
        return _beside(self.reward, "holds_bonus")

    @property
    def observation_for_bonus(self) -> Key:
        """Where, beside it, an observation is set aside that others are about to rewrite."""
        return _beside(self.observation, "for_bonus")


class TransitionReader:
    """Reads transitions for a bonus, whatever the batch shape, dtype and device of the data.

    Observations that were set aside are read in place of those rewritten since.

    Args:
        bonus: Whose dtype and device are taken.
        keys: Where the parts of a transition are.
        box: Range of the actions.

    Raises:
        TypeError: If the bonus is none.
    """

    def __init__(self, bonus: Bonus, keys: TransitionKeys, box: ActionBox) -> None:
        if not isinstance(bonus, Bonus):
            raise TypeError(f"`bonus` must be a Bonus, got {bonus!r}.")
        self.bonus = bonus
        self.keys = keys
        self.box = box

    def read(
        self, tensordict: TensorDictBase, next_tensordict: TensorDictBase | None = None
    ) -> Transition:
        """All leading dimensions as one batch, from which padding is left out.

        Args:
            tensordict: Holds observation and action, and says which of its steps are padding.
            next_tensordict: Holds its outcome; the entry `"next"` when `None`.

        Raises:
            KeyError: If an entry is missing; `truncated` alone may be.
            ValueError: If an entry has not one number for each observation, or outcomes are those
                of several steps.
        """
        if next_tensordict is None:
            next_tensordict = _entry(tensordict, "next")
        check_single_steps(tensordict.get("steps_to_next_obs", None))
        observation, action = self.read_pair(tensordict)
        like, batch = observation, observation.shape[0]
        transition = Transition(
            observation=observation,
            action=action,
            reward=self._scalars(next_tensordict, self.keys.reward, batch).to(like),
            next_observation=_vectors(self._observation(next_tensordict)).to(like),
            terminated=self._flags(next_tensordict, self.keys.terminated, batch).to(like.device),
            truncated=self._flags_or_none(next_tensordict, batch).to(like.device),
        )
        rows = self.real_rows(tensordict)
        if rows is None:
            return transition
        return Transition(*(field[rows.to(field.device)] for field in transition))

    def real_rows(self, tensordict: TensorDictBase) -> Bool[Tensor, " rows"] | None:
        """Which rows are no padding; `None` where none is."""
        return real_rows(tensordict, _entry(tensordict, self.keys.observation).shape[:-1])

    def read_pair(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Observation and action alone, differentiable."""
        like = reference_tensor(self.bonus)
        observation = _vectors(self._observation(tensordict)).to(like)
        action = _vectors(_entry(tensordict, self.keys.action)).to(like)
        return observation, self.box.to_unit(action)

    def set_observations_aside(self, tensordict: TensorDictBase) -> None:
        """Keep a copy of both observations, to be read when others have been written there."""
        for part in (tensordict, _entry(tensordict, "next")):
            part.set(self.keys.observation_for_bonus, self._observation(part).clone())

    def check_unpaid(self, tensordict: TensorDictBase) -> None:
        """Reject a batch whose reward holds a bonus, beside which another would count twice.

        Raises:
            ValueError: If a `CuriosityTransform` has added one.
        """
        if _entry(tensordict, "next").get(self.keys.reward_holds_bonus, None) is not None:
            raise ValueError(
                f"`{self.keys.reward}` must be that of the environment, got one to which a "
                "CuriosityTransform has added a bonus: leave `add_to_reward` False in all but the "
                "last of them, and wherever CuriousActorCriticLoss is given a bonus."
            )

    @torch.no_grad()
    def compute(
        self,
        transition: Transition,
        like: Tensor,
        rows: Bool[Tensor, " rows"] | None = None,
    ) -> Tensor:
        """Bonus of each transition, in shape, dtype and device like the reward.

        Where rewards are whole numbers it has a dtype of its own. Zero while it is not ready, and
        for padding.

        Args:
            transition: As `read` gives it.
            like: The reward, of padding too.
            rows: Which rows of the reward the transitions are; all of them when `None`.
        """
        dtype = self.dtype_of_bonus(like.dtype)
        if not self.bonus.ready or not len(transition.reward):
            return torch.zeros_like(like, dtype=dtype)
        observation, action, _, next_observation, *_ = transition
        bonus: Tensor = self.bonus(observation, action, next_observation)
        if rows is not None:
            rows = rows.to(bonus.device)
            bonus = bonus.new_zeros(len(rows)).masked_scatter(rows, bonus)
        return bonus.reshape(like.shape).to(like.device, dtype)

    def dtype_of_bonus(self, reward_dtype: torch.dtype) -> torch.dtype:
        """That of the rewards, where these are real numbers, and else that of the bonus."""
        is_real = reward_dtype.is_floating_point
        return reward_dtype if is_real else reference_tensor(self.bonus).dtype

    def _observation(self, tensordict: TensorDictBase) -> Tensor:
        aside: Tensor | None = tensordict.get(self.keys.observation_for_bonus, None)
        return _entry(tensordict, self.keys.observation) if aside is None else aside

    def _flags(self, next_tensordict: TensorDictBase, key: Key, batch: int) -> Tensor:
        return self._scalars(next_tensordict, key, batch).bool()

    def _flags_or_none(self, next_tensordict: TensorDictBase, batch: int) -> Tensor:
        if next_tensordict.get(self.keys.truncated, None) is None:
            return torch.zeros(batch, dtype=torch.bool)
        return self._flags(next_tensordict, self.keys.truncated, batch)

    def _scalars(self, next_tensordict: TensorDictBase, key: Key, batch: int) -> Tensor:
        value = _entry(next_tensordict, key)
        if value.numel() != batch:
            raise ValueError(
                f"`{key}` must hold one number for each of {batch} observations, "
                f"got shape {tuple(value.shape)}."
            )
        return value.reshape(-1)


class FreshActions:
    """A torchrl policy as a bonus calls it: observations in, random actions in [-1, 1] out.

    The layers of the policy are left as they are: batch normalisation learns nothing here.

    Args:
        policy: Reads the observation, and what else a sampled batch has, and writes the action.
        reader: Knows the keys and the range of the actions.

    Raises:
        TypeError: If the policy is no module that names the entries it reads.
    """

    def __init__(self, policy: TensorDictModuleBase, reader: TransitionReader) -> None:
        if not (isinstance(policy, nn.Module) and hasattr(policy, "in_keys")):
            raise TypeError(
                "`policy` must be a TensorDictModule, which names the entries that it reads, "
                f"got {policy!r}."
            )
        self.policy: TensorDictModuleBase = policy
        self.reader = reader

    def at(
        self, sampled: TensorDictBase, observation: Float[Tensor, "batch observation_dim"]
    ) -> Policy:
        """The policy at the observations of a batch, of which it may read other entries too.

        Args:
            sampled: The batch, as the policy reads it.
            observation: What the bonus is given of it: the same steps, in another form.
        """
        return partial(self, sampled=sampled, given=observation)

    @torch.no_grad()
    def __call__(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        *,
        sampled: TensorDictBase,
        given: Float[Tensor, "batch observation_dim"],
    ) -> Float[Tensor, "batch action_dim"]:
        """Sample an action at each observation.

        Args:
            observation: Where.
            sampled: Holds what the policy reads, for each observation.
            given: The observations of this batch, in whose place the policy reads its own.
        """
        keys, like = self.reader.keys, reference_tensor(self.policy, self.reader.bonus)
        tensordict = self._entries(sampled).to(like.device)
        own = tensordict.get(keys.observation, None) if observation is given else None
        own = observation if own is None else own
        dtype = like.dtype if own.is_floating_point() else own.dtype
        tensordict.set(keys.observation, own.to(like.device, dtype))
        with set_exploration_type(ExplorationType.RANDOM), evaluating(self.policy):
            action = _entry(self.policy(tensordict), keys.action)
        return self.reader.box.to_unit(action.to(observation))

    def _entries(self, sampled: TensorDictBase) -> TensorDictBase:
        """A copy of what the policy reads, all leading dimensions in one, without padding."""
        entries = sampled.select(*self.policy.in_keys, strict=False).to_tensordict()
        entries.batch_size = _entry(sampled, self.reader.keys.observation).shape[:-1]
        rows = self.reader.real_rows(sampled)
        return entries.reshape(-1) if rows is None else entries.reshape(-1)[rows]


def reference_tensor(*modules: nn.Module) -> Tensor:
    """A tensor of the dtype and on the device in which the first that has any computes."""
    tensors = chain.from_iterable(chain(each.parameters(), each.buffers()) for each in modules)
    return next((value for value in tensors if value.is_floating_point()), torch.zeros(()))


def _beside(key: Key, name: str) -> Key:
    """A key that tells something of another, in the same place."""
    *path, last = [key] if isinstance(key, str) else key
    return (*path, f"{last}_{name}")


def _entry(tensordict: TensorDictBase, key: Key) -> Any:
    value = tensordict.get(key, None)
    if value is None:
        raise KeyError(
            f"`{key}` must be among the entries, got {sorted(map(str, tensordict.keys()))}."
        )
    return value


def _vectors(value: Tensor) -> Tensor:
    """All leading dimensions in one."""
    return value.reshape(-1, value.shape[-1])
