"""Puts the deep agent to the paper's two illustrations, without reward, and writes what it learns.

python scripts/exam.py
"""

import statistics
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
import tyro
from matplotlib.figure import Figure

from deep_curiosity.tabular.solvers import solve_stationary
from deep_curiosity.tabular.worlds import reliable_unreliable
from deep_curiosity.training import Settings
from deep_curiosity.training.environments import make_environment
from deep_curiosity.training.playback import load_agent
from deep_curiosity.training.config import EXACT
from deep_curiosity.experiments.grid import markdown_table, run_once, write_table

NUM_DRAWS = 20_000  # actions drawn in each state to know the policy by
EXTREME = 0.8  # in the agent's units of [-1, 1]: within 0.1 of an end of the paper's [0, 1]
CURIOUS = Settings(
    total_steps=8_000,
    hunger=0.0,
    yielding=False,
    policy_modes=2,
    outcomes=2,
    members=2,
    **EXACT | {"refresh_interval": 2},
    hidden_dim=64,
    temperature=0.03,
    temperature_control="constant",
    learning_rate=2e-3,
    model_learning_rate=3e-3,
    components=512,
    learning_starts=1_000,
    replay_capacity=4_000,
    evaluation_interval=8_000,
    evaluation_episodes=1,
    checkpoint_interval=8_000,
    log_interval=1_000,
)
CLEVER = replace(CURIOUS, env_id="CleverRandom", curiosity_discount=0.0)
SPLIT = replace(CLEVER, replay_capacity=20_000, learning_rate=3e-3, total_steps=10_000)
RELIABLE = replace(CURIOUS, env_id="ReliableUnreliable", prior="learned")
QUESTIONS = {
    "clever random, uniform prior": SPLIT,
    "clever random, learned prior": replace(CLEVER, prior="learned"),
    "reliable, one step": replace(RELIABLE, curiosity_discount=0.0),
    "reliable, far-sighted": replace(RELIABLE, curiosity_discount=0.97),
}
COLUMNS = ("world", "seed", "state", "near_0", "near_1", "extreme", "mean_action", "pi_stay")


@dataclass(frozen=True)
class Args:
    """How often to ask, and where to write."""

    seeds: int = 5
    """Agents for each question."""
    runs: Path = Path("runs/exam")
    """Folder for the runs; finished ones there are not run again."""
    out: Path = Path("docs/paper")
    """Folder for the table, the summary and the picture."""
    workers: int = 2
    """Processes at a time."""


def main(args: Args) -> None:
    """Train every agent, ask each for its policy, and write down the answers."""
    jobs = [
        replace(settings, seed=seed, out=args.runs / f"{question.replace(', ', '-')}-{seed}")
        for question, settings in QUESTIONS.items()
        for seed in range(args.seeds)
    ]
    with ProcessPoolExecutor(args.workers, mp_context=get_context("spawn")) as pool:
        actions = list(pool.map(learned_actions, jobs))
    questions = np.repeat(list(QUESTIONS), args.seeds)
    rows = [
        answer(question, settings.seed, state, drawn[state])
        for question, settings, drawn in zip(questions, jobs, actions, strict=True)
        for state in (0, 1)
    ]
    write_table(args.out / "exam.csv", COLUMNS, rows)
    (args.out / "exam.md").write_text(summary_of(rows))
    draw(args.out / "exam.png", questions, actions)
    print(summary_of(rows))


def learned_actions(settings: Settings) -> np.ndarray:
    """Actions of a trained agent in states 0 and 1, two rows, in the paper's [0, 1]."""
    run_once(settings)
    environment = make_environment(settings.env_id, history=settings.history)
    agent = load_agent(settings.out, settings, environment)
    torch.manual_seed(settings.seed)
    return np.stack(
        [
            0.5 * (1 + agent.act(torch.full((NUM_DRAWS, 1), state)).squeeze(-1).numpy())
            for state in (0.0, 1.0)
        ]
    )


def answer(question: str, seed: int, state: int, action: np.ndarray) -> dict[str, object]:
    """A row of the table: where the mass of the policy lies in one state."""
    margin = 0.5 * (1 - EXTREME)
    near_0, near_1 = float((action < margin).mean()), float((action > 1 - margin).mean())
    mean = float(action.mean())
    values = (question, seed, state, near_0, near_1, near_0 + near_1, mean, 1 - mean)
    return dict(zip(COLUMNS, values, strict=True))


def summary_of(rows: list[dict[str, object]]) -> str:
    """Markdown: what is asked, what the exact solution is, median and range over seeds."""
    far_sighted = solve_stationary(
        reliable_unreliable(),
        temperature=0.05,
        curiosity_discount=QUESTIONS["reliable, far-sighted"].curiosity_discount,
    )
    uniform, learned, one_step, far = QUESTIONS
    exact = float(far_sighted.policy[0, 0])
    header = ["question", "quantity", "exact", "deep agent: median [range]"]
    lines = [
        (uniform, "mass within 0.1 of 0 and 1", "1", spread(rows, uniform, "extreme")),
        (uniform, "mass near 0", "0.5", spread(rows, uniform, "near_0")),
        (uniform, "mass near 1", "0.5", spread(rows, uniform, "near_1")),
        (learned, "mass within 0.1 of 0 and 1", "1", spread(rows, learned, "extreme")),
        (one_step, "pi(STAY given 0)", "0.5", spread(rows, one_step, "pi_stay", [0])),
        (far, "pi(STAY given 0)", f"{exact:.3f}", spread(rows, far, "pi_stay", [0])),
    ]
    return markdown_table(header, lines) + "\n"


def spread(
    rows: list[dict[str, object]], question: str, column: str, states: list[int] | None = None
) -> str:
    """Median over seeds and the range, in each of the states."""
    shown = []
    for state in states or [0, 1]:
        own = [
            float(row[column]) for row in rows if (row["world"], row["state"]) == (question, state)
        ]
        shown.append(f"{statistics.median(own):.3f} [{min(own):.3f}, {max(own):.3f}]")
    if len(shown) == 1:
        return shown[0]
    return "; ".join(f"state {state}: {text}" for state, text in enumerate(shown))


def draw(path: Path, questions: np.ndarray, actions: list[np.ndarray]) -> None:
    """Share of actions in twenty bins, each seed a line, in each state of each question."""
    figure = Figure(figsize=(3.2 * len(QUESTIONS), 4.6), layout="constrained")
    grid = figure.subplots(2, len(QUESTIONS), sharex=True, sharey=True)
    edges = np.linspace(0, 1, 21)
    for column, question in enumerate(QUESTIONS):
        for state in (0, 1):
            axes = grid[state, column]
            for drawn in (a for q, a in zip(questions, actions, strict=True) if q == question):
                share = np.histogram(drawn[state], edges)[0] / NUM_DRAWS
                axes.stairs(share, edges, alpha=0.7)
            axes.set_title(f"{question}\nstate {state}" if state == 0 else "state 1", fontsize=9)
        axes.set_xlabel("action: probability to flip")
    for axes in grid[:, 0]:
        axes.set_ylabel("share of the policy")
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
