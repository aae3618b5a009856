"""Makes every number and figure of the paper's two illustrations, exact, into docs/paper/.

python scripts/paper.py
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro

from deep_curiosity.tabular.agent import FixedPolicy, run
from deep_curiosity.tabular.environments import (
    STAY,
    FiniteMDP,
    chain,
    clever_random,
    grid_world,
    random_mdp,
    reliable_unreliable,
)
from deep_curiosity.tabular.estimators import CountedModel, QLearning, Sarsa
from deep_curiosity.tabular.information import (
    action_information,
    log_next_state_marginal,
    predictive_information,
    state_predictive_information,
    to_bits,
    to_nats,
)
from deep_curiosity.tabular.iteration import damp, safe_damping
from deep_curiosity.tabular.markov import (
    action_values,
    optimal_action_values,
    stationary_distribution,
)
from deep_curiosity.tabular.neighbours import (
    EpsilonGreedy,
    PredictionErrorCuriosity,
    RMax,
    dynamic_policy_programming,
    information_to_go,
    predictive_states,
)
from deep_curiosity.tabular.policies import boltzmann, random_log_policy
from deep_curiosity.tabular.rate_return import largest_return, rate_return_curve
from deep_curiosity.tabular.solvers import curious_score, curious_step, solve_stationary

TEMPERATURES = (0.05, 0.3, 1.5)
CURIOSITY_DISCOUNTS = (0.0, 0.5, 0.9, 0.99, 0.999, 1.0)
BLUE, ORANGE, GREEN, GREY = "#1f5fa8", "#d9731a", "#3a8f4d", "#888888"


@dataclass
class Args:
    """What to make, and where."""

    out: Path = Path("docs/paper")  # folder for the tables, the figures and their README.md
    seed: int = 0  # seed of the random starts and of the samples


def main(args: Args) -> None:
    """Makes all of it: tables first, then figures, then the page that reads them."""
    args.out.mkdir(parents=True, exist_ok=True)
    plt.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    clever = clever_random_page(args)
    reliable = reliable_page(args)
    dual = rate_return_page(args)
    slopes = samples_page(args)
    neighbours_page(args)
    (args.out / "README.md").write_text(page(clever, reliable, dual, slopes))


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence]) -> None:
    """Writes rows as CSV, numbers to six places."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([[tidy(entry) for entry in row] for row in rows])


def tidy(entry: object) -> object:
    """Rounds a float to six places, and leaves the rest."""
    return f"{entry:.6f}" if isinstance(entry, float) else entry


def save(figure: plt.Figure, path: Path) -> None:
    """Saves and closes a figure."""
    figure.tight_layout()
    figure.savefig(path, dpi=130, metadata={"Software": None})
    plt.close(figure)


def bits_of(world: FiniteMDP, policy: np.ndarray) -> float:
    """Predictive information of a policy in its own stationary states, in bits."""
    states = stationary_distribution(world.transition, policy, world.start)
    return to_bits(predictive_information(world.transition, policy, states))


def clever_random_page(args: Args) -> dict[str, float]:
    """Ends of the damped iteration from random starts, and the course of the one as written."""
    world, rng = clever_random(), np.random.default_rng(args.seed)
    starts = [random_log_policy(2, world.num_actions, rng) for _ in range(25)]
    rows, ends = [], {}
    for temperature in TEMPERATURES:
        ends[temperature] = [
            solve_stationary(world, start, temperature=temperature, tolerance=1e-8).policy
            for start in starts
        ]
        for number, policy in enumerate(ends[temperature]):
            split, extreme = policy[0, 0], policy[:, [0, -1]].sum(1).min()
            rows.append((temperature, number, split, extreme, bits_of(world, policy)))
    header = ("lambda_nats", "start", "pi_stay_given_0", "mass_on_0_and_1", "bits")
    write_table(args.out / "clever_random.csv", header, rows)

    settings = [(0.3, 1.0), (0.9, 1.0), (1.1, 1.0), (0.3, safe_damping(0.3))]
    courses = {setting: course(world, starts[0], *setting) for setting in settings}
    header = ("lambda_nats", "damping", "update", "p_next_is_0", "bits_carried", "bits_reported")
    course_rows = [(*setting, *row) for setting, rows in courses.items() for row in rows]
    write_table(args.out / "clever_random_courses.csv", header, course_rows)
    draw_clever_random(args.out, starts, ends, courses)
    splits, bits = np.array([(row[2], row[4]) for row in rows]).T
    return {
        "shortfall": 1 - bits.min(),
        "least_split": splits.min(),
        "largest_split": splits.max(),
        "least_extreme": min(row[3] for row in rows),
        "reported": courses[0.3, 1.0][9][3],
        "carried": courses[0.3, 1.0][9][2],
    }


def course(
    world: FiniteMDP, log_policy: np.ndarray, temperature: float, damping: float
) -> list[tuple]:
    """Updates (23)-(25), damped by 1 as written: next-state marginal, bits carried and reported.

    What is reported mixes the new policy with the divergence from the marginal of the old one.
    """
    rows, nothing = [], np.zeros(world.reward.shape)
    for update in range(1, 101):
        divergence = curious_score(world.transition, log_policy, world.start)
        target, _ = curious_step(world.transition, log_policy, world.start, nothing, temperature)
        log_policy = damp(log_policy, target, damping)
        policy = np.exp(log_policy)
        marginal = np.exp(log_next_state_marginal(world.transition, log_policy, world.start))
        carried = to_bits(predictive_information(world.transition, policy, world.start))
        reported = to_bits(float(world.start @ (policy * divergence).sum(1)))
        rows.append((update, float(marginal[0]), max(0.0, carried), reported))
    return rows


def draw_clever_random(out: Path, starts: list, ends: dict, courses: dict) -> None:
    """Policy before and after, the continuum of splits, and the two-cycle."""
    figure, (before, splits, cycle) = plt.subplots(1, 3, figsize=(11.5, 3.4))
    action = np.linspace(0, 1, 101)
    before.plot(action, np.exp(starts[0][0]), color=GREY, lw=1, label="random start")
    for policy, color in zip(ends[0.3][:2], (BLUE, ORANGE), strict=True):
        shift = 0.012 if color == ORANGE else 0
        before.vlines(action[[0, -1]] + shift, 0, policy[0, [0, -1]], color=color, lw=4)
    before.plot([], [], color=BLUE, lw=4, label="end, from this start")
    before.plot([], [], color=ORANGE, lw=4, label="end, from another start")
    before.set(xlabel="action a = probability to flip", ylabel=r"$\pi(a\,|\,0)$", ylim=(0, 1))
    before.set_title("Only STAY and FLIP survive")
    before.legend(frameon=False, loc="upper center")

    rng = np.random.default_rng(0)
    for place, policies in enumerate(ends.values()):
        split = [policy[0, 0] for policy in policies]
        jitter = place + rng.uniform(-0.15, 0.15, len(split))
        splits.plot(jitter, split, "o", ms=4, color=BLUE, alpha=0.7)
        least = min(bits_of(clever_random(), policy) for policy in policies)
        splits.text(place, 1.04, f"all {least:.3f} bit", ha="center", fontsize=8, color=GREY)
    splits.set_xticks(range(len(ends)), [f"{temperature:g}" for temperature in ends])
    splits.axhline(0.5, color=ORANGE, lw=1.2)
    splits.text(-0.78, 0.51, "limit (22)", color=ORANGE, va="bottom", fontsize=8)
    splits.set(xlabel=r"$\lambda$ in nats", ylabel=r"$\pi(\mathrm{STAY}\,|\,0)$")
    splits.set(ylim=(0, 1.12), xlim=(-0.8, 2.5))
    splits.set_title("(21): every split is a fixed point")

    for kind, damping, color in (("as written", 1.0, ORANGE), ("damped", safe_damping(0.3), BLUE)):
        update, marginal = np.array(courses[0.3, damping])[:30, :2].T
        cycle.plot(update, marginal, "o-", ms=2.5, lw=1, color=color, label=kind)
    cycle.set(xlabel="update", ylabel="p(X' = 0)", ylim=(-0.03, 1.25), yticks=(0, 0.5, 1))
    cycle.set_title(r"(23)-(25) as written cycle, $\lambda = 0.3$")
    cycle.legend(frameon=False, loc="upper right", ncol=2, fontsize=8)
    save(figure, out / "clever_random.png")


def reliable_page(args: Args) -> list[tuple]:
    """The far-sighted agent's table, and the landscape it climbs."""
    world, rng = reliable_unreliable(), np.random.default_rng(args.seed)
    rows = []
    for temperature in (to_nats(0.1), 0.5, 2.0):
        for discount in CURIOSITY_DISCOUNTS:
            start = random_log_policy(2, 2, rng)
            solution = solve_stationary(
                world, start, temperature=temperature, curiosity_discount=discount
            )
            states = stationary_distribution(world.transition, solution.policy, world.start)
            stay, bits = solution.policy[0, STAY], bits_of(world, solution.policy)
            rows.append((temperature, discount, stay, float(states[0]), bits))
    header = ("lambda_nats", "curiosity_discount", "pi_stay_given_0", "p_state_is_0", "bits")
    write_table(args.out / "reliable_unreliable.csv", header, rows)
    table = rows[: len(CURIOSITY_DISCOUNTS)]
    draw_reliable(args.out, world, table)
    return table


def draw_reliable(out: Path, world: FiniteMDP, table: list[tuple]) -> None:
    """Information against pi(STAY | 0), and where each curiosity_discount settles."""
    figure, (landscape, ends) = plt.subplots(1, 2, figsize=(9, 3.5))
    stay = np.linspace(0, 1, 401)
    policies = [np.array([[s, 1 - s], [0.5, 0.5]]) for s in stay]
    landscape.plot(
        stay, [bits_of(world, policy) for policy in policies], color=BLUE, label="its own states"
    )
    fixed = [to_bits(predictive_information(world.transition, p, world.start)) for p in policies]
    landscape.plot(stay, fixed, color=GREY, ls="--", label="states held at one half")
    for _, discount, share, _, bits in table:
        if discount in (0.0, 0.5, 0.9, 1.0):
            shift = {0.5: -9, 0.9: -4, 1.0: 9}.get(discount, 0)
            landscape.plot(share, bits, "o", color=ORANGE, ms=5)
            landscape.annotate(
                f"{discount:g}", (share, bits), (shift, 8), textcoords="offset points", ha="center"
            )
    landscape.set(xlabel=r"$\pi(\mathrm{STAY}\,|\,0)$", ylim=(0, 0.66))
    landscape.set_ylabel(r"$I(\{X, A\}; X')$ in bits")
    landscape.set_title("What each curiosity_discount climbs to")
    landscape.legend(frameon=False, loc="lower center")

    discounts = np.linspace(0, 1, 41)
    shares = [
        solve_stationary(world, temperature=0.5, curiosity_discount=float(d), tolerance=1e-8)
        for d in discounts
    ]
    ends.plot(discounts, [solution.policy[0, STAY] for solution in shares], color=BLUE)
    ends.axhline(0.75, color=ORANGE, lw=1, ls="--")
    ends.text(0.02, 0.755, "the paper's text: 3/4", color=ORANGE, va="bottom")
    ends.axhline(0.5, color=GREY, lw=1, ls="--")
    ends.text(0.98, 0.505, "the paper's equations: 1/2", color=GREY, va="bottom", ha="right")
    ends.set(xlabel="curiosity_discount", ylabel=r"$\pi(\mathrm{STAY}\,|\,0)$", ylim=(0.45, 0.8))
    ends.set_title("Seeing further moves one half to three quarters")
    save(figure, out / "reliable_unreliable.png")


def rate_return_page(args: Args) -> dict[str, float]:
    """The rate-return curve of a random world, for its optimal values."""
    world = random_mdp(8, 4, np.random.default_rng(args.seed))
    action_value = optimal_action_values(world.transition, world.reward, world.discount)
    uniform = np.full(world.reward.shape, 1 / world.num_actions)
    states = stationary_distribution(world.transition, uniform, world.start)
    temperatures = np.geomspace(0.5, 0.005, 60) * np.ptp(action_value)
    curve = rate_return_curve(action_value, states, temperatures)
    header = ("lambda", "rate_bits", "expected_return")
    rows = [(point.temperature, to_bits(point.rate), point.value) for point in curve]
    write_table(args.out / "rate_return.csv", header, rows)
    half = largest_return(action_value, states, to_nats(0.5))
    rates, values = np.array(rows)[:, 1], np.array(rows)[:, 2]
    softmax = [np.exp(boltzmann(action_value, t)) for t in temperatures]
    soft_rates = [to_bits(action_information(policy, states)) for policy in softmax]
    soft_values = [float(np.einsum("x,xa,xa->", states, p, action_value)) for p in softmax]

    figure, axis = plt.subplots(figsize=(5.6, 3.8))
    axis.plot(rates, values, color=BLUE, label="(13): most return for the rate")
    axis.plot(soft_rates, soft_values, color=GREY, ls="--", label="plain Boltzmann exploration")
    reach = to_bits(half.rate) + np.array([-0.2, 0.4])
    tangent = half.value + half.temperature * (to_nats(1.0) * reach - half.rate)
    axis.plot(reach, tangent, color=ORANGE, lw=1, label=r"tangent: slope $\lambda$ per nat")
    axis.plot(to_bits(half.rate), half.value, "o", color=ORANGE, label="dual (10) at 1/2 bit")
    axis.set(xlabel="I(A; X) in bits", ylabel="expected return")
    axis.set_title("Rate and return, random world of 8 states")
    axis.legend(frameon=False, loc="lower right")
    save(figure, args.out / "rate_return.png")
    return {
        "value": half.value,
        "temperature": half.temperature,
        "constant": float((states @ action_value).max()),
        "free": float(states @ action_value.max(1)),
        "free_rate": rates[-1],
    }


def samples_page(args: Args) -> dict[str, float]:
    """Errors of everything that can be learned from samples, against their number."""
    sizes = np.unique(np.geomspace(100, 30_000, 9).astype(int))
    world = random_mdp(6, 3, np.random.default_rng(args.seed), discount=0.5)
    errors = np.mean([sample_errors(world, sizes, args.seed + n) for n in range(6)], axis=0)
    names = ("p_t(x) from visits", "model", "curious policy", "Q by SARSA", "Q by Q-learning")
    rows = [(int(n), *map(float, row)) for n, row in zip(sizes, errors, strict=True)]
    header = ("samples", "visits", "model", "policy", "sarsa", "q_learning")
    write_table(args.out / "samples.csv", header, rows)
    figure, axis = plt.subplots(figsize=(5.8, 4))
    slopes = {}
    for name, key, error in zip(names, header[1:], errors.T, strict=True):
        tail = sizes >= 1_000
        slopes[key] = float(np.polyfit(np.log(sizes[tail]), np.log(error[tail]), 1)[0])
        axis.loglog(sizes, error, "o-", ms=3, lw=1.2, label=f"{name}: slope {slopes[key]:.2f}")
    guide = errors[0].max() * (sizes / sizes[0]) ** -0.5
    axis.loglog(sizes, guide, color="black", lw=0.8, ls=":", label="slope -1/2")
    axis.set(xlabel="samples", ylabel="error (root mean square)")
    axis.set_title("Samples approach the exact parts, random 6-state world")
    axis.legend(frameon=False, fontsize=8)
    save(figure, args.out / "samples.png")
    return slopes


def sample_errors(world: FiniteMDP, sizes: np.ndarray, seed: int) -> np.ndarray:
    """Root mean square errors at each number of samples, one column for each estimate."""
    uniform = np.full(world.reward.shape, 1 / world.num_actions)
    exact_states = stationary_distribution(world.transition, uniform, world.start)
    of_policy = action_values(world.transition, world.reward, uniform, world.discount)
    of_best = optimal_action_values(world.transition, world.reward, world.discount)
    exact = solve_stationary(world, temperature=1.0, hunger=1.0, tolerance=1e-8).policy
    model = CountedModel(*world.reward.shape)
    sarsa, q_learning = (kind(*world.reward.shape, world.discount) for kind in (Sarsa, QLearning))
    visits, rows = np.zeros(world.num_states), []
    history = run(FixedPolicy(uniform), world, int(sizes[-1]), np.random.default_rng(seed))
    for step, experience in enumerate(history, start=1):
        for learner in (model, sarsa, q_learning):
            learner.observe(experience)
        visits[experience.state] += 1
        if step in sizes:
            learned = FiniteMDP(model.transition, model.reward, world.start, world.discount)
            policy = solve_stationary(learned, temperature=1.0, hunger=1.0, tolerance=1e-6).policy
            differences = (
                visits / step - exact_states,
                model.transition - world.transition,
                policy - exact,
                sarsa.action_value - of_policy,
                q_learning.action_value - of_best,
            )
            rows.append([float(np.sqrt(np.mean(each**2))) for each in differences])
    return np.array(rows)


def neighbours_page(args: Args) -> None:
    """Every neighbour on every world: three informations, in bits, and the reward per step."""
    worlds = {
        "clever random": clever_random(11),
        "reliable / unreliable": reliable_unreliable(),
        "grid 4 x 4": grid_world(),
        "chain of 8": chain(8),
    }
    rows = []
    for name, world in worlds.items():
        for method, policy in neighbour_policies(world, args.seed).items():
            states = stationary_distribution(world.transition, policy, world.start)
            both = to_bits(predictive_information(world.transition, policy, states))
            alone = to_bits(state_predictive_information(world.transition, policy, states))
            cost = to_bits(action_information(policy, states))
            pay = float(np.einsum("x,xa,xa->", states, policy, world.reward))
            rows.append((name, method, *(max(0.0, bits) for bits in (both, alone, cost)), pay))
    header = ("world", "method", "bits_state_and_action", "bits_state_alone", "bits_cost", "pay")
    write_table(args.out / "neighbours.csv", header, rows)
    draw_neighbours(args.out, list(worlds), rows)


def neighbour_policies(world: FiniteMDP, seed: int) -> dict[str, np.ndarray]:
    """The policy each method ends with."""
    rng, shape = np.random.default_rng(seed), world.reward.shape
    learners = {
        "epsilon-greedy": EpsilonGreedy(*shape, discount=world.discount),
        "R-MAX": RMax(*shape, discount=world.discount, largest_reward=1.0),
        "prediction error": PredictionErrorCuriosity(*shape, discount=world.discount),
    }
    for learner in learners.values():
        run(learner, world, 5_000, rng)
    uniform = np.full(world.num_states, 1 / world.num_states)
    start = random_log_policy(*shape, rng)
    options = {"temperature": 0.3, "tolerance": 1e-7}
    log_policies = {
        "information to go": information_to_go(world, uniform, reward_weight=10.0),
        "dynamic policy progr.": dynamic_policy_programming(world, temperature=1.0),
        "predictive states": predictive_states(world, start, curiosity_discount=0.9).log_policy,
        "curious": solve_stationary(world, start, **options).log_policy,
        "curious, far-sighted": solve_stationary(
            world, start, **options, curiosity_discount=0.95
        ).log_policy,
        "curious and hungry": solve_stationary(world, start, **options, hunger=10.0).log_policy,
    }
    policies = {name: learner.policy for name, learner in learners.items()}
    return policies | {name: np.exp(log_policy) for name, log_policy in log_policies.items()}


def draw_neighbours(out: Path, worlds: list[str], rows: list[tuple]) -> None:
    """Predictive information of every method on every world, with its pay written beside it."""
    figure, axes = plt.subplots(1, len(worlds), figsize=(12, 3.6), sharey=True)
    for axis, world in zip(axes, worlds, strict=True):
        chosen = [row for row in rows if row[0] == world][::-1]
        place = np.arange(len(chosen))
        axis.barh(place + 0.2, [row[2] for row in chosen], 0.38, color=BLUE, label="I({X, A}; X')")
        axis.barh(place - 0.2, [row[3] for row in chosen], 0.38, color=GREY, label="I(X; X')")
        axis.set_yticks(place, [row[1] for row in chosen])
        axis.set(title=world, xlabel="bits")
        if any(row[5] > 0 for row in chosen):
            reach = max(row[2] for row in chosen)
            axis.set_xlim(0, 1.55 * reach)
            for height, row in zip(place, chosen, strict=True):
                axis.text(1.55 * reach, height, f"pay {row[5]:.3f}", ha="right", va="center")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower left", frameon=False, fontsize=8)
    save(figure, out / "neighbours.png")


PAGE = """\
# The paper in numbers

Every number and figure here is computed by `deep_curiosity.tabular`, exactly but for the section
on samples, and written by

    python scripts/paper.py

The paper: Still & Precup, "An information-theoretic approach to curiosity-driven reinforcement
learning" (2012). Equation numbers are the paper's. Temperatures are in nats.

## Clever random

Two states; the action, in [0, 1] on a grid of 101, is the probability to flip. No reward.

| | the paper prints | here |
| --- | --- | --- |
| actions in use | only 0 and 1 | only 0 and 1: at least {least_extreme:.6f} of the mass |
| I({{X, A}}; X') | the largest possible | 1 bit, the largest possible, to within {shortfall:.0e} |
| split between STAY and FLIP, limit (22) | 1/2 each | 1/2 each, ties shared equally |
| split between STAY and FLIP, (21) | 1/2 each, "unique" | any: {least_split:.2f} to {largest_split:.2f} from 25 random starts at each of 3 temperatures |
| iterating (23)-(25) as written | "convergence is guaranteed" | a cycle of two below lambda = 1; damped, it converges |

![Clever random](clever_random.png)

Where the text differs, and why:

- **Not unique.** Half each is the only self-consistent policy of the limit (22), where ties are
  shared equally: STAY-STAY and FLIP-FLIP lead to it in one update, as the appendix says. With the
  prior p(a) of (21) every split is a fixed point, because an action that does not look at the state
  costs no information, and the prior keeps whatever split there is. All carry the same 1 bit.
- **Not guaranteed to converge.** All states rush to the next state that is rare at the moment,
  which makes the other one rare. At lambda = 0.3 the tenth policy carries {carried:.3f} bits, while the
  mix of new policy and old marginal that the iteration looks at reports {reported:.1f} bits, growing
  at every update, where a binary state holds 1. A small imbalance is multiplied by -1 / lambda: at
  0.9 nats the iteration as written cycles, at 1.1 it settles. Damped in log space with
  eta = lambda / (1 + lambda) it never goes down, for any world: in relative entropy the objective
  of one time step is concave with curvature at most 1 + lambda, and this is the mirror step that
  such a curvature allows.

Tables: [ends of the iteration](clever_random.csv), [the course of the iteration](clever_random_courses.csv).

## A reliable and an unreliable state

State 0 obeys STAY and FLIP; state 1 leads anywhere with one half, whatever the action. No reward.

| | the paper prints | here |
| --- | --- | --- |
| pi(STAY given 0), equations (23)-(25) | 1/2 at first, 3/4 "asymptotically" | 1/2, for ever |
| pi(STAY given 0), far-sighted | | 3/4 |
| p(X = 0), far-sighted | 2/3 | 2/3 |
| largest I({{X, A}}; X') | log2(3) - 1/3 = 5/4 bits | log2(3) - 1 = {limit_bits:.5f} bits |

| curiosity_discount | pi(STAY given 0) | p(X = 0) | bits |
| --- | --- | --- | --- |
{reliable_rows}

(lambda = 0.1 bit; 0.5 and 2 nats give the same digits, see the [table](reliable_unreliable.csv).)

![Reliable and unreliable state](reliable_unreliable.png)

Where the text differs, and why:

- **3/4 is not what (21) finds.** The appendix maximises the information of the stationary states
  over policies, and there 3/4 is right. But (21) asks what the next step is worth with the state
  distribution held fixed, and that is best at 1/2, whatever the distribution: once there, nothing
  moves. What the text has in mind needs an agent that sees where an action leads later.
  `curiosity_discount` is that: D accumulated through a value of its own, with 0 the equations of
  the paper and 1 the average information in the long run, whose maximum is 3/4.
- **Not 5/4 bits.** A binary next state carries at most 1 bit. The appendix's own formula,
  H(X') - p(X = 1), is log2(3) - 2/3 - 1/3 at p(X = 0) = 2/3.

## Return for information

The dual problem (10) in a random world of 8 states and 4 actions: the largest return for a given
I(A; X), with the optimal values and the states of a random walk. At 1/2 bit it is {value:.4f}, with
slope {temperature:.4f} per nat; the best constant action returns {constant:.4f} at 0 bits, the best
policy {free:.4f} at {free_rate:.3f} bits.
Boltzmann exploration, which prices entropy instead, pays more information for the same return.

![Rate and return](rate_return.png)

Table: [the curve](rate_return.csv).

## Samples

Mean error over six runs of a random walk in a random world of 6 states and 3 actions. Slopes in
log-log from 1000 samples on: visits {visits:.2f}, model {model:.2f}, curious policy {policy:.2f}, SARSA
{sarsa:.2f}, Q-learning {q_learning:.2f}. Frequencies fall with the root of the samples; temporal
differences, with steps n^-0.7, with a power of about -0.35 at best.

![Samples](samples.png)

Table: [errors](samples.csv).

## The deep agent's exam

`scripts/exam.py` puts the deep agent, without reward, to the two illustrations as environments with
one continuous action, and compares the policy it learns with the exact one: [exam.md](exam.md),
table [exam.csv](exam.csv). Its policy has two modes and its model two outcomes: one Gaussian can
neither be at both ends of the action box nor tell a coin from a wide uncertainty.

![What the deep agent does](exam.png)

## Neighbours

What the methods the paper names end with on the same worlds: predictive information of state and
action, of the state alone, and the reward per step. Learners live 5000 steps; the others know
the world. Lambda is 0.3.

![Neighbours](neighbours.png)

Prediction error leaves the reliable state, for the coin is never predicted, and in the first world
it stays with the coin-like actions. Predictive states, which leave the action out, do not tell the
clever random policy (nearly no bits of the state alone) from noise: there they settle on one
action. Information to go counts D as a price and, without a reward, shuns it. Epsilon-greedy takes
the bait at the near end of the chain, and optimism does not.

Table: [all of them](neighbours.csv).
"""  # noqa: E501, tables of the page


def page(clever: dict, reliable: list[tuple], dual: dict, slopes: dict) -> str:
    """The page that states each number beside what the paper prints."""
    lines = [
        f"| {discount:g} | {stay:.4f} | {share:.4f} | {bits:.4f} |"
        for _, discount, stay, share, bits in reliable
    ]
    numbers = {"reliable_rows": "\n".join(lines), "limit_bits": reliable[-1][-1]}
    return PAGE.format(**numbers, **clever, **dual, **slopes)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
