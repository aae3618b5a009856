"""Experiments that show whether a bonus works inside an agent."""

import math
import random
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deep_curiosity.integrations.base import Integration
from deep_curiosity.integrations.check.findings import Finding, Report
from deep_curiosity.transitions import Transition, check_counts

PATTERN_STRENGTH = 10.0  # of the bonus put in the place of the real one; rewards have size one
NUM_UPDATES = 20  # until the critic has moved the actor, which may be updated more seldom
CONSTANT_STD = 1e-6  # relative to the largest bonus: float32 resolves no less
REWARD_ERROR = 1e-5  # relative; rewards go through float32
OBSERVATION_ERROR = 1e-5


def check_integration(agent: Integration, *, num_steps: int = 400, seed: int = 0) -> Report:
    """Find out by experiment whether a bonus works inside an agent.

    The agent collects some steps and is saved. Copies of it then learn with the bonus replaced,
    in one by zero, in the other by a strong pattern: where the bonus reaches the critic, the two
    come to differ.

    Args:
        agent: With its bonus, best made for the check, which changes it: its environment is reset
            and acted in, what was collected stays in its replay and in all statistics of
            observations, and agent and bonus are one update older.
        num_steps: Environment steps to collect; enough for an episode to be cut off by its clock,
            and no more than replay has room for.
        seed: Of all random numbers. The global streams go on as if nothing had been drawn.

    Returns:
        The lines `finite`, `not constant`, `raw`, `ends`, `targets`, `fresh`, `actor` and `state`.

    Raises:
        TypeError: If the agent is no `Integration`, or the number of steps no whole number.
        ValueError: If there are no steps to collect, or more than replay has room for.
    """
    if not isinstance(agent, Integration):
        raise TypeError(
            "`agent` must be an Integration, such as StableBaselinesIntegration(model, make_env), "
            f"got {type(agent).__name__}."
        )
    check_counts(num_steps=num_steps)
    with _own_randomness(), TemporaryDirectory() as name, ExitStack() as stack:
        stack.callback(agent.release)
        folder = Path(name)
        given = agent.collect(num_steps, seed=seed)
        stored = agent.stored()
        _check_room(given, stored, num_steps)
        copies = _Copies(agent, _saved(agent, folder / "before"), num_steps, seed)
        others = [_check_rewards(copies), _check_ends(given, stored), *_check_acts(copies)]
        values = _check_values(agent, stored, seed)
        spoiled = Finding("state", None, "the agent has learned from no numbers", "see above")
        state = _check_state(agent, folder / "after", seed) if values[0].passed else spoiled
    return Report((*values, *others, state))


def _check_room(given: Transition, stored: Transition, num_steps: int) -> None:
    """Reject more steps than replay still holds."""
    room = num_steps * len(stored.reward) // len(given.reward)  # a step is one of each environment
    if room < num_steps:
        raise ValueError(
            f"`num_steps` must be at most {room}, all that the agent's replay has room for, "
            f"got {num_steps}."
        )


@contextmanager
def _own_randomness() -> Iterator[None]:
    """Seed at will: outside, all global streams of random numbers go on where they were."""
    plain, arrays = random.getstate(), np.random.get_state()  # noqa: NPY002  # agents draw there
    try:
        with torch.random.fork_rng(range(torch.cuda.device_count())):
            yield
    finally:
        random.setstate(plain)
        np.random.set_state(arrays)  # noqa: NPY002


@dataclass(frozen=True)
class _Copies:
    """Makes copies of a saved agent and trains them with another bonus."""

    agent: Integration
    folder: Path
    num_steps: int
    seed: int

    def run(
        self, bonus: Callable[..., Tensor], *, collecting: bool = True, updates: int = 1
    ) -> tuple[Integration, Transition | None]:
        """Let a copy learn, and collect before that, with its bonus replaced.

        Returns:
            The copy, and what its environment gave.
        """
        copy = self.agent.load(self.folder)
        copy.bonus.forward = bonus  # type: ignore[method-assign]
        given = copy.collect(self.num_steps, seed=self.seed) if collecting else None
        for update in range(updates):
            copy.learn(seed=self.seed + update)
        return copy, given

    def difference(self, part: Callable[[Integration], list[Tensor]], **options: Any) -> float:
        """Largest difference of two copies, one with no bonus and one with a strong pattern."""
        silent, marked = (self.run(bonus, **options)[0] for bonus in (_silence, _pattern))
        return _distance(part(silent), part(marked))


def _silence(observation: Tensor, *others: Tensor | None) -> Tensor:
    return observation.new_zeros(observation.shape[0])


def _pattern(observation: Tensor, action: Tensor, *others: Tensor | None) -> Tensor:
    """A strong bonus that differs between pairs, and never vanishes."""
    return PATTERN_STRENGTH * (2 + torch.sin(observation.sum(-1) + 3 * action.sum(-1)))


def _check_values(agent: Integration, stored: Transition, seed: int) -> list[Finding]:
    """Whether the bonus is finite and varies, after an update."""
    try:
        agent.learn(seed=seed)
        observation, action, _, next_observation, *_ = stored
        with torch.no_grad():
            bonus = agent.bonus(observation, action, next_observation)
        broken = int((~bonus.isfinite()).sum())
        std = bonus[bonus.isfinite()].std().item() if broken < len(bonus) - 1 else math.nan
        size = bonus[bonus.isfinite()].abs().max().item() if broken < len(bonus) else math.nan
    except Exception as error:  # whatever a foreign agent raises is a finding
        failed = f"{type(error).__name__}: {error}"
        return [Finding("finite", False, failed, "make one update run without an error")]
    constant = not std > CONSTANT_STD * max(size, 1e-30)
    return [
        Finding(
            "finite",
            broken == 0,
            f"{broken} of {len(bonus)} values are NaN or infinite",
            "look for NaN in observations, zero scales, or a bonus that has observed no batch yet",
        ),
        Finding(
            "not constant",
            None if broken else not constant,
            f"standard deviation {std:.3g} over what is stored",
            "show the bonus batches by `loss` and `observe`, and check the order of its arguments",
        ),
    ]


def _check_rewards(copies: _Copies) -> Finding:
    """Whether the bonus is counted at learning, and nowhere else."""
    marked, given = copies.run(_pattern)
    assert given is not None
    newest = marked.stored().reward[-len(given.reward) :]
    error = (newest - given.reward).abs().max().item()
    return Finding(
        "raw",
        error <= REWARD_ERROR * max(1.0, given.reward.abs().max().item()),
        f"stored rewards differ from the environment's by at most {error:.3g}",
        "store rewards as the environment gives them, and add the bonus to a copy when sampling",
    )


def _check_ends(given: Transition, stored: Transition) -> Finding:
    """Whether replay holds how episodes ended, and their last observation."""
    newest = Transition(*(field[-len(given.reward) :] for field in stored))
    flags = sum(
        int((getattr(newest, name) != getattr(given, name)).sum())
        for name in ("terminated", "truncated")
    )
    distance = (newest.next_observation - given.next_observation).abs()
    wrong = int((distance > OBSERVATION_ERROR).any(-1).sum())
    num_ends = int((given.terminated | given.truncated).sum())
    return Finding(
        "ends",
        None if num_ends == 0 else flags == 0 and wrong == 0,
        f"{num_ends} episodes ended; {flags} flags and {wrong} next observations differ",
        "keep `terminated` and `truncated` apart, and store the final observation of an episode, "
        "not the first one of the next",
    )


def _check_acts(copies: _Copies) -> list[Finding]:
    """Whether the bonus moves critic and actor; the rest is left out where it does not."""
    targets = _check_targets(copies)
    if targets.passed:
        return [targets, _check_fresh(copies), _check_actor(copies)]
    unanswered = ("the bonus does not reach the critic", "see above")
    return [targets, Finding("fresh", None, *unanswered), Finding("actor", None, *unanswered)]


def _check_targets(copies: _Copies) -> Finding:
    """Whether the bonus reaches the critic at all, wherever it may be added."""
    moved = copies.difference(lambda copy: copy.critic())
    return Finding(
        "targets",
        moved > 0,
        f"another bonus moves the critic by {moved:.3g} in an update",
        "the bonus is dropped: add it to the reward before the critic's targets, or before "
        "returns and advantages, are computed",
    )


def _check_fresh(copies: _Copies) -> Finding:
    """Whether what was collected under an older bonus is learned under the newest."""
    moved = copies.difference(lambda copy: copy.critic(), collecting=False)
    return Finding(
        "fresh",
        moved > 0,
        f"a bonus that changes after collection moves the critic by {moved:.3g}",
        "compute the bonus of each batch when it is learned from, not when it is collected",
    )


def _check_actor(copies: _Copies) -> Finding:
    """Whether, by the critic, the bonus reaches the actor."""
    moved = copies.difference(lambda copy: copy.actor(), updates=NUM_UPDATES)
    return Finding(
        "actor",
        moved > 0,
        f"another bonus moves the actor by {moved:.3g} in {NUM_UPDATES} updates",
        "let the actor maximise the critic that learns from the bonus",
    )


def _check_state(agent: Integration, folder: Path, seed: int) -> Finding:
    """Whether two copies of what was saved are the same agent, and learn the same."""
    saved = _saved(agent, folder)
    first, second = agent.load(saved), agent.load(saved)
    lost = [
        name
        for name, value in agent.bonus.state_dict().items()
        if not _same(value, first.bonus.state_dict()[name])
    ]
    stored_alike = all(map(_same, agent.stored(), first.stored()))
    for copy in (first, second):
        copy.learn(seed=seed)
    distance = _distance(first.critic(), second.critic())
    observed = (
        f"{len(lost)} entries of the bonus lost, replay {'kept' if stored_alike else 'lost'}"
    )
    return Finding(
        "state",
        not lost and stored_alike and distance == 0,
        observed + ("" if distance == 0 else f", copies differ by {distance:.3g}"),
        "save the bonus's `state_dict`, its optimiser and the replay with the agent",
    )


def _saved(agent: Integration, folder: Path) -> Path:
    folder.mkdir()
    agent.save(folder)
    return folder


def _distance(first: list[Tensor], second: list[Tensor]) -> float:
    """Largest difference of two lists of parameters: none where both are NaN, else infinite."""
    differences = [
        (one - other).detach().masked_fill(one.isclose(other, 0, 0, equal_nan=True), 0.0)
        for one, other in zip(first, second, strict=True)
    ]
    return max(each.nan_to_num(nan=math.inf).abs().max().item() for each in differences)


def _same(first: Tensor, second: Tensor) -> bool:
    return torch.equal(first.cpu().double().nan_to_num(), second.cpu().double().nan_to_num())
