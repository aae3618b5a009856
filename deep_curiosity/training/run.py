"""A run in progress: its parts, opened together, saved together, closed together."""

import math
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from torch import Tensor

from deep_curiosity import __version__
from deep_curiosity.speed.machine import fitted_machine
from deep_curiosity.speed.precision import matmul_error
from deep_curiosity.training.checkpoint import (
    NEWEST,
    has_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from deep_curiosity.training.collector import Collector, Episode, evaluate
from deep_curiosity.training.config import IGNORED, Config
from deep_curiosity.training.divergence import DivergedError, broken_loss, broken_weight
from deep_curiosity.training.environments import (
    action_dim,
    make_environment,
    make_vector_environment,
    num_cells,
    observation_dim,
)
from deep_curiosity.training.failure import close_at_once, environment_failure
from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.interruption import Interrupted, is_interrupted
from deep_curiosity.training.learner import Learner, compiles
from deep_curiosity.training.lease import Lease
from deep_curiosity.training.log import (
    CONFIG,
    PROGRESS,
    SUMMARY,
    Log,
    check_unused,
    make_folder,
    open_folder,
    progress_up_to,
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
    lease: Lease
    """The right to write into the folder."""
    metrics: dict[str, Tensor] = field(default_factory=dict)
    """Of the newest update."""
    action: np.ndarray | None = None
    """Chosen for the step in progress; kept by a run that was cut off in it."""
    unrecorded: bool = False
    """Whether the newest step is still to be evaluated and logged."""
    saved_step: int | None = None
    """Of the newest checkpoint."""

    @property
    def all_steps_taken(self) -> bool:
        """Whether no step is left; with several environments there may be some more."""
        return self.run_log.step >= self.config.run.total_steps

    @property
    def finished(self) -> bool:
        """Whether all steps are taken, and the last one is evaluated and logged."""
        return self.all_steps_taken and not self.unrecorded

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

    def collect(self) -> list[Episode]:
        """Take the chosen action in every environment, and store the step.

        Returns:
            Episodes that it ended.

        Raises:
            EnvironmentFailedError: If an environment raises; all before the step is saved.
            Interrupted: If the user requests a stop meanwhile; the step is then not taken.
        """
        assert self.action is not None
        before = self.collector.position()
        with self._saved_on_failure("training"):
            try:
                step, finished = self.collector.step(self.action)
                self.learner.store(step)
            except BaseException:
                self.collector.step_back(before)
                close_at_once(self.collector.environment)
                raise
        self.action = None
        self.run_log.step += self.config.environment.num_envs
        return finished

    def evaluate(self) -> dict[str, float]:
        """Run the deterministic policy for whole episodes.

        Returns:
            What is logged of them.

        Raises:
            EnvironmentFailedError: If the environment raises; all up to this step is saved.
            Interrupted: If the user requests a stop meanwhile; it is then not evaluated.
        """
        with self._saved_on_failure("an evaluation"):
            episodes = evaluate(
                self.learner.evaluation_policy,
                self.evaluation_environment,
                episodes=self.config.run.evaluation_episodes,
                seed=EVALUATION_SEED,
            )
        self.run_log.on_evaluated(episodes)
        values = self._latest_evaluation()
        self.log.scalars(self.run_log.step, values)
        return values

    @contextmanager
    def _saved_on_failure(self, activity: str) -> Iterator[None]:
        """Save before an error of the environment is raised again, with what there is to do."""
        try:
            yield
        except Exception as error:
            if is_interrupted():  # its processes may have heard the same signal
                raise Interrupted from error
            try:
                self.save()
                kept = f"all up to step {self.run_log.step} is saved"
            except OSError as unsaved:
                kept = f"{unsaved}; step {self.saved_step} is saved"
            raise environment_failure(
                self.config, error, activity, step=self.run_log.step, kept=kept
            ) from error

    def progress(self) -> dict[str, float]:
        """Write down everything there is to tell at this step, and return it.

        Raises:
            DivergedError: If a loss is not finite.
            LeaseError: If another process has taken over the folder.
        """
        self._refuse_broken(broken_loss(self.metrics))
        self.lease.check()
        run_log = self.run_log
        values = {
            "episode/return_mean": _number(mean_return(run_log.episodes)),
            "episode/success_rate": _number(success_rate(run_log.episodes)),
            "time/steps_per_second": run_log.steps_per_second,
        }
        total_cells = num_cells(self.evaluation_environment)
        if total_cells is not None:
            values["episode/coverage"] = _number(run_log.coverage(total_cells))
        values |= {tag: value.item() for tag, value in self.metrics.items()}
        values |= {tag: value.item() for tag, value in self.learner.diagnostics().items()}
        self.log.scalars(run_log.step, values)
        values |= self._latest_evaluation()
        self.log.row(run_log.step, values)
        return values

    def _latest_evaluation(self) -> dict[str, float]:
        episodes = self.run_log.latest_evaluation
        return {
            "eval/return": _number(mean_return(episodes, num_recent=len(episodes))),
            "eval/success_rate": _number(success_rate(episodes, num_recent=len(episodes))),
        }

    def save(self) -> None:
        """Write a checkpoint of all there is.

        Raises:
            DivergedError: If a loss or a weight is not finite; the checkpoints there stay.
            LeaseError: If another process has taken over the folder.
            OSError: If it cannot be written; the checkpoints there stay.
        """
        learner = self.learner
        self._refuse_broken(
            broken_loss(self.metrics) or broken_weight(agent=learner.agent, bonus=learner.bonus)
        )
        self.lease.check()
        self.run_log.wall_seconds = time.perf_counter() - self.started
        state = {
            "learner": learner.state_dict(),
            "collector": self.collector.state_dict(),
            "run_log": self.run_log.state_dict(),
            "progress": self.log.progress,
            "metrics": self.metrics,
            "action": None if self.action is None else torch.from_numpy(self.action),
            "unrecorded": self.unrecorded,
        }
        save_checkpoint(self.config.run.out, state, check=self.lease.check)
        self.saved_step = self.run_log.step

    def restore(self, state: dict[str, Any]) -> None:
        """Go on where a checkpoint was written; one of an earlier version says less.

        Raises:
            DivergedError: If its weights are not finite.
        """
        self.collector.load_state_dict(state["collector"])
        self.learner.load_state_dict(state["learner"])
        self.run_log = RunLog.from_state(state["run_log"])
        self.metrics = state.get("metrics", {})
        action = state.get("action")
        self.action = None if action is None else action.numpy()
        self.unrecorded = state.get("unrecorded", False)
        agent, bonus = self.learner.agent, self.learner.bonus
        self._refuse_broken(broken_weight(agent=agent, bonus=bonus))
        self.saved_step = self.run_log.step

    def _refuse_broken(self, broken: str | None) -> None:
        if broken is None:
            return
        folder = self.config.run.out
        good = (
            "there is no good checkpoint"
            if self.saved_step is None
            else f"the last good checkpoint, of step {self.saved_step}, is {folder / NEWEST}"
        )
        raise DivergedError(
            f"{broken} at step {self.run_log.step} of {folder}: the run has diverged; {good}."
        )

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
        DivergedError: If the weights of a run to be continued are not finite.
        FileExistsError: If `out` already holds a run that is not to be continued, or files that
            a run would write over.
        FileNotFoundError: If there is no run to continue.
        LeaseError: If another process writes into the folder.
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
        begins = not resume or is_unbegun(config.run.out)
        lease = _hold_folder(config.run.out, resume=resume)
        stack.callback(lease.release)
        state = {} if begins else load_checkpoint(config.run.out, mend=True)
        if resume:
            write_json(config.run.out / CONFIG, config.to_json())
        else:
            open_folder(config)
        log = _open_log(config.run.out, state)
        stack.callback(log.close)
        started = time.perf_counter() - state.get("run_log", {}).get("wall_seconds", 0.0)
        run = Run(
            config, evaluation_environment, learner, collector, RunLog(), log, started, lease
        )
        if begins:
            run.save()  # so that a run that fails at once can still be continued
        else:
            run.restore(state)
        yield run


def is_unbegun(folder: Path) -> bool:
    """Whether a run was killed before its first checkpoint, so that it begins anew."""
    left = [folder / name for name in (PROGRESS, SUMMARY)]
    return not has_checkpoint(folder) and not any(
        path.exists() and path.stat().st_size for path in left
    )


def _hold_folder(folder: Path, *, resume: bool) -> Lease:
    """Lease on the folder of a run, which is made, and not touched where it is another's."""
    make_folder(folder)
    if not resume:
        check_unused(folder)
    return Lease(folder)


def _open_log(folder: Path, state: dict[str, Any]) -> Log:
    """Log of a run that begins, or goes on from a checkpoint."""
    start = state["run_log"]["step"] if state else 0
    progress = state.get("progress")
    if progress is None:  # a checkpoint of an earlier version
        progress = progress_up_to(folder, start)
    return Log(folder, start=start, progress=progress)


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


def _number(value: float | None) -> float:
    return math.nan if value is None else value
