"""A run in progress: its parts, opened together, saved together, closed together."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
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
from deep_curiosity.training.config import (
    CHANGEABLE,
    LEARNING_STAYS,
    ROUNDING_CHANGES,
    Config,
    EnvironmentConfig,
    check_device,
    merge_config,
)
from deep_curiosity.training.divergence import DivergedError, broken_loss, broken_weight
from deep_curiosity.training.environments import (
    MADE_BY_FUNCTION,
    EnvironmentMaker,
    MakeEnv,
    action_dim,
    make_environment,
    make_vector_environment,
    num_cells,
    observation_dim,
    task_spaces,
)
from deep_curiosity.training.failure import (
    RAISED,
    close_at_once,
    closed_at_the_end,
    environment_failure,
    note,
    way_on,
)
from deep_curiosity.training.hindsight import GoalFunctionError, make_hindsight
from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.interfaces import Info
from deep_curiosity.training.interruption import Interrupted, is_interrupted
from deep_curiosity.training.learner import Learner, compiles, compiles_from
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
from deep_curiosity.training.spaces import SPACES, check_same_task
from deep_curiosity.training.warm_start import begin_from

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
    error_of_caller: BaseException | None = None
    """What a function of the caller's has raised, which is none of the environment's."""

    @property
    def folder(self) -> Path:
        """Where it is written to, wherever the working folder is by now."""
        return self.lease.folder

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
        self.unrecorded = True
        return finished

    def evaluate(self) -> dict[str, float]:
        """Run the deterministic policy for whole episodes.

        Returns:
            What is logged of them.

        Raises:
            EnvironmentFailedError: If the environment raises; all up to this step is saved.
            Exception: What a hunger function raises, with a note; saved likewise.
            Interrupted: If the user requests a stop meanwhile; it is then not evaluated.
        """

        def policy(observation: Tensor, info: Info) -> Tensor:
            with self.saved_on_error():
                return self.learner.evaluation_policy(observation, info)

        with self._saved_on_failure("an evaluation"):
            episodes = evaluate(
                policy,
                self.evaluation_environment,
                episodes=self.config.run.evaluation_episodes,
                seed=EVALUATION_SEED,
                usual_observation=self.collector.usual_observation,
            )
        self.run_log.on_evaluated(episodes)
        values = self.latest_evaluation()
        self.log.scalars(self.run_log.step, values)
        return values

    def learn(self) -> None:
        """Update as often as the newest steps call for; not at all before one is held in replay.

        Raises:
            DivergedError: If a loss is not finite when the run is saved.
            EnvironmentFailedError: If its `compute_reward` fails on a goal in hindsight; the steps
                are saved, and the updates that they still call for are left out.
        """
        due = self.updates_due if len(self.learner.replay) else 0
        self.run_log.learning_steps += self.config.environment.num_envs  # whatever comes of them
        with self._saved_on_failure("an update", GoalFunctionError):
            for _ in range(due):
                self.metrics = self.learner.update()

    @contextmanager
    def _saved_on_failure(
        self, activity: str, errors: type[Exception] | tuple[type[BaseException], ...] = RAISED
    ) -> Iterator[None]:
        """Save before an error of the environment is raised again, with what there is to do."""
        try:
            yield
        except errors as error:
            if error is self.error_of_caller:
                raise
            if is_interrupted():  # its processes may have heard the same signal
                raise Interrupted from error
            raise environment_failure(
                self.config,
                error,
                activity,
                step=self.run_log.step,
                kept=f"{self._save_what_is_left()}; {self.way_on}",
            ) from error

    @contextmanager
    def saved_on_error(self) -> Iterator[None]:
        """Save before an error of the caller's own function goes on, with a note that says so."""
        try:
            yield
        except RAISED as error:
            self.error_of_caller = error
            note(error, f"{self._save_what_is_left()}; {self.way_on}.")
            raise

    @property
    def way_on(self) -> str:
        """How to continue the run, in words."""
        functions = {
            "make_env": self.config.environment.env_id == MADE_BY_FUNCTION,
            "hunger": self.learner.has_hunger_function,
        }
        return way_on(self.config, [name for name, is_given in functions.items() if is_given])

    def _save_what_is_left(self) -> str:
        """Save after an error; what is kept, in words."""
        try:
            self.save()
        except OSError as unsaved:
            return f"{unsaved}; step {self.saved_step} is saved"
        return f"all up to step {self.run_log.step} is saved"

    def progress(self) -> dict[str, float]:
        """Write down everything there is to tell at this step, and return it.

        Of an evaluation it tells where there was one at this step, and is NaN elsewhere.

        Raises:
            DivergedError: If a loss is not finite.
            LeaseError: If another process has taken over the folder.
        """
        self._refuse_broken(broken_loss(self.metrics))
        self.lease.check()
        run_log = self.run_log
        values = {
            "episode/return_mean": _number(mean_return(run_log.episodes)),
            "episode/success_rate": _number(
                success_rate(run_log.episodes, is_defined=run_log.defines_success)
            ),
            "episode/broken": float(run_log.broken_episodes),
            "time/steps_per_second": run_log.steps_per_second,
        }
        total_cells = num_cells(self.evaluation_environment)
        if total_cells is not None:
            values["episode/coverage"] = _number(run_log.coverage(total_cells))
        values |= {tag: value.item() for tag, value in self.metrics.items()}
        values |= {tag: value.item() for tag, value in self.learner.diagnostics().items()}
        self.log.scalars(run_log.step, values)
        evaluation = self.latest_evaluation()
        is_new = run_log.evaluation_step == run_log.step
        values |= evaluation if is_new else dict.fromkeys(evaluation, math.nan)
        self.log.row(run_log.step, values)
        return values

    def latest_evaluation(self) -> dict[str, float]:
        """What is logged of the newest evaluation; NaN before there was one."""
        episodes = self.run_log.latest_evaluation
        return {
            "eval/return": _number(mean_return(episodes, num_recent=len(episodes))),
            "eval/success_rate": _number(
                success_rate(
                    episodes, num_recent=len(episodes), is_defined=self.run_log.defines_success
                )
            ),
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
        save_checkpoint(self.folder, state, check=self.lease.check)
        self.saved_step = self.run_log.step

    def restore(self, state: dict[str, Any], *, new_episode: bool = False) -> None:
        """Go on where a checkpoint was written; one of an earlier version says less.

        Args:
            state: Of the checkpoint.
            new_episode: Cut off the episodes in progress, and begin the next ones.

        Raises:
            DivergedError: If its weights are not finite.
            RuntimeError: If an episode in progress does not repeat itself.
        """
        come_back = self.collector.begin_after if new_episode else self.collector.load_state_dict
        come_back(state["collector"])
        self.learner.load_state_dict(state["learner"])  # random numbers last of all
        if new_episode:
            self.learner.replay.cut_off()
            self._begin_episodes()
            state = state | {"action": None}
        self.run_log = RunLog.from_state(state["run_log"])
        self.metrics = state.get("metrics", {})
        action = state.get("action")
        self.action = None if action is None else action.numpy()
        self.unrecorded = state.get("unrecorded", False)
        self.learner.compile_when_due(self.run_log.step)  # else before the next action alone
        agent, bonus = self.learner.agent, self.learner.bonus
        self._refuse_broken(broken_weight(agent=agent, bonus=bonus))
        self.saved_step = self.run_log.step

    def _begin_episodes(self) -> None:
        """Choose afresh, in all environments, what is chosen where an episode begins."""
        learner, num_envs = self.learner, self.config.environment.num_envs
        for index in range(num_envs):
            learner.hunger_controller.begin(index)
        learner.greedy_stretches.record(np.ones(num_envs, dtype=bool), learner.agent.greedy_share)
        if learner.noise is not None:
            for index in range(num_envs):
                learner.noise.begin(index)

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

    def write_summary(self, stopped_by: str | None = None) -> dict[str, Any]:
        """Write the figures by which runs are compared, and what stopped this one early."""
        config = self.config
        summary = {
            "env_id": config.environment.env_id,
            "seed": config.run.seed,
            "bonus": config.bonus.kind,
            "prior": config.agent.prior_of(curiosity=self.learner.agent.curiosity),
            "total_steps": self.run_log.step,
            "stopped_by": stopped_by,
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
        write_json(self.folder / SUMMARY, summary)
        return summary


@contextmanager
def open_run(
    config: Config,
    *,
    resume: bool = False,
    hunger: HungerFunction | None = None,
    make_env: MakeEnv | None = None,
    new_episode: bool = False,
    quiet: bool = False,
) -> Iterator[Run]:
    """Begin a run, or continue the one in its folder; close it however it ends.

    Args:
        config: Settings of the run.
        resume: Continue.
        hunger: The caller's own function of observation and info.
        make_env: The caller's own function that makes an environment.
        new_episode: Begin a continued run with the next episode.
        quiet: Do not say how the run computes.

    Raises:
        DivergedError: If the weights of a run to be continued are not finite.
        FileExistsError: If `out` already holds a run that is not to be continued, or files that
            a run would write over.
        FileNotFoundError: If there is no run to continue.
        LeaseError: If another process writes into the folder.
        ValueError: If the environment is not one the agent can take, or a run is to be continued
            with other settings than its own.
    """
    _check_request(resume=resume, new_episode=new_episode)
    config = with_make_env(config, make_env)
    if make_env is not None:
        make_env = EnvironmentMaker(make_env)
    own = read_config(config.run.out) if resume else None
    if own is not None:
        config = merge_config(config, own)
    check_device(config.speed.device)
    absolute = _with_absolute_paths(config)
    folder = absolute.run.out
    with ExitStack() as stack:
        stack.enter_context(_working_folder_kept())
        config = _fit_machine(config, stack, quiet=quiet)
        evaluation_environment, learner, collector = _make_parts(config, hunger, make_env, stack)
        named = config.run.out if config.run.out.absolute() == folder else folder  # for errors
        begins = own is None or is_unbegun(folder)
        if begins:
            begin_from(absolute, learner, collector)
        lease = _hold_folder(folder, named, resume=resume)
        stack.callback(lease.release)
        state = {} if begins else load_checkpoint(named, mend=True, argument="resume")
        if own is None:
            open_folder(config, named)  # unless another process has meanwhile
        else:
            _check_continued(config, own, state, hunger, new_episode=new_episode)
        spaces = task_spaces(evaluation_environment)
        if state:
            check_same_task(spaces, named)
        log = _open_log(folder, state)
        stack.callback(log.close)
        started = time.perf_counter() - state.get("run_log", {}).get("wall_seconds", 0.0)
        run = Run(
            config, evaluation_environment, learner, collector, RunLog(), log, started, lease
        )
        if begins:
            run.save()  # so that a run that fails at once can still be continued
        else:
            run.restore(state, new_episode=new_episode)
        # only now: what cannot be continued keeps its spaces and settings
        write_json(folder / SPACES, spaces.to_json())
        if resume:
            write_json(folder / CONFIG, config.to_json())
        yield run


def _fit_machine(config: Config, stack: ExitStack, *, quiet: bool) -> Config:
    """Fit the machine to the run until the stack is closed; settings that say how, to be kept."""
    precision = stack.enter_context(fitted_machine(config.speed))
    config = replace(config, speed=replace(config.speed, matmul_precision=precision))
    if not quiet:
        _print_machine(config)
    torch.manual_seed(config.run.seed)
    return config


@contextmanager
def _working_folder_kept() -> Iterator[None]:
    """Come back at the end to the working folder, which environments may change."""
    before = None
    with suppress(FileNotFoundError):  # it is deleted
        before = Path.cwd()
    try:
        yield
    finally:
        if before is not None:
            with suppress(OSError):
                os.chdir(before)


def _with_absolute_paths(config: Config) -> Config:
    """Settings whose folders stay the same where an environment changes the working folder."""
    origin = config.run.init_from
    run = replace(
        config.run,
        out=config.run.out.absolute(),
        init_from=None if origin is None else origin.absolute(),
    )
    return replace(config, run=run)


def _check_request(*, resume: bool, new_episode: bool) -> None:
    """Refuse what no run can be opened with."""
    if torch.get_default_dtype() is not torch.float32:
        raise ValueError(
            "`torch.set_default_dtype` must be left at torch.float32 where a run trains, got "
            f"{torch.get_default_dtype()}."
        )
    if new_episode and not resume:
        raise ValueError("`new_episode` must be left out where no run is continued, got True.")


def _make_parts(
    config: Config, hunger: HungerFunction | None, make_env: MakeEnv | None, stack: ExitStack
) -> tuple[gymnasium.Env, Learner, Collector]:
    """Environment of evaluations, learner and collector; environments close with the stack."""
    evaluation_environment = make_environment(config.environment, **_own(make_env))
    stack.enter_context(closed_at_the_end(evaluation_environment))
    sizes = observation_dim(evaluation_environment), action_dim(evaluation_environment)
    hindsight = make_hindsight(config.run.hindsight, evaluation_environment)
    learner = Learner(config, *sizes, hunger, hindsight)
    collector = make_collector(config, make_env)
    stack.enter_context(closed_at_the_end(collector.environment))
    return evaluation_environment, learner, collector


def with_make_env(config: Config, make_env: MakeEnv | None) -> Config:
    """Settings that say so where the caller's own function makes the environments."""
    if make_env is None or config.environment.env_id != EnvironmentConfig().env_id:
        return config
    return config.override(env_id=MADE_BY_FUNCTION)


def _own(make_env: MakeEnv | None) -> dict[str, Any]:
    """The caller's own function as an argument, where there is one."""
    return {} if make_env is None else {"make_env": make_env}


def is_unbegun(folder: Path) -> bool:
    """Whether a run was killed before its first checkpoint, so that it begins anew."""
    left = [folder / name for name in (PROGRESS, SUMMARY)]
    return not has_checkpoint(folder) and not any(
        path.exists() and path.stat().st_size for path in left
    )


def _hold_folder(folder: Path, named: Path, *, resume: bool) -> Lease:
    """Lease on the folder of a run, which is made, and not touched where it is another's."""
    make_folder(named)
    if not resume:
        check_unused(named)
    return Lease(folder)


def _open_log(folder: Path, state: dict[str, Any]) -> Log:
    """Log of a run that begins, or goes on from a checkpoint."""
    if not state:
        return Log(folder)
    step, progress = state["run_log"]["step"], state.get("progress")
    if progress is None:  # a checkpoint of an earlier version
        progress = progress_up_to(folder, step)
    return Log(folder, resumed_at=step, progress=progress)


def make_collector(config: Config, make_env: MakeEnv | None = None) -> Collector:
    """Collector of a run, with its environment."""
    make = make_environment if config.environment.num_envs == 1 else make_vector_environment
    return Collector(make(config.environment, **_own(make_env)), config.run.seed)


def _check_continued(
    config: Config,
    own: Config,
    state: dict[str, Any],
    hunger: HungerFunction | None,
    *,
    new_episode: bool,
) -> None:
    """Refuse what a run cannot be continued with, and say what is to change."""
    if state:
        _check_hunger(state["learner"], hunger, config.run.out)
    _check_remaining(config, own, state["run_log"]["step"] if state else 0)
    _print_changes(config, own, new_episode=new_episode)


def _check_hunger(learner: dict[str, Any], hunger: HungerFunction | None, folder: Path) -> None:
    """Refuse to go on without the function that has set the hunger so far, or with one since."""
    had = learner.get("has_hunger_function")  # of a checkpoint that is older: unknown
    if had is True and hunger is None:
        raise ValueError(
            "`hunger` must be given again, since a function of the caller has set that of the "
            f"run in {folder}: it goes on by deep_curiosity.continue_run(folder, hunger=...), got "
            "None."
        )
    if had is False and hunger is not None:
        raise ValueError(
            f"`hunger` must be left out, since no function has set that of the run in {folder}, "
            f"got {hunger!r}."
        )


def _check_remaining(config: Config, own: Config, taken: int) -> None:
    """Refuse to continue a run to where it has been, and say where nothing is left to do."""
    total_steps = config.run.total_steps
    if total_steps < taken and total_steps != own.run.total_steps:
        raise ValueError(
            f"`total_steps` must be at least {taken}, which the run in {own.run.out} has already "
            f"taken, got {total_steps}."
        )
    if total_steps <= taken:
        print(f"All {taken} steps of the run in {own.run.out} are taken", flush=True)


def _print_changes(config: Config, own: Config, *, new_episode: bool = False) -> None:
    """Say which settings of a continued run are others than before, and what comes of it."""
    before, now = own.to_json(), config.to_json()
    for name in CHANGEABLE:
        if now[name] == before[name]:
            continue
        if name in LEARNING_STAYS:
            effect = "what is learned stays exactly what it would have been"
        elif name in ROUNDING_CHANGES or compiles(config) != compiles(own):
            effect = "from here on results are rounded otherwise than they would have been"
        elif config.agent.follows_schedule:
            effect = "schedules are stretched over all steps, and go on from another value"
        else:
            effect = "the run goes on exactly as if it had been so from the start"
            if new_episode:
                effect += ", but for the episode that is cut off"
        print(f"`{name}` is {now[name]}, it was {before[name]}: {effect}", flush=True)


def _print_machine(config: Config) -> None:
    """Say how the run computes."""
    precision, device = config.speed.matmul_precision, config.speed.device
    start = compiles_from(config)
    how = (
        "eager"
        if start is None
        else f"compiled from step {start}, which takes up to half a minute"
    )
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
