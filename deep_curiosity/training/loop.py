"""The training loop, read from top to bottom like the algorithm box of the paper's section 4."""

import time
from pathlib import Path
from typing import Any

from torch import Tensor
from tqdm import tqdm

from deep_curiosity.training.callbacks import Callback, call
from deep_curiosity.training.config import Config
from deep_curiosity.training.figures import plot_run
from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.interruption import catch_interruption
from deep_curiosity.training.log import read_config
from deep_curiosity.training.run import open_run


def train(
    config: Config,
    *,
    resume: bool = False,
    hunger: HungerFunction | None = None,
    on_evaluation: Callback | None = None,
    on_log: Callback | None = None,
    show_progress: bool = True,
) -> dict[str, Any]:
    """Train an agent and leave its records in a folder.

    Ctrl-C ends the run after the step in progress, with a checkpoint to continue from; so does a
    callback that returns `True`.

    Args:
        config: Settings of the run.
        resume: Continue the run in the folder `out`, which must have the same settings but for
            `total_steps`; see also `continue_run`.
        hunger: Says how hungry the agent is before every step, in training as in evaluations: from
            the observations, `(num_envs, observation_dim)`, and the `info` that came with them, to
            one number, or one for each environment; in [0, 1] where the agent is conditioned on
            its hunger. A resumed run must be given it again.
        on_evaluation: Called after every evaluation with the step and its `eval/return` and
            `eval/success_rate`; `True` stops the run.
        on_log: Called at every row of progress.csv with the step and the values of the row, by
            their tags; `True` stops the run.
        show_progress: Show a bar with return, bonus in nats and steps per second.

    Returns:
        The summary of the run, as in its `summary.json`.

    Raises:
        FileExistsError: If `out` already holds a run, and `resume` is not set.
        FileNotFoundError: If there is no run to continue.
        ValueError: If the environment or a setting is not one the agent can take.
    """
    # 1. Initialise policy, values, model and replay, or restore them
    with (
        open_run(config, resume=resume, hunger=hunger) as run,
        catch_interruption() as interruption,
    ):
        course, num_envs = run.config.run, run.config.environment.num_envs
        run_log, learner, collector = run.run_log, run.learner, run.collector
        bar = tqdm(total=course.total_steps, initial=run_log.step, disable=not show_progress)

        metrics: dict[str, Tensor] = {}

        # 2. Repeat at every time step, in all environments at once
        while not run.finished and not interruption.requested:
            step_started = time.perf_counter()
            learning = run_log.step >= course.learning_starts
            learner.before_step(run_log.step, collector.observation, collector.present_info)
            run_log.step += num_envs

            # (d) Choose an action, obtain reward and next state; both are kept as they are
            action = learner.act(collector.observation, explore_uniformly=not learning)
            step, finished = collector.step(action)
            learner.store(step)
            run_log.on_step(collector.info)
            for episode in finished:
                run_log.episodes.append(episode)
                run.log.scalars(
                    run_log.step,
                    {"episode/return": episode.episode_return, "episode/length": episode.length},
                )

            # (a, b, c, e) Renew the model, p(x'), the values, the policy, p(a) and the temperature
            if learning:
                for _ in range(run.updates_due):
                    metrics = learner.update()
                run_log.on_learned(num_envs, time.perf_counter() - step_started)

            # Evaluate without noise, log, keep a checkpoint
            if run.reached(course.evaluation_interval) or run.finished:
                evaluation = run.evaluate()
                interruption.requested |= call(on_evaluation, run_log.step, evaluation)
            if metrics and (run.reached(course.log_interval) or run.finished):
                values = run.progress(metrics)
                interruption.requested |= call(on_log, run_log.step, values)
                bar.set_postfix_str(_postfix(values), refresh=False)
            if run.reached(course.checkpoint_interval):
                run.save()
            bar.update(min(run_log.step, course.total_steps) - bar.n)

        # 3. Close
        bar.close()
        run.save()
        summary = run.write_summary()
        plot_run(course.out)
        if not run.finished:
            print(f"Stopped at step {run_log.step}; continue with --resume {course.out}")
        return summary


def continue_run(
    folder: str | Path,
    *,
    total_steps: int | None = None,
    hunger: HungerFunction | None = None,
    on_evaluation: Callback | None = None,
    on_log: Callback | None = None,
    show_progress: bool = True,
) -> dict[str, Any]:
    """Continue the run in a folder, in place.

    Args:
        folder: Of the run.
        total_steps: Environment steps, those already taken included; as before when `None`.
        hunger: As in `train`.
        on_evaluation: As in `train`.
        on_log: As in `train`.
        show_progress: As in `train`.

    Returns:
        The summary of the run.

    Raises:
        FileNotFoundError: If the folder holds no run.
    """
    config = read_config(Path(folder))
    if total_steps is not None:
        config = config.override(total_steps=total_steps)
    return train(
        config,
        resume=True,
        hunger=hunger,
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
