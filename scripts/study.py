"""The studies behind the README: curiosity against plain soft actor-critic, seed by seed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tyro

from deep_curiosity.benchmark.tables import grouped
from deep_curiosity.training import Settings
from deep_curiosity.experiments.statistics import compare, draw_comparison
from deep_curiosity.training.log import read_progress
from deep_curiosity.training.config import EXACT
from deep_curiosity.experiments.grid import (
    Task,
    markdown_table,
    median_and_range,
    run_study,
    summarize,
)


@dataclass(frozen=True)
class Study:
    """Tasks, agents by the settings they change, and how many seeds of each."""

    tasks: list[Task]
    agents: dict[str, dict[str, Any]]
    seeds: int


def halved(task: Task, total_steps: int) -> Task:
    """The same task with an update at every second step only: many agents are to be compared."""
    settings = replace(
        task.settings, update_to_data=0.5, total_steps=total_steps, evaluation_interval=2_000
    )
    return replace(task, settings=settings)


SMALL = Settings(total_steps=16_000, hidden_dim=64, log_interval=1_000, evaluation_interval=1_000)
CURIOSITY = {"curiosity": {}}
PLAIN = {"plain SAC": {"bonus": "none"}}
SPARSE = [
    # 200 steps that pay at most 1 each: no return is above 200, and half of that is asked
    Task(
        "PendulumSwingup",
        replace(SMALL, env_id="PendulumSwingup", env_kwargs={"action_cost": 0.1}),
        solved_return=100.0,
    ),
    # half of the 203 that the tests' scripted walk along the shortest way earns
    Task(
        "PointMaze",
        replace(SMALL, env_id="PointMaze", total_steps=24_000),
        solved_return=101.5,
    ),
]
MOUNTAIN_CAR = Task(
    "MountainCarContinuous-v0",
    replace(SMALL, env_id="MountainCarContinuous-v0"),
    solved_return=90.0,
)
# half of what an episode of 100 steps pays at most, one a step near the target
REACHER = Task("ReacherSparse", replace(SMALL, env_id="ReacherSparse"), solved_return=50.0)
# every bonus centred, scaled and weighed alike: what is compared is what they reward
RIVALS = (
    "disagreement",
    "information-gain",
    "rnd",
    "icm",
    "nearest-neighbours",
    "hash-count",
)
UNDIRECTED = {"gSDE": "gsde", "pink noise": "pink", "Ornstein-Uhlenbeck": "ou"}
MANY_AGENTS = 5
CALIBRATION = {
    "held-out log-likelihood loss, nats": "curiosity/model_held_out_nll",
    "share within the 90 % interval": "curiosity/model_coverage_90",
}
STUDIES = {
    "sparse": Study(SPARSE, CURIOSITY | PLAIN, seeds=5),
    "control": Study(SPARSE, {"constant bonus": {"bonus": "constant"}}, seeds=1),
    "savings": Study(
        [halved(task, 16_000) for task in SPARSE],
        CURIOSITY
        | {
            "curiosity, eager": {"compile": "off"},
            "curiosity, renewed twice as often": {"refresh_interval": 10},
            "curiosity, nothing spared": EXACT,
            "curiosity, same time": {"update_to_data": 0.75},  # as the updates spared nothing take
        },
        seeds=12,
    ),
    "bonuses": Study(
        [halved(task, 16_000) for task in (*SPARSE, REACHER, MOUNTAIN_CAR)],
        CURIOSITY
        | {name: {"bonus": name} for name in RIVALS}
        | PLAIN
        | {name: {"bonus": "none", "exploration": key} for name, key in UNDIRECTED.items()},
        seeds=5,
    ),
    "mountain_car": Study([MOUNTAIN_CAR], CURIOSITY | PLAIN, seeds=5),
    "dense": Study(
        [
            Task(
                "HalfCheetah-v5",
                replace(SMALL, env_id="HalfCheetah-v5", hidden_dim=128),
                solved_return=1_000.0,
            )
        ],
        CURIOSITY
        | PLAIN
        | {
            "curiosity, fixed weight": {"yielding": False},
            "fixed weight, learned prior": {"yielding": False, "prior": "learned"},
        },
        seeds=3,
    ),
}


@dataclass(frozen=True)
class Args:
    """What to study, and where."""

    study: Literal["sparse", "control", "savings", "bonuses", "mountain_car", "dense"] = "sparse"
    """PendulumSwingup and PointMaze; the same with a constant for a bonus; the same without
    compiling, without part or all of what the default spares, and with the time that it spares
    spent on updates; all bonuses, and noises of the actions without one, on four tasks;
    MountainCarContinuous-v0; HalfCheetah-v5."""
    seeds: int | None = None
    """Seeds of each agent on each task; by default as many as the study is documented with."""
    runs: Path = Path("runs/study")
    """Folder for the runs; finished ones there are not run again."""
    out: Path = Path("docs/study")
    """Folder for table and picture."""
    workers: int = 2
    """Processes at a time."""


def main() -> None:
    """Run a study and print its table."""
    args = tyro.cli(Args, description=__doc__)
    study = STUDIES[args.study]
    runs, out = args.runs / args.study, args.out / args.study
    rows = run_study(
        study.tasks,
        study.agents,
        seeds=range(study.seeds if args.seeds is None else args.seeds),
        runs=runs,
        out=out,
        workers=args.workers,
    )
    summary = summarize(rows)
    if args.study == "savings":
        summary += f"\n{calibration(rows, runs)}"
        out.with_suffix(".md").write_text(summary)
    print(summary)
    if len(study.agents) > MANY_AGENTS:  # curves on top of each other tell little
        out.with_suffix(".md").write_text(compare(study.tasks, rows))
        draw_comparison(out.with_suffix(".png"), study.tasks, rows)


def calibration(rows: Sequence[dict[str, Any]], runs: Path) -> str:
    """Markdown table of how well the models predict what they never train on, at the end."""
    lines = []
    for key, own in grouped(rows, "task", "agent").items():
        task, agent = map(str, key)
        ends = [read_progress(runs / task / agent / f"seed{row['seed']}")[-1] for row in own]
        spreads = [
            median_and_range([float(end[tag]) for end in ends]) for tag in CALIBRATION.values()
        ]
        lines.append([task, agent, *spreads])
    return markdown_table(["task", "agent", *CALIBRATION], lines) + "\n"


if __name__ == "__main__":
    main()
