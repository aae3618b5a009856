"""Figures in the text of pages, each computed anew from the table that it is of."""

import functools
import math
import statistics

import numpy as np
import pytest

from deep_curiosity.benchmark.page import narrow_section
from deep_curiosity.benchmark.solved import summary_of
from deep_curiosity.benchmark.tables import grouped, median, rate_over, read_rows
from deep_curiosity.experiments.statistics import (
    bootstrap,
    interquartile_mean,
    probability_of_improvement,
)
from deep_curiosity.experiments.studies import development
from tests.docs.pages import ROOT, text_of

HORIZON = "docs/sweeps/horizon.csv"

rows_of = functools.cache(lambda path: read_rows(ROOT / path))


README = text_of("README.md")


def medians(path, key, column):
    """Median of a column for each value of another."""
    return {name: median(own, column) for (name,), own in grouped(rows_of(path), key).items()}


def interquartile_means(path, column):
    """Interquartile mean of a column for each task and agent."""
    return {
        key: float(interquartile_mean(np.array([row[column] for row in own])))
        for key, own in grouped(rows_of(path), "task", "agent").items()
    }


@functools.cache
def speeds(folder):
    """Of every runner, as the table has them: steps per second, and times those of SB3."""
    rows = rows_of(f"{folder}/agents.csv")
    times_sb3 = rate_over(rows, "Stable-Baselines3")
    return {
        name: (f"{median(own, 'steps_per_second'):.0f}", statistics.median(map(times_sb3, own)))
        for (name,), own in grouped(rows, "runner").items()
    }


RUNNERS = {
    "Stable-Baselines3's SAC, as its users run it": "Stable-Baselines3",
    "the same with the matrix precision of ours": "Stable-Baselines3, our precision",
    "plain agent (`--bonus none`)": "plain, compiled",
    "curious agent (five models, learned prior)": "curious, compiled",
    "plain agent, `--preset exact`": "plain, exact, compiled",
    "curious agent, `--preset exact`": "curious, exact, compiled",
}


@pytest.mark.parametrize("line", RUNNERS)
def test_the_table_of_speeds_is_that_of_the_benchmark(line):
    cells = []
    for folder in ("docs/benchmark", "docs/benchmark/zen4"):
        rate, times = speeds(folder)[RUNNERS[line]]
        cells.append(rate if times == 1 else f"{rate} ({times:.2f})")
    assert f"| {line} | {' | '.join(cells)} |" in README


def test_what_is_said_of_an_older_cpu_is_what_was_measured():
    folder = "docs/benchmark/zen4"
    (sbx,) = (name for name in speeds(folder) if name.startswith("SBX "))
    rate, times = speeds(folder)[sbx]
    assert f"| SBX's SAC, compiled by JAX | not measured | {rate} ({times:.2f}) |" in README
    over_sbx = rate_over(rows_of(f"{folder}/agents.csv"), sbx)
    plain = [row for row in rows_of(f"{folder}/agents.csv") if row["runner"] == "plain, compiled"]
    page = " ".join(text_of(f"{folder}/README.md").split())
    assert (
        f"The plain agent is {speeds(folder)['plain, compiled'][1]:.2f} times as fast as "
        f"Stable-Baselines3's and {statistics.median(map(over_sbx, plain)):.2f} times as fast"
    ) in page
    assert f"learn too, {speeds(folder)['curious, compiled'][1]:.2f} times as fast" in page
    rates = [
        statistics.median(row["gigaflop_per_second"] for row in rows if row["gigaflop_per_second"])
        for rows in (rows_of("docs/benchmark/agents.csv"), rows_of(f"{folder}/agents.csv"))
    ]
    assert f"slower by a factor of {rates[0] / rates[1]:.1f} than" in page


def test_narrow_networks_are_as_fast_as_was_measured():
    folder = "docs/benchmark/zen4"
    rows = rows_of(f"{folder}/narrow.csv")
    rates = medians(f"{folder}/narrow.csv", "runner", "steps_per_second")
    plain, curious = rates["plain, compiled"], rates["curious, compiled"]
    assert f"{plain:.0f} steps a second of the plain agent and {curious:.0f} of the" in README
    assert f"Stable-Baselines3's SAC takes {rates['Stable-Baselines3']:.0f} (" in README
    times_sb3 = rate_over(rows, "Stable-Baselines3")
    plain, curious = (
        statistics.median(times_sb3(row) for row in rows if row["runner"] == f"{name}, compiled")
        for name in ("plain", "curious")
    )
    page = text_of(f"{folder}/README.md")
    assert f"these are {plain:.2f} and {curious:.2f} times." in page
    assert narrow_section(ROOT / folder).strip() in (ROOT / folder / "README.md").read_text()


def over_floor(runner):
    rows = [row for row in rows_of("docs/benchmark/agents.csv") if row["runner"] == runner]
    return statistics.median(row["update_ms"] / row["floor_ms"] for row in rows)


def native_gain():
    """Least and greatest over tasks, of 64 environments in one call over one by one."""
    gains = [
        statistics.median(
            row["native_steps_per_second"] / row["sync_steps_per_second"] for row in own
        )
        for (_, number), own in grouped(
            rows_of("docs/benchmark/vector.csv"), "task", "num_envs"
        ).items()
        if number == 64
    ]
    return min(gains), max(gains)


def on_gpu(runner):
    return medians("docs/benchmark/cuda_agents.csv", "runner", "steps_per_second")[runner]


def gpu_update(where, batch_size):
    rows = rows_of("docs/benchmark/cuda_updates.csv")
    return median(
        [row for row in rows if (row["where"], row["batch_size"]) == (where, batch_size)],
        "update_ms",
    )


QUOTES = {
    "plain agent takes {:.1f} times what its matrix products alone would take there": lambda: [
        over_floor("plain, compiled")
    ],
    "one of the curious agent {:.2f} times": lambda: [over_floor("curious, compiled")],
    "vector environments of their own, for any agent, {:.1f} to {:.1f} times as fast": native_gain,
    "the plain agent took {:.0f} steps a second and the curious one {:.0f}, "
    "Stable-Baselines3's SAC {:.0f}": lambda: [
        on_gpu("plain, compiled, cuda"),
        on_gpu("curious, compiled, cuda"),
        on_gpu("Stable-Baselines3, cuda"),
    ],
    "takes {:.1f} ms there at a batch of 256, {:.1f} ms at 4 096": lambda: [
        gpu_update("GPU, compiled", 256),
        gpu_update("GPU, compiled", 4_096),
    ],
    "whatever their size ({:.0f} ms)": lambda: [gpu_update("GPU, eager", 256)],
}


@pytest.mark.parametrize("quote", QUOTES)
def test_a_figure_in_the_text_is_that_of_its_table(quote):
    assert quote.format(*QUOTES[quote]()) in README


def test_at_half_the_horizon_the_pendulum_is_never_swung_up():
    assert "at 0.5 [the pendulum is never swung up]" in README
    returns = [
        row["return"]
        for row in rows_of(HORIZON)
        if row["task"] == "PendulumSwingup" and row["curiosity discount"] == 0.5
    ]
    assert len(returns) >= 5 and max(returns) < 100


def test_what_is_said_of_a_thousand_kills_is_what_came_of_them():
    page = text_of("docs/reliability/README.md")
    rows = rows_of("docs/reliability/torture.csv")
    faults = ("corrupt_checkpoints", "failed_resumes", "wrong_rows", "unequal_chains")
    assert sum(row["kills"] for row in rows) >= 1_000 and len(rows) == 4
    assert not any(row[name] for row in rows for name in faults)
    assert f"every one of the {sum(row['chains'] for row in rows):.0f} chains" in page


def test_what_is_said_of_dense_tasks_is_what_was_measured():
    page = text_of("docs/development/README.md")
    rows = rows_of("docs/development/harm.csv")
    areas = interquartile_means("docs/development/harm.csv", "area")
    times = [
        areas[task, "curiosity"] / areas[task, "plain SAC"]
        for task in ("HalfCheetah-v5", "Hopper-v5")
    ]
    said = "the curious agent's is {:.2f} times the plain agent's, on Hopper-v5 {:.2f} times"
    assert said.format(*times) in page
    assert {row["seed"] for row in rows} == {100, 101, 102}


@pytest.mark.parametrize("table", ["harm-learned", "harm-default"])
def test_what_is_said_of_the_learned_prior_on_dense_tasks_is_what_was_measured(table):
    learned, uniform = (
        interquartile_means(f"docs/development/{name}.csv", "evaluation_return")
        for name in (table, "harm")
    )
    cheetah, hopper = (
        [
            f"{value:,.0f}".replace(",", " ")
            for value in (
                learned[task, "curiosity"],
                uniform[task, "curiosity"],
                uniform[task, "plain SAC"],
            )
        ]
        for task in ("HalfCheetah-v5", "Hopper-v5")
    )
    said = (
        "It ends at {} on HalfCheetah-v5, where the uniform prior ends at {} and the plain agent "
        "at {}, and at {} on Hopper-v5, where they end at {} and {}."
    )
    assert said.format(*cheetah, *hopper) in text_of("docs/development/README.md")
    assert {row["seed"] for row in rows_of(f"docs/development/{table}.csv")} == {100, 101, 102}


def test_what_is_said_of_areas_on_dense_tasks_is_what_was_measured():
    default, plain = (
        interquartile_means(f"docs/development/{name}.csv", "area")
        for name in ("harm-default", "harm")
    )
    areas = [default[task, "curiosity"] for task in ("HalfCheetah-v5", "Hopper-v5")]
    areas += [plain[task, "plain SAC"] for task in ("HalfCheetah-v5", "Hopper-v5")]
    said = (
        "over every evaluation, is {:.0f} and {:.0f}; the plain agent's, over every second one, "
    )
    assert (said + "{:.0f} and {:.0f}.").format(*areas) in text_of("docs/development/README.md")


def test_what_is_said_of_both_priors_is_what_was_measured():
    page = text_of("docs/development/README.md")
    tables = {
        "learned": ("development", "default"),
        "uniform": ("development", "uniform prior"),
        "shared": ("shared-prior", "default"),
        "one nat": ("one-nat", "default"),
    }
    rows, area = {}, {}
    for prior, (name, agent) in tables.items():
        path = f"docs/development/{name}.csv"
        rows[prior] = [row for row in rows_of(path) if row["agent"] == agent]
        means = interquartile_means(path, "area").items()
        area[prior] = {task: value for (task, own), value in means if own == agent}
    solved = {prior: f"{sum(row['solved'] for row in own):.0f}" for prior, own in rows.items()}
    assert {len(own) for own in rows.values()} == {40}
    assert (
        f"solves {solved['learned']} runs of 40 and the uniform one {solved['uniform']};" in page
    )
    assert f"it solved {solved['shared']} as well, and with [one nat]" in page
    assert f"(one-nat.csv)) {solved['one nat']};" in page
    compared = ("learned", "uniform", "shared")
    ranks = dict.fromkeys(compared, 0)
    for task in area["learned"]:
        for rank, prior in enumerate(sorted(compared, key=lambda prior: -area[prior][task]), 1):
            ranks[prior] += rank
    said = (
        "default sum to {learned}, those of the uniform prior to {uniform}, and those of the "
        "shared prior with 1.69 nats to {shared}."
    )
    assert said.format_map(ranks) in page
    larger = [task for task in area["learned"] if area["learned"][task] > area["uniform"][task]]
    assert f"and on {len(larger)} tasks of {len(area['learned'])};" in page
    assert set(area["learned"]) - set(larger) == {"MountainCarContinuous-v0"}
    groups = [
        [[row["area"] for row in rows[prior] if row["task"] == task] for task in area["learned"]]
        for prior in ("learned", "uniform")
    ]
    said = "the larger area with probability {:.2f}, with an interval from {:.2f} to {:.2f}"
    assert said.format(*probability_of_improvement(*groups)) in page
    goals = grouped(rows_of("docs/development/goals-shared-prior.csv"), "agent", "task").items()
    shared, uniform = (
        [[row["evaluation_return"] for row in own] for (name, _), own in goals if name == agent]
        for agent in ("curiosity", "uniform prior")
    )
    lower = probability_of_improvement(uniform, shared)
    assert f"were lower than the uniform prior's with probability {lower.value:.2f}," in page
    both = "is {} by area, in units of what counts as solved, where the uniform prior's is {}."
    assert both.format(*joint_areas("docs/development/development.md")) in page


def test_what_is_said_of_other_half_lives_is_what_was_measured():
    page = text_of("docs/development/README.md")
    default, of_4, of_30 = (
        interquartile_means(f"docs/development/{name}.csv", "area")
        for name in ("development", "half-life-4", "half-life-30")
    )
    areas = [
        f"{of_4[task, 'default']:.0f} instead of {default[task, 'default']:.0f} {where}"
        for task, where in (("PointMaze", "in the maze"), ("PendulumSwingup", "on the pendulum"))
    ]
    assert f"the area is smaller on both: {', '.join(areas)}. With" in page
    assert f"alone, it is {of_30['PointMaze', 'default']:.0f}. What" in page
    solved = []
    for name in ("half-life-4", "development"):
        rows = [
            row
            for row in rows_of(f"docs/development/{name}.csv")
            if (row["task"], row["agent"]) in of_4
        ]
        assert len(rows) == 16
        solved.append(f"{sum(row['solved'] for row in rows):.0f}")
    assert f"solved in {solved[0]} of 16 runs, in {solved[1]} by default" in page


def test_what_is_said_of_how_far_curiosity_looks_is_what_was_measured():
    page = text_of("docs/development/README.md")
    names = ("development", "curiosity-steps-8", "curiosity-discount-99")
    default, steps, discount = (f"docs/development/{name}.csv" for name in names)
    area = {path: interquartile_means(path, "area") for path in (default, steps, discount)}

    def solved(path, task):
        return sum(row["solved"] for row in rows_of(path) if row["task"] == task)

    pendulum, maze = ("PendulumSwingup", "default"), ("PointMaze", "default")
    assert (
        f"on the pendulum ({solved(steps, pendulum[0]):.0f} of 8 solved, area "
        f"{area[steps][pendulum]:.0f} instead of {area[default][pendulum]:.0f}) and not in the "
        f"maze ({solved(steps, maze[0]):.0f} of 8, {area[steps][maze]:.0f} instead of "
        f"{area[default][maze]:.0f})"
    ) in page
    assert solved(discount, maze[0]) == 8
    assert (
        f"solves all 8 mazes, at an area of {area[discount][maze]:.0f}, and only "
        f"{solved(discount, pendulum[0]):.0f} of 8 pendulums ({area[discount][pendulum]:.0f})"
    ) in page
    here, elsewhere = (
        statistics.median_low(
            row["solved_step"] or math.inf
            for row in rows_of(path)
            if (row["task"], row["agent"]) == key
        )
        for path, key in (
            (default, maze),
            ("docs/study/goals.csv", ("PointMaze, half the updates", "curiosity")),
        )
    )
    assert (here, elsewhere) == (6_000, 12_000)
    assert "at step 6 000 on these seeds, in the median, and at step 12 000 on the ten" in page


def joint_areas(path):
    """Area over all tasks of each agent, as a summary has it, with two digits."""
    table = (ROOT / path).read_text().split("| all tasks |")[1].split("\n\n")[0]
    return [f"{float(line.split('|')[4].split()[0]):.2f}" for line in table.splitlines()[2:]]


def test_what_is_said_of_the_sparse_cartpole_is_what_its_runs_returned():
    page = text_of("docs/development/README.md")
    rows = rows_of("docs/development/cartpole.csv")

    def returns(repeat, steps, changed="{}"):
        own = [row for row in rows if (row["action_repeat"], row["task_steps"]) == (repeat, steps)]
        return [f"{row['evaluation_return']:.0f}" for row in own if changed in row["changed"]]

    default = returns(1, 50_000)
    assert f"earns {default[0]} and {default[1]} after 50 000 steps" in page
    assert f"sums of ten steps ({returns(1, 25_000, 'reward_steps')[0]} after 25 000)" in page
    (held,) = returns(8, 50_000)
    twice = returns(8, 100_000)
    assert (
        f"{held} after as many steps of the task on one seed, and {twice[0]} and {twice[1]}"
        in page
    )


def test_what_is_said_of_the_noisy_room_is_what_was_measured():
    page = text_of("docs/sweeps/README.md")
    figures = []
    for name in ("noise-curiosity", "noise-uniform"):
        rows = rows_of(f"docs/sweeps/{name}.csv")
        assert len(rows) == 10
        figures += [
            f"{interquartile_mean(np.array([row[column] for row in rows])):.2f}"
            for column in ("noisy_time", "early_coverage", "late_coverage")
        ]
    said = (
        "{} times a uniform walk's time beside the noise, with {} of the cells visited early and "
        "{} late."
    )
    assert said.format(*figures[:3]) in page
    assert "these are {}, {} and {}.".format(*figures[3:]) in page
    answers = text_of("docs/faq.md")
    assert f"[{figures[0]} times](sweeps/README.md" in answers
    older = medians("docs/sweeps/noise.csv", "bonus", "noisy_time")
    said = (
        "forgot nothing, {curiosity:.2f} times, and `icm` and `rnd` then {icm:.1f} and {rnd:.1f}"
    )
    assert said.format_map(older) in answers


def test_what_is_said_of_all_bonuses_is_what_their_runs_came_to():
    page = text_of("docs/study/README.md")
    solved = {
        agent: f"{sum(row['solved'] for row in own):.0f} of {len(own)}"
        for (agent,), own in grouped(rows_of("docs/study/bonuses.csv"), "agent").items()
    }
    shared = {solved[name] for name in ("curiosity", "information-gain", "rnd")}
    assert f"*Disagreement* solves {solved['disagreement']} runs, curiosity" in page
    assert (
        f"*rnd* {shared.pop()} each, *nearest-neighbours* {solved['nearest-neighbours']}," in page
    )
    assert not shared and solved["plain SAC"] == "0 of 6"


def test_what_is_said_of_the_second_illustration_is_what_was_measured():
    page = text_of("docs/study/README.md")
    stays = {
        agent: [f"{row['pi_stay']:.2f}" for row in own]
        for (agent,), own in grouped(rows_of("docs/study/reliable.csv"), "agent").items()
    }
    assert f"stays with probability {' and '.join(stays['far-sighted'])}, where 0.74" in page
    assert f"one step ahead {' and '.join(stays['one step'])}, where 0.5 is" in page


def test_what_is_said_of_the_goals_is_what_was_measured():
    page = text_of("docs/study/README.md")
    rows = rows_of("docs/study/goals.csv")
    agents = ("curiosity", "uniform prior")
    solved = [sum(row["solved"] for row in rows if row["agent"] == agent) for agent in agents]
    assert [row["agent"] for row in rows].count("curiosity") == len(rows) // 2 == 60
    said = "The default solves {:.0f} runs of 60, and the uniform prior {:.0f}:"
    assert said.format(*solved) in page
    groups = [
        [
            [row["evaluation_return"] for row in own]
            for (name, _), own in grouped(rows, "agent", "task").items()
            if name == agent
        ]
        for agent in agents
    ]
    said = "return being the larger with probability {:.2f} (an interval from {:.2f} to {:.2f})"
    assert said.format(*probability_of_improvement(*groups)) in page
    first = {
        key: np.median([row["first_success_step"] or math.inf for row in own])
        for key, own in grouped(rows, "task", "agent").items()
    }
    sooner = {task for task, _ in first if first[task, agents[0]] < first[task, agents[1]]}
    assert {"CartpoleSwingup", "PendulumSwingup, full updates"} <= sooner
    assert sooner.isdisjoint({"PointMaze, half the updates", "PointMaze, ends at goal"})


def test_a_constant_bonus_earns_nothing():
    assert "Neither run earns anything" in text_of("docs/study/README.md")
    sparse = rows_of("docs/study/sparse.csv")
    ours = [
        row for row in sparse if (row["task"], row["agent"]) == ("PendulumSwingup", "curiosity")
    ]
    assert [row["solved"] for row in ours] == [1] * 10
    assert "where curiosity solves ten of ten" in text_of("docs/study/README.md")
    rows = rows_of("docs/study/control.csv")
    assert len(rows) == 2 and all(abs(row["evaluation_return"]) < 0.1 for row in rows)


OTHER_UNITS = {
    "MountainCarContinuous-v0": "the mountain car",
    "dm_control point_mass-easy": "the point mass",
    "dm_control finger-spin": "the finger",
    "dm_control cartpole-balance_sparse": "the pole",
}


RAW = "raw observations"
UNITS = ("-deviations", "-from-1", "-from-third", "-kept", "-unshifted")
"""Other ways that were tried, each the default of its commit."""


def test_what_is_said_of_units_is_what_was_measured():
    page = text_of("docs/development/README.md")
    own, *others = (
        interquartile_means(f"docs/development/units{name}.csv", "area") for name in ("", *UNITS)
    )
    for task, called in OTHER_UNITS.items():
        figures = [
            own[task, RAW],
            own[task, "default"],
            *(other[task, "default"] for other in others),
        ]
        cells = " | ".join(f"{figure:.0f}" for figure in figures)
        assert f"| {called} | {cells} |" in page


def paired(table, task):
    """Interval of how much larger the area of the default is, paired by seed."""
    areas = {
        (row["agent"], row["seed"]): row["area"]
        for row in rows_of(f"docs/development/units{table}.csv")
        if row["task"] == task
    }
    seeds = sorted({seed for _, seed in areas})
    found = bootstrap([[areas["default", seed] - areas[RAW, seed] for seed in seeds]])
    return f"[{found.low:.0f}, {found.high:.0f}]"


def test_what_is_said_of_differences_in_other_units_is_what_was_measured():
    page = text_of("docs/development/README.md")
    car, point, finger, pole = OTHER_UNITS
    said = "is {} on the finger, {} on the pole and {} on the point mass, so they count as equal"
    assert said.format(*(paired("", task) for task in (finger, pole, point))) in page
    said = (
        "say the same: {} on the mountain car, {} on the point mass, where the default solves {} "
    )
    solved = [
        solved_runs("docs/development/units-eight.csv", agent)[point] for agent in ("default", RAW)
    ]
    said += "of 8 and raw observations {}."
    figures = [paired("-eight", car), paired("-eight", point), *(f"{runs:.0f}" for runs in solved)]
    assert said.format(*figures) in page


def test_what_is_said_of_harm_by_other_units_is_what_was_measured():
    areas = [
        np.mean(
            [row["area"] for row in rows_of(f"docs/development/harm-{name}.csv") if is_of(row)]
        )
        for name, is_of in (
            ("units", lambda row: True),
            ("default", lambda row: row["task"] == "Hopper-v5" and row["seed"] < 102),
        )
    ]
    said = "gives an area of {:.0f}, raw observations {:.0f} on the same two seeds."
    assert said.format(*areas) in text_of("docs/development/README.md")


def test_what_is_said_of_the_greedy_share_is_what_was_measured():
    page = text_of("docs/development/README.md")
    table = "docs/development/greedy-share.csv"
    steady = "steady greedy share"
    solved = [sum(solved_runs(table, agent).values()) for agent in ("default", steady)]
    assert solved == [16, 16] and "16 runs of 20 by either" in page
    own = grouped(rows_of(table), "task", "agent")
    intervals = [
        bootstrap([np.subtract(*([row["area"] for row in own[task, agent]] for agent in pair))])
        for pair in [("default", steady)]
        for task in dict.fromkeys(task for task, _ in own)
    ]
    said = (
        "[{:.2f}, {:.2f}] on the mountain car, [{:.2f}, {:.1f}] on the pendulum, [{:.2f}, {:.0f}] "
        "in the maze, [{:.0f}, {:.0f}] in the one that ends and [{:.1f}, {:.0f}] on Cartpole"
    )
    assert said.format(*(end for found in intervals for end in found[1:])) in page


def test_what_is_said_of_greed_where_reward_is_dense_is_what_was_measured():
    page = text_of("docs/development/README.md")
    tasks = "HalfCheetah-v5", "Hopper-v5"
    mean = {
        key: np.mean([row["area"] for row in own])
        for key, own in grouped(
            rows_of("docs/development/harm-greedy-share.csv"), "task", "agent"
        ).items()
    }
    steady = [
        np.mean(
            [
                row["area"]
                for row in rows_of(f"docs/development/harm-{name}.csv")
                if row["task"] == task and row["seed"] < 102
            ]
        )
        for task, name in zip(tasks, ("default", "units"), strict=True)
    ]
    areas = [mean[task, "curiosity"] for task in tasks]
    times = [mean[task, "curiosity"] / mean[task, "plain SAC"] for task in tasks]
    said = "its area is {:.0f} on HalfCheetah-v5 and {:.0f} on Hopper-v5, that of the steady "
    assert (said + "share {:.0f} and {:.0f} on").format(*areas, *steady) in page
    said = "it is {:.2f} times its area on HalfCheetah-v5 and {:.2f} times on Hopper-v5"
    assert said.format(*times) in page


def test_what_is_said_of_a_share_of_variances_is_what_was_measured():
    area = {
        (row["agent"], row["seed"]): f"{row['area']:,.0f}".replace(",", " ")
        for row in rows_of("docs/development/greedy-variance.csv")
        if row["task"] == "HalfCheetah-v5"
    }
    square, default = "one less its square", "one less the ratio"
    assert (
        f"has areas of {area[square, 100]} and {area[square, 101]} on the first two seeds of "
        f"HalfCheetah-v5, where the default has {area[default, 100]} and {area[default, 101]} and "
        f"the plain agent {area['plain SAC', 100]} and {area['plain SAC', 101]}; but on the next "
        f"two the default has {area[default, 102]} and {area[default, 103]}"
    ) in text_of("docs/development/README.md")


def test_what_is_said_of_layer_normalisation_is_what_was_measured():
    rows = rows_of("docs/development/layer-norm.csv")
    area = {
        (task, agent): {row["seed"]: row["area"] for row in own}
        for (task, agent), own in grouped(rows, "task", "agent").items()
    }
    page = text_of("docs/development/README.md")
    seeds = range(100, 108)
    every, default = (
        np.array([area["PointMaze", agent][seed] for seed in seeds])
        for agent in ("all critics", "default")
    )
    found = bootstrap([every - default])
    assert (
        f"area in the maze is {interquartile_mean(every):.0f} on eight seeds, the default's "
        f"{interquartile_mean(default):.0f}, and the 95 % interval of the difference, paired by "
        f"seed, is [{found.low:.0f}, {found.high:.0f}]"
    ) in page
    own, all_critics, of_reward = (
        f"{area['HalfCheetah-v5', agent][100]:.0f}"
        for agent in ("default", "all critics", "critics of reward")
    )
    assert (
        f"seed 100, the default's area is {own}, that of all critics {all_critics} and that of "
        f"the critics of reward {of_reward}."
    ) in page
    mean = {key: f"{np.mean(list(own.values())):.0f}" for key, own in area.items()}
    cheetah, hopper = (
        (mean[task, "critics of reward"], mean[task, "default"])
        for task in ("HalfCheetah-v5", "Hopper-v5")
    )
    assert (
        f"over three seeds of HalfCheetah-v5 the critics of reward have a mean area of "
        f"{cheetah[0]}, the default over eight {cheetah[1]}; but over four seeds of Hopper-v5 "
        f"they have {hopper[0]}, where the default has {hopper[1]}."
    ) in page
    slow = grouped(rows_of("docs/development/learning-rate.csv"), "task", "agent")
    slow_area = np.mean([row["area"] for row in slow["HalfCheetah-v5", "rate by width"]])
    assert f"over four seeds of HalfCheetah-v5 its mean area is {slow_area:.0f}." in page


def test_what_is_said_of_the_width_of_kernels_is_what_was_measured():
    area = {
        task: {(row["agent"], row["seed"]): row["area"] for row in own}
        for (task,), own in grouped(rows_of("docs/development/bandwidth.csv"), "task").items()
    }
    page = text_of("docs/development/README.md")
    for task in ("PointMaze", "PointMaze, ends at goal"):
        for seed in (100, 101):
            assert area[task]["overlap", seed] == area[task]["silverman", seed]
    cheetah, seeds, both = area["HalfCheetah-v5"], range(100, 108), ("overlap", "silverman")
    wide, narrow = (np.array([cheetah[kernels, seed] for seed in seeds]) for kernels in both)
    found = bootstrap([wide - narrow])
    assert (
        f"are {interquartile_mean(wide):.0f} with kernels that overlap and "
        f"{interquartile_mean(narrow):.0f} with Silverman's; it is the larger on "
        f"{(wide > narrow).sum()} seeds of {len(seeds)}, and the 95 % interval of the difference, "
        f"paired by seed, is [{found.low:.0f}, {found.high:.0f}]."
    ) in page
    pole = area["CartpoleSwingup"]
    one, other = (f"{pole[kernels, 100]:.2f} and {pole[kernels, 101]:.2f}" for kernels in both)
    assert f"are {one} with the one, {other} with the other" in page
    assert f"mean area is {wide.mean():.0f} and the default's {narrow.mean():.0f}" in text_of(
        "docs/development/protocol.md"
    )


def solved_runs(path, agent="default"):
    """Of each task of a table: how many runs of an agent end solved."""
    return {
        task: sum(row["solved"] for row in own)
        for (task, its), own in grouped(rows_of(path), "task", "agent").items()
        if its == agent
    }


def test_what_is_said_of_another_bonus_is_what_was_measured():
    page = text_of("docs/development/README.md")
    tasks = "CartpoleSwingup", "PendulumSwingup", "PointMaze"
    gain = solved_runs("docs/development/information-gain.csv")
    default = solved_runs("docs/development/development.csv")
    said = (
        "{:.0f} runs of 8 on CartpoleSwingup, {:.0f} on PendulumSwingup and {:.0f} in the maze, "
    )
    said += "where the default of the table above solves {:.0f}, {:.0f} and {:.0f} ("
    assert said.format(*(each[task] for each in (gain, default) for task in tasks)) in page
    today = solved_runs("docs/development/cartpole-swingup.csv")["CartpoleSwingup"]
    areas = [
        interquartile_means(f"docs/development/{name}.csv", "area")["CartpoleSwingup", "default"]
        for name in ("cartpole-swingup", "development")
    ]
    said = "CartpoleSwingup in {:.0f} runs of 8, at an area of {:.0f} in the place of {:.0f} ("
    assert said.format(today, *areas) in page


def draw_shares(rows):
    """Of each task: the largest share of D's variance that is which states were drawn."""
    shares = {}
    for row in rows:
        shares[row["task"]] = max(shares.get(row["task"], 0.0), row["draw_share"])
    return shares


WITHOUT = {
    "256 components": "thousands of components (256)",
    "nothing forgotten": "forgetting",
    "moments": "saturating units (moments)",
    "no greedy policy": "the greedy policy",
    "one step ahead": "three steps (one)",
    "uniform prior": "the learned prior (uniform)",
}


@pytest.mark.parametrize("agent", WITHOUT)
def test_what_is_said_of_each_part_of_the_default_is_what_was_measured(agent):
    path = "docs/development/ablation.csv"
    own = grouped(rows_of(path), "task", "agent")
    differences = [
        np.subtract(
            *([row["area"] for row in own[task.name, name]] for name in ("default", agent))
        )
        / task.solved_return
        for task in development.STUDIES["ablation"].tasks
    ]
    estimates = [*(bootstrap([one]) for one in differences), bootstrap(differences)]
    cells = [f"{each.value:.2f} [{each.low:.2f}, {each.high:.2f}]" for each in estimates]
    solved = f"{sum(solved_runs(path, agent).values()):.0f} of 24"
    page = text_of("docs/development/README.md")
    assert " | ".join(["", WITHOUT[agent], *cells, solved, ""]).strip() in page
    by_default = sum(solved_runs(path, "default").values())
    assert f"The default solves {by_default:.0f} runs of 24." in page
    names = "default", "nothing forgotten", "moments", "no greedy policy", "uniform prior"
    in_maze = (solved_runs(path, name)["PointMaze"] for name in names)
    assert "solves {:.0f} of 8, and without them {:.0f}, {:.0f}, {:.0f} and {:.0f}".format(
        *in_maze
    ) in " ".join(page.split())


def test_what_is_said_of_few_components_is_what_was_measured():
    shares = draw_shares(rows_of("docs/development/standardization-256.csv"))
    tasks = "PendulumSwingup", "PointMaze", "ReacherSparse"
    said = "at most {:.2f} on {}, {:.2f} on {} and {:.2f} on {}"
    page = text_of("docs/development/README.md")
    assert said.format(*(part for task in tasks for part in (shares[task], task))) in page
    rows = rows_of("docs/development/standardization.csv")
    many = draw_shares([row for row in rows if row["bonus"] == "default"])
    times = [round(shares[task] / many[task]) for task in tasks]
    assert (min(times), max(times)) == (2, 5) and "two to five times what it is" in " ".join(
        page.split()
    )


def test_what_is_said_of_the_standardised_bonuses_is_what_was_measured():
    rows = read_rows(ROOT / "docs/development/standardization.csv")
    by_bonus = {bonus: own for (bonus,), own in grouped(rows, "bonus").items()}
    default = by_bonus.pop("default")
    means = [abs(row["bonus_mean"]) for row in default]
    stds = [row["bonus_std"] for row in default]
    text = text_of("docs/development/README.md")
    assert (
        f"The default's mean lies within 0.1 of zero in {sum(mean <= 0.1 for mean in means)} of "
        f"{len(means)} rows and within {max(means):.2f} in all, its standard deviation between "
        f"{min(stds):.2f} and {max(stds):.2f}."
    ) in text
    furthest = {
        bonus: max(abs(row["bonus_mean"]) for row in own) for bonus, own in by_bonus.items()
    }
    spread = [row["bonus_std"] for own in by_bonus.values() for row in own]
    listed = ", ".join(f"{bonus} {value:.2f}" for bonus, value in furthest.items())
    assert f"furthest from zero: {listed}." in text
    assert f"Theirs is between {min(spread):.2f} and {max(spread):.2f}." in text
    ordered = sorted(draw_shares(default).items(), key=lambda pair: pair[1])
    listed = ", ".join(f"{share:.2f} on {task}" for task, share in ordered)
    assert f"at most {listed}" in text
    wide = draw_shares(read_rows(ROOT / "docs/development/standardization-overlap.csv"))
    *first, last = (f"{wide[task]:.2f} on {task}" for task in sorted(wide, key=wide.get)[-3:])
    assert f"it is at most {', '.join(first)} and {last}" in text


def test_times_to_solved_are_those_of_the_table():
    rows = [
        row | {"seconds": row["seconds"] if row["seconds"] != "" else math.inf}
        for row in rows_of("docs/benchmark/solved.csv")
    ]
    seconds = {
        key: median(own, "seconds") for key, own in grouped(rows, "task", "checkout").items()
    }
    solved = {
        key: sum(math.isfinite(row["seconds"]) for row in own)
        for key, own in grouped(rows, "task", "checkout").items()
    }
    tasks = "MountainCarContinuous-v0", "PointMaze", "PendulumSwingup"
    car, maze, pendulum = (seconds[task, "default"] for task in tasks)
    said = (
        f"{car:.0f} s on {tasks[0]}, {maze:.0f} s on {tasks[1]} and {pendulum:.0f} s on {tasks[2]}"
    )
    assert said in README
    total = sum(solved[task, "default"] for task in tasks)
    assert f"all {total} runs get there" in README and total == len(rows) / 2
    page = text_of("docs/study/README.md")
    of_maze = solved["PointMaze", "default"], solved["PointMaze", "before"]
    for sentence in (
        f"after {maze:.0f} s, where it took {seconds['PointMaze', 'before']:.0f} s",
        "in {} runs of 10 instead of {}".format(*of_maze),
        f"after {car:.0f} s, where it took {seconds[tasks[0], 'before']:.0f} s",
        f"than it did, {pendulum:.0f} s in the place of {seconds[tasks[2], 'before']:.0f} s",
    ):
        assert sentence in page
    steps = {
        name: median([row for row in own if row["task"] == tasks[2]], "step")
        for (name,), own in grouped(rows, "checkout").items()
    }
    said = f"with {steps['default']:,.0f} steps in the place of {steps['before']:,.0f}"
    assert said.replace(",", " ") in page
    commits = {str(row["checkout"]): str(row["commit"])[:7] for row in rows}
    assert f"`{commits['default']}`) beside that of `{commits['before']}`" in page
    summary = (ROOT / "docs/benchmark/solved.md").read_text()
    assert summary == summary_of(rows_of("docs/benchmark/solved.csv")) + "\n"


def test_public_agents_stand_beside_the_default_as_their_table_and_ours_have_them():
    page = text_of("docs/results/README.md")
    for row in rows_of("docs/results/public.csv"):
        steps = f"{row['environment_steps']:,.0f}".replace(",", " ")
        said = f"{row['mean']:.0f} ± {row['std']:.0f} | {row['seeds']:.0f} |"
        assert f"| {row['agent']} | {steps} | {said}" in page
    pendulum, cart = "dm_control/pendulum-swingup-v0", "dm_control/cartpole-swingup_sparse-v0"
    ours = {
        pendulum: [
            row["evaluation_return"]
            for row in rows_of("docs/results/results.csv")
            if row["task"] == pendulum and row["agent"] == "curiosity"
        ],
        cart: [row["evaluation_return"] for row in rows_of("docs/results/cartpole_sparse.csv")],
    }
    for task, steps in ((pendulum, "20 000"), (cart, "50 000")):
        said = f"{statistics.mean(ours[task]):.0f} ± {statistics.stdev(ours[task]):.0f} | 10 |"
        assert f"| {task} | **the default** | {steps} | {said}" in page
    assert sum(value >= 500 for value in ours[pendulum]) == 7 and max(ours[cart]) < 500
    mean = interquartile_mean(np.array(ours[cart]))
    assert f"interquartile mean is {float(mean):.0f}." in page
