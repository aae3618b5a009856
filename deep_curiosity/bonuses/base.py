"""The one extension point: what every bonus is to the agent, the trainer and the adapters."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.transitions import Transition, check_inputs

Policy = Callable[[Tensor], Tensor]
"""Samples fresh actions `(batch, action_dim)` for observations `(batch, observation_dim)`."""


class Bonus(nn.Module, ABC):
    """A reward that an agent gives itself. All state lives in parameters and buffers.

    In any loop, before the agent's own update::

        loss = bonus.loss(transition)                  # 1
        optimizer.zero_grad(), loss.backward()         # 2
        optimizer.step()                               # 3
        bonus.observe(transition, policy)              # 4
        reward = transition.reward + bonus(transition.observation, transition.action)  # 5

    A bonus that scores what has happened, and not what a model expects to happen, must be given
    `transition.next_observation` as well; any other leaves it aside.
    """

    scores_outcomes: ClassVar[bool] = False
    """Whether `next_observation` must be given, as an action that was not taken has no score."""

    @property
    def ready(self) -> bool:
        """Whether the bonus can be computed yet; some must observe a batch first."""
        return True

    @property
    def should_skip(self) -> bool:
        """Whether the next batch would leave no trace in `observe`: a query that changes nothing.

        A loop that has work to make a batch ready may spare it::

            if bonus.should_skip:
                bonus.skip()
            else:
                bonus.observe(make_batch(), policy)
        """
        return False

    @abstractmethod
    def forward(
        self,
        observation: Float[Tensor, "batch observation_dim"],
        action: Float[Tensor, "batch action_dim"],
        next_observation: Float[Tensor, "batch observation_dim"] | None = None,
    ) -> Float[Tensor, " batch"]:
        """Bonus of each pair, differentiable in the action; changes no state."""

    @abstractmethod
    def loss(self, transition: Transition) -> Float[Tensor, ""]:
        """Loss of what the bonus learns; the caller owns the optimiser."""

    @abstractmethod
    def observe(
        self,
        transition: Transition,
        policy: Policy | None = None,
        visited: Transition | None = None,
    ) -> None:
        """Update statistics from a batch.

        Args:
            transition: A batch from replay, or the newest rollout.
            policy: Samples what the agent would do now.
            visited: Where the agent has been of late, if not at the batch; a bonus that
                does not depend on it leaves it aside.
        """

    def skip(self) -> None:
        """Count a batch that is not shown, because `should_skip` said so."""

    @abstractmethod
    def metrics(self) -> dict[str, Tensor]:
        """What to log: a flat dictionary of detached 0-d tensors."""


def ask_policy(
    policy: Policy, observation: Float[Tensor, "batch observation_dim"], action_dim: int
) -> Float[Tensor, "batch action_dim"]:
    """Fresh actions at some observations, checked as actions that are given are.

    Raises:
        TypeError: If the policy cannot be called, or returns no tensor of the observations' dtype.
        ValueError: If what it returns has the wrong shape, or holds NaN, infinity or numbers
            beyond 1e3.
    """
    check_policy(policy)
    action = policy(observation)
    check_inputs(
        observation.dtype,
        observation=(observation, observation.shape[1]),
        **{"policy(observation)": (action, action_dim)},
    )
    return action


def check_policy(policy: Any) -> None:
    """Reject what is no function.

    Raises:
        TypeError: If it cannot be called.
    """
    if not callable(policy):
        raise TypeError(f"`policy` must be callable, got {policy!r}.")
