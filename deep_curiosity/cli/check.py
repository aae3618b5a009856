"""Check by experiment whether a bonus works on your environment, and profile what it observes."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import torch
import tyro

from deep_curiosity.arguments import read_arguments
from deep_curiosity.configuration import MOST_SEED, Group, setting
from deep_curiosity.integrations.check.experiments import check_integration
from deep_curiosity.integrations.check.profile import Profile, profile
from deep_curiosity.integrations.trainer import LearnerIntegration
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import make_environment, task_actions


@dataclass(frozen=True)
class Args(Group):
    """What to check."""

    env_id: Annotated[str, tyro.conf.Positional]
    """Task: one of ours, a gymnasium id, dm_control/DOMAIN-TASK-v0, or MODULE:TASK-v0."""
    env_kwargs: dict[str, bool | int | float | str | None] = setting({})
    """Keyword arguments of the environment, such as: action_cost 0.1"""
    frame_stack: int = setting(1, at_most=1_000)
    """Observations shown to the agent together, with the actions between them."""
    bonus: str = "curiosity"
    """Name of the bonus, as for training."""
    num_steps: int = setting(2_000, at_least=2)
    """Random steps from which the profile is made; as many are collected for the check."""
    num_updates: int = setting(200)
    """Updates of the agent before its bonus is looked at."""
    seed: int = setting(0, at_least=0, at_most=MOST_SEED)
    """Seeds environment, agent and random actions."""


def main(arguments: Sequence[str]) -> int:
    """Print the profile and the check; return whether a line of it failed."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity check")
    torch.set_num_threads(1)
    config = Config.of(
        env_id=args.env_id,
        env_kwargs=args.env_kwargs,
        frame_stack=args.frame_stack,
        bonus=args.bonus,
        hidden_dim=64,
        seed=args.seed,
    )
    agent = LearnerIntegration(config)  # first of all: it may refuse what is set
    environment = make_environment(config.environment)
    found = profile(environment, num_steps=args.num_steps, seed=args.seed)
    print(describe(found, task_actions(environment)))
    environment.close()
    report = check_integration(agent, num_steps=args.num_steps, seed=args.seed)
    print(report)
    for _ in range(args.num_updates):
        agent.learner.update()
    print(describe_bonus(agent))
    return int(not report.passed)


def describe(found: Profile, action_space: object) -> str:
    """The profile as text."""
    low, high = found.reward_range
    lines = [
        f"Actions: {action_space}, given in [-1, 1]",
        f"{len(found.observation)} steps, {found.num_episodes} episodes ended, "
        f"{found.num_not_finite} steps with NaN or infinity, rewards from {low:.4g} to {high:.4g}",
        "",
        table(found.features()),
    ]
    if any(row["note"] == "heavy tail" for row in found.features()):
        lines.append(
            "Heavy tails are cut by the default whitening, and blur the rest with "
            'whitening="moments": bound such features if they matter little.'
        )
    return "\n".join([*lines, ""])


def describe_bonus(agent: LearnerIntegration) -> str:
    """Metrics of the bonus after some updates."""
    metrics = {name: value.item() for name, value in agent.bonus.metrics().items()}
    lines = ["", *(f"{name:22} {value:.4g}" for name, value in metrics.items())]
    if "floor_share" in metrics:
        lines.append(
            f"The noise floor makes {metrics['floor_share']:.0%} of the predicted variance: the "
            "nearer to all of it, the more D tells where actions lead, not what is uncertain."
        )
    return "\n".join(lines)


def table(rows: Sequence[dict[str, str]]) -> str:
    """Rows under their columns."""
    columns = list(rows[0])
    cells = [columns, *([row[name] for name in columns] for row in rows)]
    widths = [max(len(line[number]) for line in cells) for number in range(len(columns))]
    return "\n".join(
        "  ".join(f"{cell:>{width}}" for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    )
