"""A run in progress: its parts, opened together, saved together, closed together."""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import torch
from torch import Tensor

from deep_curiosity import __version__
from deep_curiosity.training.checkpoint import load_checkpoint, save_checkpoint
from deep_curiosity.training.collector import Collector, VectorCollector, evaluate
from deep_curiosity.training.environments import (
    action_dim,
    make_environment,
    make_vector_environment,
    num_cells,
    observation_dim,
)
from deep_curiosity.training.run_log import RunLog, mean_return, success_rate
from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.learner import Learner
from deep_curiosity.speed.machine import prepare_machine
from deep_curiosity.training.log import (
    CONFIG,
    SUMMARY,
    Records,
    open_folder,
    read_settings,
    write_json,
)
from deep_curiosity.training.config import Settings

EVALUATION_SEED = 1_000_003  # apart from the seeds of training, the same in every run
RESUMABLE = ("out", "resume", "total_steps")  # settings that a resumed run may change


@dataclass
class Run:
    """The parts of a run."""

    settings: Settings
    evaluation_environment: gymnasium.Env
    learner: Learner
    collector: Collector | VectorCollector
    history: RunLog
    records: Records
    started: float
    """Reading of `time.perf_counter` at which the run would have begun, had it never paused."""

    @property
    def finished(self) -> bool:
        """Whether all steps are taken; with several worlds there may be some more."""
        return self.history.step >= self.settings.total_steps

    def reached(self, interval: int) -> bool:
        """Whether the newest steps, one of every world, have come to a multiple of an interval."""
        return self.history.step % interval < self.settings.num_envs

    @property
    def updates_due(self) -> int:
        """Updates that the newest steps, not yet counted as learned from, call for.

        All together are always the whole part of `update_to_data` times the steps, in exact
        fractions, so that nothing is lost or gained on the way or in a resumed run.
        """
        ratio = Fraction(str(self.settings.update_to_data))
        before = self.history.learning_steps
        return math.floor(ratio * (before + self.settings.num_envs)) - math.floor(ratio * before)

    def evaluate(self) -> None:
        """Run the deterministic policy for whole episodes."""
        episodes = evaluate(
            self.learner.act_deterministically,
            self.evaluation_environment,
            episodes=self.settings.evaluation_episodes,
            seed=EVALUATION_SEED,
        )
        self.history.evaluations.extend(episodes)
        self.records.scalars(self.history.step, self._latest_evaluation())

    def progress(self, metrics: dict[str, Tensor]) -> dict[str, float]:
        """Write down everything there is to tell at this step, and return it."""
        history = self.history
        values = {
            "episode/return_mean": _number(mean_return(history.episodes)),
            "episode/success_rate": _number(success_rate(history.episodes)),
            "time/steps_per_second": history.steps_per_second,
        }
        total_cells = num_cells(self.evaluation_environment)
        if total_cells is not None:
            values["episode/coverage"] = _number(history.coverage(total_cells))
        values |= {tag: value.item() for tag, value in metrics.items()}
        values |= {tag: value.item() for tag, value in self.learner.diagnostics().items()}
        self.records.scalars(history.step, values)
        values |= self._latest_evaluation()
        self.records.row(history.step, values)
        return values

    def _latest_evaluation(self) -> dict[str, float]:
        episodes = self.history.evaluations[-self.settings.evaluation_episodes :]
        return {
            "eval/return": _number(mean_return(episodes, num_recent=len(episodes))),
            "eval/success_rate": _number(success_rate(episodes)),
        }

    def save(self) -> None:
        """Write a checkpoint of all there is."""
        self.history.wall_seconds = time.perf_counter() - self.started
        state = {
            "learner": self.learner.state_dict(),
            "collector": self.collector.state_dict(),
            "history": self.history.state_dict(),
        }
        save_checkpoint(self.settings.out, state)

    def write_summary(self) -> dict[str, Any]:
        """Write the figures by which runs are compared."""
        settings = self.settings
        summary = {
            "env_id": settings.env_id,
            "seed": settings.seed,
            "bonus": settings.bonus,
            "prior": settings.prior,
            "total_steps": self.history.step,
            **self.history.summary(num_cells(self.evaluation_environment)),
            "peak_memory_megabytes": peak_memory_megabytes(),
            "versions": {
                "deep-curiosity": __version__,
                "torch": torch.__version__,
                "gymnasium": gymnasium.__version__,
                "mujoco": mujoco.__version__,
            },
        }
        write_json(settings.out / SUMMARY, summary)
        return summary


@contextmanager
def open_run(settings: Settings, sense: HungerFunction | None = None) -> Iterator[Run]:
    """Begin a run, or continue the one in `settings.resume`; close it however it ends.

    Args:
        settings: Of the run.
        sense: The caller's own sense of hunger.

    Raises:
        FileExistsError: If `out` already holds a run.
        FileNotFoundError: If there is no run to continue.
        ValueError: If the environment is not one the agent can take, or a run is to be merge_config
            with other settings than its own.
    """
    resuming = settings.resume is not None
    if settings.resume is not None:
        settings = merge_config(settings, read_settings(settings.resume))
    settings = replace(settings, matmul_precision=prepare_machine(settings))  # kept when resumed
    torch.manual_seed(settings.seed)
    evaluation_environment = make_environment(
        settings.env_id, settings.env_kwargs, history=settings.history
    )
    learner = Learner(
        settings,
        observation_dim(evaluation_environment),
        action_dim(evaluation_environment),
        sense,
    )
    collector = make_collector(settings)
    if resuming:
        history = _restore(settings.out, learner, collector)
        write_json(settings.out / CONFIG, asdict(settings))
    else:
        history = RunLog()
        open_folder(settings)
    records = Records(settings.out, start=history.step)
    run = Run(
        settings,
        evaluation_environment,
        learner,
        collector,
        history,
        records,
        started=time.perf_counter() - history.wall_seconds,
    )
    try:
        if not resuming:
            run.save()  # so that a run that fails at once can still be merge_config
        yield run
    finally:
        records.close()
        collector.environment.close()
        evaluation_environment.close()


def make_collector(settings: Settings) -> Collector | VectorCollector:
    """Collector of a run, with its environment."""
    task = settings.env_id, settings.env_kwargs
    if settings.num_envs == 1:
        return Collector(make_environment(*task, history=settings.history), settings.seed)
    environment = make_vector_environment(
        *task,
        num_envs=settings.num_envs,
        vectorization=settings.vectorization,
        history=settings.history,
    )
    return VectorCollector(environment, settings.seed)


def merge_config(asked: Settings, own: Settings) -> Settings:
    """Settings with which a run goes on: its own, but for `total_steps` where that is asked for.

    Raises:
        ValueError: If a setting is asked for that the run does not have.
    """
    default = Settings()
    for name in (field.name for field in fields(Settings) if field.name not in RESUMABLE):
        value = getattr(asked, name)
        if value not in (getattr(default, name), getattr(own, name)):
            raise ValueError(
                f"`{name}` must stay as the run in {own.out} has it, {getattr(own, name)!r}, "
                f"got {value!r}."
            )
    given = asked.total_steps != default.total_steps
    return replace(own, total_steps=asked.total_steps if given else own.total_steps)


def peak_memory_megabytes() -> float | None:
    """Largest resident memory of this process so far; `None` where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def _restore(folder: Path, learner: Learner, collector: Collector | VectorCollector) -> RunLog:
    state = load_checkpoint(folder)
    collector.load_state_dict(state["collector"])
    learner.load_state_dict(state["learner"])
    return RunLog.from_state(state["history"])


def _number(value: float | None) -> float:
    return math.nan if value is None else value
