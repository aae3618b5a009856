"""A run in progress: its parts, opened together, saved together, closed together."""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import torch
from torch import Tensor

from deep_curiosity import __version__
from deep_curiosity.speed.machine import fitted_machine
from deep_curiosity.speed.precision import matmul_error
from deep_curiosity.training.checkpoint import load_checkpoint, save_checkpoint
from deep_curiosity.training.collector import Collector, evaluate
from deep_curiosity.training.config import IGNORED, Config
from deep_curiosity.training.environments import (
    action_dim,
    make_environment,
    make_vector_environment,
    num_cells,
    observation_dim,
)
from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.learner import Learner, compiles
from deep_curiosity.training.log import (
    CONFIG,
    SUMMARY,
    Log,
    open_folder,
    read_config,
    write_json,
)
from deep_curiosity.training.run_log import RunLog, mean_return, success_rate
from deep_curiosity.training.source import source_commit

EVALUATION_SEED = 1_000_003  # apart from the seeds of training, the same in every run


@dataclass
class Run:
    """The parts of a run."""

    config: Config
    evaluation_environment: gymnasium.Env
    learner: Learner
    collector: Collector
    run_log: RunLog
    log: Log
    started: float
    """Reading of `time.perf_counter` at which the run would have begun, had it never paused."""

    @property
    def finished(self) -> bool:
        """Whether all steps are taken; with several environments there may be some more."""
        return self.run_log.step >= self.config.run.total_steps

    def reached(self, interval: int) -> bool:
        """Whether the newest steps, one of every environment, reach a multiple of an interval."""
        return self.run_log.step % interval < self.config.environment.num_envs

    @property
    def updates_due(self) -> int:
        """Updates that the newest steps, not yet counted as learned from, call for.

        All together are always the whole part of `update_to_data` times the steps, in exact
        fractions, so that nothing is lost or gained on the way or in a resumed run.
        """
        ratio = Fraction(str(self.config.run.update_to_data))
        before = self.run_log.learning_steps
        return math.floor(ratio * (before + self.config.environment.num_envs)) - math.floor(
            ratio * before
        )

    def evaluate(self) -> dict[str, float]:
        """Run the deterministic policy for whole episodes; what is logged of them."""
        episodes = evaluate(
            self.learner.evaluation_policy,
            self.evaluation_environment,
            episodes=self.config.run.evaluation_episodes,
            seed=EVALUATION_SEED,
        )
        self.run_log.evaluations.extend(episodes)
        values = self._latest_evaluation()
        self.log.scalars(self.run_log.step, values)
        return values

    def progress(self, metrics: dict[str, Tensor]) -> dict[str, float]:
        """Write down everything there is to tell at this step, and return it."""
        run_log = self.run_log
        values = {
            "episode/return_mean": _number(mean_return(run_log.episodes)),
            "episode/success_rate": _number(success_rate(run_log.episodes)),
            "time/steps_per_second": run_log.steps_per_second,
        }
        total_cells = num_cells(self.evaluation_environment)
        if total_cells is not None:
            values["episode/coverage"] = _number(run_log.coverage(total_cells))
        values |= {tag: value.item() for tag, value in metrics.items()}
        values |= {tag: value.item() for tag, value in self.learner.diagnostics().items()}
        self.log.scalars(run_log.step, values)
        values |= self._latest_evaluation()
        self.log.row(run_log.step, values)
        return values

    def _latest_evaluation(self) -> dict[str, float]:
        episodes = self.run_log.evaluations[-self.config.run.evaluation_episodes :]
        return {
            "eval/return": _number(mean_return(episodes, num_recent=len(episodes))),
            "eval/success_rate": _number(success_rate(episodes)),
        }

    def save(self) -> None:
        """Write a checkpoint of all there is."""
        self.run_log.wall_seconds = time.perf_counter() - self.started
        state = {
            "learner": self.learner.state_dict(),
            "collector": self.collector.state_dict(),
            "run_log": self.run_log.state_dict(),
        }
        save_checkpoint(self.config.run.out, state)

    def write_summary(self) -> dict[str, Any]:
        """Write the figures by which runs are compared."""
        config = self.config
        summary = {
            "env_id": config.environment.env_id,
            "seed": config.run.seed,
            "bonus": config.bonus.kind,
            "prior": config.agent.prior,
            "total_steps": self.run_log.step,
            **self.run_log.summary(num_cells(self.evaluation_environment)),
            "peak_memory_megabytes": peak_memory_megabytes(),
            "versions": {
                "deep-curiosity": __version__,
                "commit": source_commit(),
                "torch": torch.__version__,
                "gymnasium": gymnasium.__version__,
                "mujoco": mujoco.__version__,
            },
        }
        write_json(config.run.out / SUMMARY, summary)
        return summary


@contextmanager
def open_run(
    config: Config, *, resume: bool = False, hunger: HungerFunction | None = None
) -> Iterator[Run]:
    """Begin a run, or continue the one in its folder; close it however it ends.

    Args:
        config: Settings of the run.
        resume: Continue.
        hunger: The caller's own function of observation and info.

    Raises:
        FileExistsError: If `out` already holds a run that is not to be continued.
        FileNotFoundError: If there is no run to continue.
        ValueError: If the environment is not one the agent can take, or a run is to be continued
            with other settings than its own.
    """
    if resume:
        config = merge_config(config, read_config(config.run.out))
    with ExitStack() as stack:
        precision = stack.enter_context(fitted_machine(config.speed))
        speed = replace(config.speed, matmul_precision=precision)  # kept when resumed
        config = replace(config, speed=speed)
        _print_machine(config)
        torch.manual_seed(config.run.seed)
        evaluation_environment = make_environment(config.environment)
        stack.callback(evaluation_environment.close)
        sizes = observation_dim(evaluation_environment), action_dim(evaluation_environment)
        learner = Learner(config, *sizes, hunger)
        collector = make_collector(config)
        stack.callback(collector.environment.close)
        if resume:
            run_log = _restore(config.run.out, learner, collector)
            write_json(config.run.out / CONFIG, config.to_json())
        else:
            run_log = RunLog()
            open_folder(config)
        log = Log(config.run.out, start=run_log.step)
        stack.callback(log.close)
        started = time.perf_counter() - run_log.wall_seconds
        run = Run(config, evaluation_environment, learner, collector, run_log, log, started)
        if not resume:
            run.save()  # so that a run that fails at once can still be continued
        yield run


def make_collector(config: Config) -> Collector:
    """Collector of a run, with its environment."""
    make = make_environment if config.environment.num_envs == 1 else make_vector_environment
    return Collector(make(config.environment), config.run.seed)


def merge_config(wanted: Config, own: Config) -> Config:
    """Settings with which a run goes on: its own, but for `total_steps`, which may be changed.

    Raises:
        ValueError: If another setting is wanted than the run has.
    """
    there, here = own.to_json(), wanted.to_json()
    for name in dict.fromkeys(("bonus", *there, *here)):
        values = there.get(name), here.get(name)
        if name not in (*IGNORED, "total_steps") and values[0] != values[1]:
            raise ValueError(
                f"`{name}` must stay as the run in {own.run.out} has it, {values[0]!r}, "
                f"got {values[1]!r}."
            )
    return own.override(total_steps=wanted.run.total_steps)


def _print_machine(config: Config) -> None:
    """Say how the run computes."""
    precision, device = config.speed.matmul_precision, config.speed.device
    how = "compiled" if compiles(config) else "eager"
    error = matmul_error(device)
    print(f"Matrix products {precision}, relative error {error:.1e}; updates {how}", flush=True)


def peak_memory_megabytes() -> float | None:
    """Largest resident memory of this process so far; `None` where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def _restore(folder: Path, learner: Learner, collector: Collector) -> RunLog:
    state = load_checkpoint(folder)
    collector.load_state_dict(state["collector"])
    learner.load_state_dict(state["learner"])
    return RunLog.from_state(state["run_log"])


def _number(value: float | None) -> float:
    return math.nan if value is None else value
