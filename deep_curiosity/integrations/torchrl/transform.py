"""The bonus as a torchrl transform: fresh at every sample, whatever the storage holds."""

from collections.abc import Iterable, Iterator
from threading import RLock

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import unravel_key
from torch import Tensor
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import Transform
from torchrl.envs.transforms import (
    CatFrames,
    Compose,
    DeviceCastTransform,
    DTypeCastTransform,
)

from deep_curiosity.bonuses.base import Bonus, Policy
from deep_curiosity.bonuses.learner import BonusLearner
from deep_curiosity.integrations.torchrl.action_box import ActionBox, Key
from deep_curiosity.integrations.torchrl.tensordicts import (
    FreshActions,
    TransitionKeys,
    TransitionReader,
)
from deep_curiosity.transitions import Transition, check_flags

ONE_AT_A_TIME = RLock()
"""Held while a bonus learns and is computed: a buffer that prefetches samples in threads."""
KEEPS_NUMBERS = (DTypeCastTransform, DeviceCastTransform)
"""Transforms that write an entry in its own place and leave it as it is, but for its form."""
KEEPS_UNITS = (CatFrames, *KEEPS_NUMBERS)
"""Those that may say the same more than once."""


class CuriosityTransform(Transform):
    """Writes the bonus of every transition under `("next", "curiosity")`.

    In a replay buffer it is computed afresh for each sampled batch, after a `BonusLearner` has
    learned from that batch. The storage keeps the rewards of the environment. Reading the
    buffer by index passes through its transforms as well; `buffer.storage[...]` does not. Padding,
    as torchrl marks it under `"mask"` or `("collector", "mask")`, is not learned and has no bonus.

    Where a transform behind it rewrites observations in place, it sets them aside under
    `"observation_for_bonus"`, here and under `"next"`. The losses give these to their bonus.

    In an environment the bonus of each step is written as one more reward and nothing is learned
    or added. Until the bonus has observed a batch, it counts as zero. There, what changes
    observations must come before it; in a buffer, after it.

    Args:
        bonus: A `BonusLearner`, which learns at each sample at its own pace, or a `Bonus`, which
            is only computed.
        add_to_reward: Also add the bonus to the reward of each sampled batch. That this was done
            is written beside it, as `reward_holds_bonus`, so that none is added again.
        policy: Samples fresh actions for `Bonus.observe`; `None` takes the sampled ones. It reads
            the batch as it stands here, so nothing behind may rewrite what it reads.
        action_spec: Range of the actions, as `env.action_spec`; `low` and `high` when `None`.
        low: Lowest action. The bonus is given actions brought to [-1, 1].
        high: Highest action.
        observation_key: Of a vector, here and under `"next"`; all keys may be nested.
        action_key: Of the action.
        reward_key: Of the reward, under `"next"`, as are the flags.
        terminated_key: Of the flag that the episode has terminated.
        truncated_key: Of the flag that a clock has ended the episode; may be missing in the data.
        out_key: Where the bonus is written.

    Raises:
        TypeError: If `bonus` is neither a `Bonus` nor a `BonusLearner`, or `policy` no module that
            names what it reads.
        ValueError: If the actions have no finite range.
    """

    def __init__(
        self,
        bonus: Bonus | BonusLearner,
        *,
        add_to_reward: bool = False,
        policy: TensorDictModuleBase | None = None,
        action_spec: TensorSpec | None = None,
        low: float | Tensor = -1.0,
        high: float | Tensor = 1.0,
        observation_key: Key = "observation",
        action_key: Key = "action",
        reward_key: Key = "reward",
        terminated_key: Key = "terminated",
        truncated_key: Key = "truncated",
        out_key: Key = "curiosity",
    ) -> None:
        if not isinstance(bonus, Bonus | BonusLearner):
            raise TypeError(f"`bonus` must be a Bonus or a BonusLearner, got {bonus!r}.")
        check_flags(add_to_reward=add_to_reward)
        super().__init__(in_keys=[observation_key, action_key], out_keys=[out_key])
        self.source = bonus
        self.add_to_reward = add_to_reward
        keys = TransitionKeys(
            observation_key, action_key, reward_key, terminated_key, truncated_key
        )
        box = ActionBox.from_either(action_spec, low, high, action_key)
        self.reader = TransitionReader(self.bonus, keys, box)
        self.policy = None if policy is None else FreshActions(policy, self.reader)

    @property
    def bonus(self) -> Bonus:
        """The bonus in use."""
        return self.source.bonus if isinstance(self.source, BonusLearner) else self.source

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Learn from a sampled batch, if there is a learner, and return it with its bonus.

        What is given is left as it is: some storages hand out what they hold, and no copy.

        Raises:
            ValueError: If a transform before this one changes what it reads, one behind it what
                the policy reads, the reward holds a bonus already, or the outcomes are those of
                several steps.
        """
        self._check_order()
        self._check_policy()
        self.reader.check_unpaid(tensordict)
        transition, rows = self.reader.read(tensordict), self.reader.real_rows(tensordict)
        tensordict = tensordict.clone(False)
        next_tensordict = tensordict.get("next")
        reward = next_tensordict.get(self.reader.keys.reward)
        with ONE_AT_A_TIME:
            if isinstance(self.source, BonusLearner) and len(transition.reward):
                self.source.learn(transition, self._policy_at(tensordict, transition))
            bonus = self.reader.compute(transition, reward, rows)
        next_tensordict.set(self.out_keys[0], bonus)
        if self._may_be_rewritten():
            self.reader.set_observations_aside(tensordict)
        if self.add_to_reward:
            next_tensordict.set(self.reader.keys.reward, reward + bonus)
            paid = torch.ones_like(reward, dtype=torch.bool)
            next_tensordict.set(self.reader.keys.reward_holds_bonus, paid)
        return tensordict

    def _check_order(self) -> None:
        """Reject transforms of the buffer that rewrite an entry before the bonus is given it."""
        own = {unravel_key(key) for key in self._read_keys()}
        before, _ = self._neighbours()
        for transform in before:
            rewritten = {unravel_key(key) for key in transform.in_keys or []}
            rewritten &= {unravel_key(key) for key in transform.out_keys or []} & own
            if rewritten and not isinstance(transform, KEEPS_UNITS):
                raise ValueError(
                    "`transform` must come before all that change what it reads, got "
                    f"{type(transform).__name__} of {sorted(map(str, rewritten))} before it: "
                    "append the CuriosityTransform first."
                )

    def _check_policy(self) -> None:
        """Reject a policy that is asked here, and whose entries are rewritten only behind."""
        if self.policy is None or not isinstance(self.source, BonusLearner):
            return
        entries = [*self.policy.policy.in_keys, self.reader.keys.action]
        for transform, written in self._written_behind(entries):
            raise ValueError(
                "`policy` must read and write what stays as it is, got "
                f"{type(transform).__name__} of {written} behind the CuriosityTransform: let it "
                "write an entry of its own, by `out_keys`, for the policy to read, and append it "
                "first; or leave `policy` out."
            )

    def _policy_at(self, sampled: TensorDictBase, transition: Transition) -> Policy | None:
        return None if self.policy is None else self.policy.at(sampled, transition.observation)

    def _may_be_rewritten(self) -> bool:
        """Whether a transform behind writes an observation, or does not say what it writes."""
        key = self.reader.keys.observation
        if any(self._written_behind([key, unravel_key(("next", key))])):
            return True
        _, after = self._neighbours()
        return any(not isinstance(each, KEEPS_NUMBERS) and not each.out_keys for each in after)

    def _written_behind(self, entries: Iterable[Key]) -> Iterator[tuple[Transform, list[str]]]:
        """Transforms behind this one that write some of the entries, and which, to be named."""
        own = {unravel_key(key) for key in entries}
        _, after = self._neighbours()
        for transform in after:
            if not isinstance(transform, KEEPS_NUMBERS):
                written = own & {unravel_key(key) for key in transform.out_keys or []}
                if written:
                    yield transform, sorted(map(str, written))

    def _read_keys(self) -> list[Key]:
        keys = vars(self.reader.keys)
        outcome = [unravel_key(("next", key)) for name, key in keys.items() if name != "action"]
        return [keys["observation"], keys["action"], *outcome]

    def _check_order_of_environment(self) -> None:
        """Reject transforms of the environment that rewrite an observation after this one.

        A step begins at what they wrote, and its outcome comes to the bonus without them.
        """
        key = unravel_key(self.reader.keys.observation)
        for transform, _ in self._written_behind([key]):
            raise ValueError(
                "`transform` must come after all that change what it reads, got "
                f"{type(transform).__name__} of {key!r} behind it: in an environment append "
                "the CuriosityTransform last."
            )

    def _neighbours(self) -> tuple[list[Transform], list[Transform]]:
        """Transforms that data pass before this one and after it, whatever they are within."""
        before: list[Transform] = []
        after: list[Transform] = []
        part: Transform = self
        for pipeline in _pipelines_around(self):
            parts = list(pipeline.transforms)
            index = next((i for i, each in enumerate(parts) if each is part), len(parts))
            before = [*_leaves(parts[:index]), *before]
            after = [*after, *_leaves(parts[index + 1 :])]
            part = pipeline
        return before, after

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        """Write the bonus of a step of the environment.

        Raises:
            ValueError: If a transform after this one changes what it reads.
        """
        self._check_order_of_environment()
        transition = self.reader.read(tensordict, next_tensordict)
        reward = next_tensordict.get(self.reader.keys.reward)
        rows = self.reader.real_rows(tensordict)
        next_tensordict.set(self.out_keys[0], self.reader.compute(transition, reward, rows))
        return next_tensordict

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        """Announce the bonus beside the reward, in its shape."""
        like = reward_spec[self.reader.keys.reward]
        reward_spec[self.out_keys[0]] = Unbounded(
            shape=like.shape,
            dtype=self.reader.dtype_of_bonus(like.dtype),
            device=like.device,
        )
        return reward_spec


def _pipelines_around(transform: Transform) -> Iterator[Compose]:
    """What a transform is within, from the inside out."""
    while True:
        container = transform.__dict__["_container"]  # weakly; the property is for environments
        pipeline = None if container is None else container()
        if not isinstance(pipeline, Compose):
            return
        yield pipeline
        transform = pipeline


def _leaves(transforms: Iterable[Transform]) -> Iterator[Transform]:
    """Transforms in their order, those within others as well."""
    for transform in transforms:
        if isinstance(transform, Compose):
            yield from _leaves(transform.transforms)
        else:
            yield transform
