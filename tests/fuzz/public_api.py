"""Calls the public API with valid, odd and absurd arguments, and says how each was answered.

    python tests/fuzz/public_api.py --calls 10000 --seed 0

The package is judged as users meet it: without the type checks that the tests put around it.
"""

import argparse
import random
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass
from inspect import isabstract, signature
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

sys.path.insert(0, str(Path(__file__).parents[2]))
from deep_curiosity import gaussians
from deep_curiosity.agent.config import ConditionedHunger
from deep_curiosity.agent.sac import CuriousSAC
from deep_curiosity.bonuses import BONUSES, BonusLearner, CuriosityBonus, make_bonus
from deep_curiosity.bonuses.baselines import ConstantBonus
from deep_curiosity.replay import ReplayBuffer
from deep_curiosity.schedules import Schedule
from deep_curiosity.tabular import (
    agent as tabular_agent,
)
from deep_curiosity.tabular import (
    environments,
    estimators,
    far_sighted,
    information,
    iteration,
    markov,
    neighbours,
    policies,
    rate_return,
    solvers,
)
from deep_curiosity.tabular import (
    schedules as tabular_schedules,
)
from deep_curiosity.transitions import Transition

OUTCOMES = (
    "finite answer",
    "clear refusal",
    "unclear refusal",
    "silent non-finite answer",
    "mismatched batch taken",
)
CLEAR = re.compile(r"`[^`]+`.* (must|is no|is for|cannot) .*got |`[^`]+` is no setting", re.DOTALL)
ROWS, DIM, ACTIONS = 6, 3, 2
STATES, CHOICES = 4, 3
SMALL: dict[str, Any] = {"hidden_dims": (8,), "refresh_interval": 1}
ODDS = 0.25  # of an argument that is not what it should be
HUGE = (1e12, 1e25, 1e38, -1e38, 3.4e38)
UNDEFINED = (float("nan"), float("inf"), -float("inf"))
ABSURD: tuple[Any, ...] = (None, "a", "", [], {}, object, True, (1, 2), b"x", 1j)


@dataclass(frozen=True)
class Target:
    """Something that can be called, and how its arguments are made.

    Args:
        name: As the table shows it.
        call: Of the arguments, by name.
        makers: Makes each of them, mostly well.
        may_be_infinite: Whether infinity is an answer, as of a divergence.
        may_broadcast: Whether one row stands for all.
    """

    name: str
    call: Callable[..., Any]
    makers: dict[str, Callable[[random.Random], Any]]
    may_be_infinite: bool = False
    may_broadcast: bool = False


@dataclass(frozen=True)
class Outcome:
    """How one call went."""

    target: str
    kind: str
    told: str


# arguments


def odd_or(valid: Callable[[random.Random], Any], odd: Callable[[random.Random], Any]) -> Any:
    """Mostly what is valid."""
    return lambda rng: odd(rng) if rng.random() < ODDS else valid(rng)


def number(low: float = 0.1, high: float = 0.9) -> Any:
    """A number in a range, or something else."""
    odd = (*HUGE, *UNDEFINED, *ABSURD, 0.0, -1.0, -0.0, 1e-38, 5, np.float32(0.5), "0.5")
    return odd_or(lambda rng: rng.uniform(low, high), lambda rng: rng.choice(odd))


def count(low: int = 1, high: int = 8) -> Any:
    """A whole number in a range, or something else."""
    odd = (*UNDEFINED, *ABSURD, 0, -1, 2.5, 10**18, np.int64(3), 3.0, "3")
    return odd_or(lambda rng: rng.randint(low, high), lambda rng: rng.choice(odd))


def choice(*valid: Any) -> Any:
    """One of some values, or something else."""
    return odd_or(
        lambda rng: rng.choice(valid), lambda rng: rng.choice((*ABSURD, 3, 0.5, "nonsense"))
    )


def tensor(*shape: int, bound: float = 1.0) -> Any:
    """A tensor, or one that is wrong in shape, kind or content, or something else."""

    def draw(rng: random.Random) -> Tensor:
        generator = torch.Generator().manual_seed(rng.randrange(2**31))
        return bound * (2 * torch.rand(*shape, generator=generator) - 1)

    def odd(rng: random.Random) -> Any:
        value = draw(rng)
        options: tuple[Callable[[], Any], ...] = (
            lambda: value[:-1],
            lambda: value[:1],
            lambda: value[:0],
            lambda: value[..., :-1],
            lambda: value.unsqueeze(0),
            lambda: value[0],
            lambda: value.double(),
            lambda: value.half(),
            lambda: value.long(),
            lambda: value > 0,
            lambda: value.numpy(),
            lambda: value.tolist(),
            lambda: torch.cat([value, value]),
            lambda: with_entry(value, rng.choice(HUGE)),
            lambda: with_entry(value, rng.choice(UNDEFINED)),
            lambda: torch.full_like(value, rng.choice(HUGE)),
            lambda: torch.zeros_like(value),
            lambda: rng.choice(ABSURD),
        )
        return rng.choice(options)()

    return odd_or(draw, odd)


def mask(*shape: int) -> Any:
    """Flags, or something else."""
    odd = (
        lambda: torch.zeros(shape[0] + 1, dtype=torch.bool),
        lambda: torch.zeros(*shape),
        lambda: torch.zeros(*shape, 1, dtype=torch.bool),
        lambda: None,
        lambda: "a",
    )
    return odd_or(
        lambda rng: torch.tensor([rng.random() < 0.2 for _ in range(shape[0])]),
        lambda rng: rng.choice(odd)(),
    )


def array(*shape: int, normalised: bool = False, log: bool = False) -> Any:
    """An array, perhaps of probabilities or their logs, or one that is wrong, or no array."""

    def draw(rng: random.Random) -> np.ndarray:
        values = np.random.default_rng(rng.randrange(2**31))
        if normalised or log:
            value = values.dirichlet(np.ones(shape[-1]), size=shape[:-1])
            return np.log(value) if log else value
        return values.normal(size=shape)

    def odd(rng: random.Random) -> Any:
        value = draw(rng)
        options: tuple[Callable[[], Any], ...] = (
            lambda: value[:-1],
            lambda: value[:0],
            lambda: value[..., :-1],
            lambda: value[None],
            lambda: value[0],
            lambda: value.astype(np.float32),
            lambda: value.astype(int),
            lambda: value > 0,
            lambda: value.tolist(),
            lambda: np.concatenate([value, value]),
            lambda: with_entry(value, rng.choice(HUGE)),
            lambda: with_entry(value, rng.choice(UNDEFINED)),
            lambda: np.full_like(value, rng.choice(HUGE)),
            lambda: np.zeros_like(value),
            lambda: -value,
            lambda: rng.choice(ABSURD),
        )
        return rng.choice(options)()

    return odd_or(draw, odd)


def with_entry(value: Any, entry: float) -> Any:
    """The same with one entry that is another."""
    value = value.clone() if isinstance(value, Tensor) else value.copy()
    value.reshape(-1)[0] = entry
    return value


def given(*values: Any) -> Any:
    """One of some values, always."""
    return lambda rng: rng.choice(values)


def transition(num_rows: int = ROWS) -> dict[str, Any]:
    """Makers of the fields of a transition."""
    return {
        "observation": tensor(num_rows, DIM, bound=3.0),
        "action": tensor(num_rows, ACTIONS),
        "reward": tensor(num_rows),
        "next_observation": tensor(num_rows, DIM, bound=3.0),
        "terminated": mask(num_rows),
        "truncated": mask(num_rows),
    }


# targets


def ready_bonus(name: str) -> Any:
    """A small bonus that has observed a batch."""
    options = SMALL | ({"components": 8, "num_members": 2} if name == "curiosity" else {})
    bonus = make_bonus(name, DIM, ACTIONS, **options)
    flags = torch.zeros(ROWS, dtype=torch.bool)
    draws = torch.randn(ROWS, DIM), torch.rand(ROWS, ACTIONS), torch.randn(ROWS)
    bonus.observe(Transition(*draws, torch.randn(ROWS, DIM), flags, flags))
    return bonus


def watched(bonus: Any, batch: Transition) -> Tensor:
    """What a bonus that has observed a batch says of pairs that are sound."""
    bonus.observe(batch)
    observation, action = torch.randn(ROWS, DIM), torch.rand(ROWS, ACTIONS)
    return bonus(observation, action, torch.randn(ROWS, DIM))


def of_bonuses() -> Iterator[Target]:
    for name in BONUSES:
        triple = {key: transition()[key] for key in ("observation", "action", "next_observation")}
        yield Target(f"{name}()", lambda name=name, **pair: ready_bonus(name)(**pair), triple)
        yield Target(
            f"{name}.loss",
            lambda name=name, **batch: ready_bonus(name).loss(Transition(**batch)),
            transition(),
        )
        yield Target(
            f"{name}.observe",
            lambda name=name, **batch: watched(ready_bonus(name), Transition(**batch)),
            transition(),
        )
        yield Target(
            f"BonusLearner({name})",
            lambda learning_rate, update_interval, name=name, **batch: learn(
                BonusLearner(
                    ready_bonus(name),
                    learning_rate=learning_rate,
                    update_interval=update_interval,
                ),
                Transition(**batch),
            ),
            {"learning_rate": number(1e-4, 1e-3), "update_interval": count()} | transition(),
        )
    pair = {key: transition()[key] for key in ("observation", "action")}
    yield Target("nats", lambda **pair: ready_bonus("curiosity").nats(**pair), pair)
    yield Target("decompose", lambda **pair: ready_bonus("curiosity").decompose(**pair), pair)
    yield Target("constant()", lambda **pair: ConstantBonus(0.1)(**pair), pair)
    yield Target("ConstantBonus", ConstantBonus, {"value": number()})
    yield Target("loss of anything", lambda batch: ready_bonus("rnd").loss(batch), ABSURD_ONLY)
    yield Target(
        "observe of anything", lambda batch: ready_bonus("curiosity").observe(batch), ABSURD_ONLY
    )


ABSURD_ONLY = {"batch": given(*ABSURD, 1.5, torch.zeros(3))}


def learn(learner: BonusLearner, batch: Transition) -> Tensor:
    learner.learn(batch)
    return learner.compute(batch)


def of_making() -> Iterator[Target]:
    sizes = {"observation_dim": count(), "action_dim": count()}
    hidden = {"hidden_dims": choice((8,), (8, 4), ())}
    options = {
        "num_members": count(2, 4),
        "components": count(2, 8),
        "noise_floor": number(),
        "bandwidth": choice("silverman", 0.5),
        "bonus_weight": number(),
        "refresh_interval": count(),
        "whitening": choice("moments", "robust", "saturating"),
        "members": choice("all", "round_robin"),
        "features": choice((), (0,)),
        "bonus_parts": choice({}, {"information_gain": 1.0}),
        "tune_bonus_weight": choice(None, "past", 0.5),
        "model_mixture_components": count(1, 3),
    }
    yield Target("CuriosityBonus.default", CuriosityBonus.default, sizes | hidden | options)
    named = {"name": choice(*BONUSES), "bonus_weight": number()}
    yield Target("make_bonus", make_bonus, named | sizes | hidden)
    unknown = {"name": given("rnd"), "noise_floor": number(), "hidden": count()}
    yield Target("make_bonus, unknown setting", make_bonus, unknown | sizes)
    agent = {
        "hidden_dim": count(),
        "prior": choice("uniform", "learned"),
        "hunger": number(),
        "temperature": number(),
        "learning_rate": number(),
        "polyak": number(),
        "discount": number(),
        "curiosity_discount": number(),
        "reward_steps": count(1, 3),
        "curiosity_steps": count(1, 3),
        "policy_mixture_components": count(1, 3),
        "actor_batch_fraction": choice(1.0, 0.5),
        "curiosity_coefficient": choice("adaptive", 0.5),
    }
    yield Target("CuriousSAC.default", CuriousSAC.default, sizes | agent)
    yield Target(
        "CuriousSAC",
        CuriousSAC,
        sizes | {"config": choice(None), "curiosity": choice(True, False)},
    )
    yield Target("BonusLearner", BonusLearner, {"bonus": given(*ABSURD)})


def small_agent(**options: Any) -> CuriousSAC:
    return CuriousSAC.default(DIM, ACTIONS, hidden_dim=8, **options)


def set_attribute(name: str, value: Any) -> float:
    agent = small_agent()
    setattr(agent, name, value)
    return getattr(agent, name)


def of_agent() -> Iterator[Target]:
    batch, observation = transition(), {"observation": tensor(ROWS, DIM, bound=3.0)}
    yield Target("act", lambda **given: small_agent().act(**given), observation)
    yield Target("metrics", lambda **given: small_agent().metrics(**given), observation)
    yield Target(
        "update",
        lambda bonus, **fields: small_agent().update(Transition(**fields), bonus),
        batch | {"bonus": tensor(ROWS)},
    )
    yield Target(
        "update, plain",
        lambda **fields: small_agent(curiosity=False).update(Transition(**fields)),
        batch,
    )
    yield Target(
        "update of anything", lambda batch: small_agent().update(batch, None), ABSURD_ONLY
    )
    for name in ("hunger", "temperature", "curiosity_coefficient"):
        yield Target(
            f"agent.{name} =",
            lambda value, name=name: set_attribute(name, value),
            {"value": number()},
        )
    number_or = {"first": number(), "last": choice(0.5, 2.0), "shape": choice("linear")}
    yield Target("Schedule", Schedule, number_or)
    yield Target("Schedule.parse", Schedule.parse, {"text": choice("linear:1:2", "linear:a")})
    yield Target(
        "Schedule()", lambda progress: Schedule(1.0, 2.0)(progress), {"progress": number()}
    )
    hunger = {"source": choice("fixed", "random"), "value": number()}
    yield Target("ConditionedHunger", ConditionedHunger, hunger)
    yield Target(
        "ConditionedHunger.parse",
        ConditionedHunger.parse,
        {"text": choice("conditioned:0.5", "bandit")},
    )


def filled_replay() -> ReplayBuffer:
    replay = ReplayBuffer(16, DIM, ACTIONS)
    for _ in range(5):
        replay.add(np.zeros(DIM), np.zeros(ACTIONS), 0.0, np.ones(DIM), False, False)
    return replay


def of_replay() -> Iterator[Target]:
    sizes = {"capacity": count(), "observation_dim": count(), "action_dim": count()}
    yield Target("ReplayBuffer", ReplayBuffer, sizes | {"num_envs": count()})
    for name, keys in (
        ("sample", ("batch_size",)),
        ("sample_sequences", ("batch_size", "num_steps")),
        ("sample_fading", ("batch_size", "half_life")),
        ("newest", ("num_rows",)),
        ("evenly_spaced", ("num_rows",)),
    ):
        yield Target(
            f"replay.{name}",
            lambda name=name, **counts: getattr(filled_replay(), name)(**counts),
            {key: count() for key in keys},
        )


def of_gaussians() -> Iterator[Target]:
    one = {name: tensor(ROWS, DIM) for name in ("loc", "log_var")}
    other = {name: tensor(ROWS, DIM) for name in ("other_loc", "other_log_var")}
    mixture = {"component_loc": tensor(5, DIM), "component_log_var": tensor(5, DIM)}
    yield Target("gaussian_entropy", gaussians.gaussian_entropy, {"log_var": one["log_var"]})
    yield Target("gaussian_kl", gaussians.gaussian_kl, one | other, may_broadcast=True)
    value = {"value": one["loc"], "loc": one["loc"], "log_std": one["log_var"]}
    yield Target("gaussian_log_prob", gaussians.gaussian_log_prob, value, may_broadcast=True)
    for bound in (gaussians.kl_to_mixture_upper, gaussians.kl_to_mixture_lower):
        yield Target(bound.__name__, bound, one | mixture)
    at = {"value": one["loc"]}
    yield Target("mixture_log_density", gaussians.mixture_log_density, at | mixture)
    yield Target("expected_log_density", gaussians.expected_log_density, one | mixture)
    three = {"loc": tensor(ROWS, 2, DIM), "log_var": tensor(ROWS, 2, DIM)}
    three |= {"log_weight": tensor(ROWS, 2)}
    for bound in (gaussians.jensen_shannon_lower, gaussians.jensen_shannon_upper):
        yield Target(bound.__name__, bound, three)


TABULAR_ARRAYS = {
    "transition": array(STATES, CHOICES, STATES, normalised=True),
    "reward": array(STATES, CHOICES),
    "start": array(STATES, normalised=True),
    "policy": array(STATES, CHOICES, normalised=True),
    "log_policy": array(STATES, CHOICES, log=True),
    "state_distribution": array(STATES, normalised=True),
    "distribution": array(STATES, normalised=True),
    "probability": array(STATES, CHOICES, normalised=True),
    "channel": array(STATES, CHOICES, normalised=True),
    "chain": array(STATES, STATES, normalised=True),
    "log_prior": array(CHOICES, log=True),
    "log_marginal": array(STATES, log=True),
    "log_reference": array(STATES, CHOICES, log=True),
    "log_weight": array(STATES, CHOICES),
    "weight": array(STATES, CHOICES, normalised=True),
    "target": array(STATES, CHOICES, log=True),
    "divergence": array(STATES, CHOICES),
    "score": array(STATES, CHOICES),
    "value": array(STATES, CHOICES),
    "weighted_value": array(STATES, CHOICES),
    "action_value": array(STATES, CHOICES),
}
TABULAR_NUMBERS = {
    "discount", "temperature", "curiosity_discount", "damping", "slip", "bait", "epsilon",
    "rate", "first", "factor", "least", "hunger", "nats", "bits", "reward_weight",
    "largest_reward", "pseudo_count",
}  # fmt: skip
TABULAR_COUNTS = {"num_states", "num_actions", "num_rows", "num_columns", "num_known"}
TABULAR_FIXED: dict[str, Any] = {
    "max_iterations": 20,
    "num_iterations": 5,
    "tolerance": 1e-3,
}


def finite_mdp() -> environments.FiniteMDP:
    return environments.random_mdp(STATES, CHOICES, np.random.default_rng(0))


def maker_of(name: str) -> Any:
    """Makes an argument of a function of finite environments, by its name; or `None`."""
    if name in TABULAR_ARRAYS:
        return TABULAR_ARRAYS[name]
    if name in TABULAR_NUMBERS:
        return number()
    if name in TABULAR_COUNTS:
        return count(2, 5)
    if name in TABULAR_FIXED:
        return given(TABULAR_FIXED[name])
    others = {
        "mdp": odd_or(lambda rng: finite_mdp(), lambda rng: rng.choice(ABSURD)),
        "rng": odd_or(lambda rng: np.random.default_rng(0), lambda rng: rng.choice(ABSURD)),
        "temperatures": choice([0.5, 0.1], (1.0,)),
    }
    return others.get(name)


def of_tabular() -> Iterator[Target]:
    modules = (
        environments, far_sighted, information, iteration, markov, neighbours, policies,
        rate_return, solvers, tabular_schedules, estimators,
    )  # fmt: skip
    infinite = {"kl_divergence", "curiosity", "curious_score", "safe_log"}
    for module in modules:
        for name, function in vars(module).items():
            own = getattr(function, "__module__", "") == module.__name__ and name[0] != "_"
            if not own or not callable(function) or isabstract(function):
                continue
            if isinstance(function, type) and issubclass(function, tuple):  # of any values
                continue
            names = [*signature(function).parameters]
            makers = {key: maker_of(key) for key in names}
            if not makers or None in makers.values():
                continue
            may_be_infinite = name in infinite or "log" in name or name in LOG_ANSWERS
            yield Target(f"tabular {name}", function, makers, may_be_infinite=may_be_infinite)
    index = {name: count(0, STATES - 1) for name in ("state", "next_state")}
    step = index | {"action": count(0, CHOICES - 1), "reward": number()}
    for kind in (estimators.CountedModel, estimators.VisitedStates, estimators.QLearning):
        name = f"tabular {kind.__name__}.observe"
        yield Target(name, lambda kind=kind, **of: observed(kind, of), step)
    yield Target(
        "tabular act",
        lambda state: tabular_agent.FixedPolicy(np.full((STATES, CHOICES), 1 / CHOICES)).act(
            state, np.random.default_rng(0)
        ),
        {"state": count(0, STATES - 1)},
    )


LOG_ANSWERS = {"information_limited", "boltzmann", "mix_uniform", "damp", "rate_point"}
LOG_ANSWERS |= {"zero_rate_point", "largest_return", "information_to_go"}
LOG_ANSWERS |= {
    "dynamic_policy_programming",
    "solve_time_step",
    "solve_stationary",
    "predictive_states",
}


def observed(kind: type, fields: dict[str, Any]) -> Any:
    experience = estimators.Experience(**fields)
    if kind is estimators.CountedModel:
        learner: Any = kind(STATES, CHOICES)
        learner.observe(experience)
        return learner.transition, learner.reward
    if kind is estimators.VisitedStates:
        learner = kind(STATES)
        uniform = np.full((STATES, CHOICES), 1 / CHOICES)
        learner.observe(experience, finite_mdp().transition, uniform)
        return learner.distribution
    learner = kind(STATES, CHOICES, 0.5)
    learner.observe(experience)
    return learner.action_value


def all_targets() -> list[Target]:
    """Everything that is called."""
    parts = (of_bonuses, of_making, of_agent, of_replay, of_gaussians, of_tabular)
    return [target for part in parts for target in part()]


# outcomes


def numbers_in(value: Any) -> Iterator[np.ndarray]:
    """All numbers in an answer or an argument."""
    if isinstance(value, Tensor):
        value = value.detach().numpy()
    if isinstance(value, float | int | np.ndarray | np.floating):
        yield np.atleast_1d(np.asarray(value))
    elif isinstance(value, dict):
        for each in value.values():
            yield from numbers_in(each)
    elif isinstance(value, tuple | list):
        for each in value:
            yield from numbers_in(each)
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from numbers_in(getattr(value, field.name))
    elif isinstance(value, nn.Module):
        yield from numbers_in(dict(value.named_parameters()))


def is_finite(value: Any, *, infinite: bool = False) -> bool:
    """Whether all numbers in a value are finite; or else none NaN."""
    test: Any = (lambda entries: ~np.isnan(entries)) if infinite else np.isfinite
    return all(test(part).all() for part in numbers_in(value) if part.dtype.kind == "f")


def has_zero(arguments: dict[str, Any]) -> bool:
    """Whether an argument is the logarithm of zero: of a weight, or of the width of a point."""
    logs = [
        value for name, value in arguments.items() if "log_" in name and isinstance(value, Tensor)
    ]
    return any(bool((value == -torch.inf).any()) for value in logs)


def sums_infinity(target: Target, arguments: dict[str, Any]) -> bool:
    """Whether infinity is given to the sum that takes it, as zero times it is zero there."""
    return target.name == "tabular weighted_sum" and not is_finite(arguments["value"])


def is_mismatched(arguments: dict[str, Any], target: Target) -> bool:
    """Whether arguments that are said to share their rows do not."""
    expected = {"observation", "action", "reward", "next_observation", "terminated", "truncated"}
    expected |= {"bonus"}
    if target.name.startswith(("gaussian", "jensen")):
        expected = {*arguments}
    batches = [arguments[name] for name in expected & {*arguments}]
    least = 2 if target.may_broadcast else 1
    rows = {len(value) for value in batches if isinstance(value, Tensor) and value.ndim >= least}
    if target.may_broadcast:
        rows -= {1}
    return len(rows) > 1


def call(target: Target, rng: random.Random) -> Outcome:
    """Make arguments, call, and classify."""
    arguments = {name: make(rng) for name, make in target.makers.items()}
    torch.manual_seed(0)
    try:
        answer = target.call(**arguments)
    except Exception as error:
        kind = "clear refusal" if CLEAR.search(str(error)) else "unclear refusal"
        return Outcome(target.name, kind, f"{type(error).__name__}: {error}")
    kind = "finite answer"
    may_be_infinite = (
        target.may_be_infinite or has_zero(arguments) or sums_infinity(target, arguments)
    )
    if not is_finite(answer, infinite=may_be_infinite):
        kind = "silent non-finite answer"
    elif is_mismatched(arguments, target):
        kind = "mismatched batch taken"
    return Outcome(target.name, kind, str(arguments))


def fuzz(num_calls: int, seed: int) -> list[Outcome]:
    """Call targets by turns, with arguments of the seed."""
    rng, targets = random.Random(seed), all_targets()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [call(targets[number % len(targets)], rng) for number in range(num_calls)]


def describe(outcomes: list[Outcome], seed: int, *, num_shown: int = 5) -> str:
    """A table of the outcomes, and examples of those that should not be."""
    counts = Counter(outcome.kind for outcome in outcomes)
    refusals = counts["clear refusal"] + counts["unclear refusal"]
    lines = [f"{len(outcomes)} calls of {len({each.target for each in outcomes})}, seed {seed}"]
    lines += [f"{counts[kind]:7} {kind}" for kind in OUTCOMES]
    lines.append(f"{counts['clear refusal'] / max(1, refusals):7.2%} of refusals are clear")
    for kind in OUTCOMES[2:]:
        found = {each.target + each.told[:60]: each for each in outcomes if each.kind == kind}
        for each in [*found.values()][:num_shown]:
            lines.append(f"  {kind}: {each.target}: {each.told[:400]}")
    return "\n".join(lines)


def is_sound(outcomes: list[Outcome]) -> bool:
    """Whether nothing was silent or mismatched, and nearly all refusals are clear."""
    counts = Counter(outcome.kind for outcome in outcomes)
    refusals = counts["clear refusal"] + counts["unclear refusal"]
    silent = counts["silent non-finite answer"] + counts["mismatched batch taken"]
    return silent == 0 and counts["clear refusal"] >= 0.98 * refusals


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--calls", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shown", type=int, default=5)
    args = parser.parse_args()
    torch.set_num_threads(1)
    outcomes = fuzz(args.calls, args.seed)
    print(describe(outcomes, args.seed, num_shown=args.shown))
    sys.exit(not is_sound(outcomes))
