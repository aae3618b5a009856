"""The training loop, read from top to bottom like the algorithm box of the paper's section 4."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import time
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

from tqdm import tqdm

from deep_curiosity.configuration import as_path
from deep_curiosity.training.callbacks import CALLBACK, Callback, call, check_callbacks
from deep_curiosity.training.collector import Episode
from deep_curiosity.training.config import Config
from deep_curiosity.training.environments import MakeEnv
from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.interruption import Interrupted, catch_interruption
from deep_curiosity.training.log import read_config
from deep_curiosity.training.run import Run, open_run
from deep_curiosity.training.wrappers import with_crossed_cells


def train(
    config: Config,
    *,
    resume: bool = False,
    hunger: HungerFunction | None = None,
    make_env: MakeEnv | None = None,
    new_episode: bool = False,
    on_evaluation: Callback | None = None,
    on_log: Callback | None = None,
    show_progress: bool = True,
) -> dict[str, Any]:
    """Train an agent and leave its records in a folder.

    Ctrl-C, or SIGTERM, ends the run with a checkpoint to continue from: after the step in
    progress, or before it where the environments take long. So does a callback that returns
    `True`, once the step is recorded.

    Args:
        config: Settings of the run.
        resume: Continue the run in the folder `out`, which must have the same settings but for
            those of `CHANGEABLE` in `training/config.py`; see also `continue_run`.
        hunger: Says how hungry the agent is before every step, in training as in evaluations: from
            the observations, `(num_envs, observation_dim)`, and the `info` that came with them, to
            one number, or one for each environment; in [0, 1] where the agent is conditioned on
            its hunger. An agent that is not conditioned has one hunger at a time, the mean of
            those of its environments. A resumed run must be given it again.
        make_env: Makes an environment of the caller's own, anew at every call, in the place of
            `env_id`. A resumed run must be given it again.
        new_episode: Resume with the next episode, and count the one in progress as cut off by the
            clock: for a task that does not repeat an episode from its seed and actions.
        on_evaluation: Called after every evaluation with the step and its `eval/return` and
            `eval/success_rate`; `True` stops the run.
        on_log: Called at every row of progress.csv with the step and the values of the row, by
            their tags; `True` stops the run.
        show_progress: Show a bar with return, bonus in nats and steps per second, and say how the
            run computes and how to go on with one that is stopped.

    Returns:
        The summary of the run, as in its `summary.json`; `stopped_by` is `None` after all steps,
        "callback", or the signal, "SIGINT" or "SIGTERM".

    Raises:
        DivergedError: If a loss or a weight is no longer finite; the last good checkpoint stays.
        EnvironmentFailedError: If an environment raises; all before that step is saved.
        FileExistsError: If `out` already holds a run, and `resume` is not set, or files that a
            run would write over.
        FileNotFoundError: If there is no run to continue.
        LeaseError: If another process writes into the folder, or takes it over.
        RuntimeError: If a resumed run's episode in progress does not repeat itself.
        TypeError: If a callback is no function, or returns what is neither a boolean nor `None`.
        ValueError: If the environment or a setting is not one the agent can take.
    """
    check_callbacks(on_evaluation=on_evaluation, on_log=on_log)

    # 1. Initialise policy, values, model and replay, or restore them
    with (
        open_run(
            config,
            resume=resume,
            hunger=hunger,
            make_env=make_env,
            new_episode=new_episode,
            quiet=not show_progress,
        ) as run,
        catch_interruption() as interruption,
        tqdm(
            total=run.config.run.total_steps,
            initial=run.run_log.step,
            disable=not show_progress,
        ) as bar,
    ):
        total_steps = run.config.run.total_steps
        asked = False

        # 2. Repeat at every time step, in all environments at once
        with suppress(Interrupted):
            while not (run.finished or asked or interruption.requested):
                if not run.unrecorded:  # else it was stopped in the evaluation of this step
                    _take_step(run)
                asked = _record_step(run, bar, on_evaluation, on_log)
                bar.update(min(run.run_log.step, total_steps) - bar.n)

        # 3. Close
        bar.close()
        run.save()
        stopped_by = None if run.finished else CALLBACK if asked else interruption.by
        summary = run.write_summary(stopped_by)
        _plot(run.folder)
        if show_progress and not run.finished:
            print(f"Stopped at step {run.run_log.step}; {run.way_on}")
        return summary


def _take_step(run: Run) -> None:
    """Act in all environments, and learn: a turn of the paper's algorithm."""
    course, run_log, learner = run.config.run, run.run_log, run.learner
    collector = run.collector
    step_started = time.perf_counter()
    learning = run_log.step >= course.learning_starts
    uniform = not learning and course.init_from is None

    # (d) Choose an action, obtain reward and next state; both are kept as they are
    if run.action is None:  # else it was stopped in this step
        observation = collector.observation
        with run.saved_on_error():  # of a hunger function
            learner.before_step(run_log.step, observation, collector.present_info)
        run.action = learner.act(observation, explore_uniformly=uniform)
    finished = run.collect()
    run_log.on_step(with_crossed_cells(collector.info))
    for episode in finished:
        run_log.episodes.append(episode)
        run.log.scalars(run_log.step, _scalars_of(episode))
    if 0 < len(run_log.episodes) == len(finished):
        _tell_of_no_success(run)

    # (a, b, c, e) Renew model, p(x'), values, policy, p(a) and temperature
    if learning:
        run.learn()
        run_log.learning_seconds += time.perf_counter() - step_started


def _record_step(
    run: Run, bar: tqdm, on_evaluation: Callback | None, on_log: Callback | None
) -> bool:
    """Evaluate without noise, log, tell the caller, keep a checkpoint, where each is due.

    Returns:
        Whether the caller asks to stop.
    """
    course, step = run.config.run, run.run_log.step
    evaluation = row = None
    if run.reached(course.evaluation_interval) or run.all_steps_taken:
        evaluation = run.evaluate()
    if run.metrics and (evaluation or run.reached(course.log_interval)):
        row = run.progress()
        bar.set_postfix_str(_postfix(row | run.latest_evaluation()), refresh=False)
    run.unrecorded = False
    with run.saved_on_error():
        stops = call(on_evaluation, step, evaluation, name="on_evaluation")
        stops |= call(on_log, step, row, name="on_log")
    if run.reached(course.checkpoint_interval):
        run.save()
    return stops


def _tell_of_no_success(run: Run) -> None:
    """Warn after the first episodes where they are to end at a success, and none is spoken of."""
    task = run.config.environment
    if task.terminate_on_success and not run.run_log.defines_success:
        warnings.warn(
            "`terminate_on_success` should be set for a task that reports success, as "
            f"`is_success` or `success` in its info: {task.env_id} has said nothing of it in its "
            "first episode, and no episode ends by it until it does.",
            stacklevel=4,
        )


def _scalars_of(episode: Episode) -> dict[str, float]:
    return {"episode/return": episode.episode_return, "episode/length": episode.length}


def _plot(folder: Path) -> None:
    """Leave the picture of the run in its folder; without one the run is as good as with it."""
    from deep_curiosity.training.figures import plot_run  # here, as Matplotlib takes a second

    try:
        plot_run(folder)
    except Exception as error:
        text = f"{folder} is whole, but its picture could not be drawn: {error!r}."
        warnings.warn(text, stacklevel=3)


def continue_run(
    folder: str | Path,
    *,
    total_steps: int | None = None,
    hunger: HungerFunction | None = None,
    make_env: MakeEnv | None = None,
    new_episode: bool = False,
    on_evaluation: Callback | None = None,
    on_log: Callback | None = None,
    show_progress: bool = True,
    **settings: Any,
) -> dict[str, Any]:
    """Continue the run in a folder, in place.

    Args:
        folder: Of the run.
        total_steps: Environment steps, those already taken included; as before when `None`.
        hunger: As in `train`; given again where the run had one.
        make_env: As in `train`.
        new_episode: As in `train`.
        on_evaluation: As in `train`.
        on_log: As in `train`.
        show_progress: As in `train`.
        **settings: What else is to change: intervals, `evaluation_episodes`, which leave what is
            learned as it is; `device`, `threads`, `compile` and other switches of speed, which
            round otherwise.

    Returns:
        The summary of the run.

    Raises:
        FileNotFoundError: If the folder holds no run.
        TypeError: If `folder` is no path, there is no such setting, or a value has the wrong type.
        ValueError: If the run cannot go on with a setting, naming it and both values.
    """
    if total_steps is not None:
        settings["total_steps"] = total_steps
    path = as_path("folder", folder)
    if as_path("out", settings.get("out", path)).resolve() != path.resolve():
        raise ValueError(
            f"`out` must be left out where a run is continued in {path}, got {settings['out']}."
        )
    config = read_config(path).override(**settings)
    return train(
        config,
        resume=True,
        hunger=hunger,
        make_env=make_env,
        new_episode=new_episode,
        on_evaluation=on_evaluation,
        on_log=on_log,
        show_progress=show_progress,
    )


def _postfix(values: dict[str, float]) -> str:
    """What the progress bar says beside the count."""
    shown = {
        "return": values["episode/return_mean"],
        "eval": values["eval/return"],
        "nats": values.get("curiosity/nats"),
        "steps/s": values["time/steps_per_second"],
    }
    return ", ".join(f"{name}={value:.3g}" for name, value in shown.items() if value is not None)
