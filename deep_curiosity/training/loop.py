"""The training loop, read from top to bottom like the algorithm box of the paper's section 4."""

import time
from typing import Any

from torch import Tensor
from tqdm import tqdm

from deep_curiosity.training.hunger import HungerFunction
from deep_curiosity.training.interruption import catch_interruption
from deep_curiosity.training.figures import draw_run
from deep_curiosity.training.run import open_run
from deep_curiosity.training.config import Settings


def train(
    settings: Settings, *, hunger: HungerFunction | None = None, show_progress: bool = True
) -> dict[str, Any]:
    """Train an agent, or continue a run, and leave its records in a folder.

    Ctrl-C ends the run after the step in progress, with a checkpoint to continue from.

    Args:
        settings: Of the run.
        hunger: Says how hungry the agent is before every step, in training as in evaluations: from
            the observations, `(num_envs, observation_dim)`, and the `info` that came with them, to
            one number, or one for each world; in [0, 1] where `hunger_control` is `"dial"`. A
            resumed run must be given it again.
        show_progress: Show a bar with return, bonus in nats and steps per second.

    Returns:
        The summary of the run, as in its `summary.json`.

    Raises:
        FileExistsError: If `out` already holds a run.
        FileNotFoundError: If there is no run to continue.
        ValueError: If the environment or a setting is not one the agent can take.
    """
    # 1. Initialise policy, values, model and replay, or restore them
    with open_run(settings, hunger) as run, catch_interruption() as interruption:
        settings, history = run.settings, run.history
        learner, collector = run.learner, run.collector
        bar = tqdm(total=settings.total_steps, initial=history.step, disable=not show_progress)

        metrics: dict[str, Tensor] = {}

        # 2. Repeat at every time step, in all worlds at once
        while not run.finished and not interruption.requested:
            step_started = time.perf_counter()
            learning = history.step >= settings.learning_starts
            learner.turn(history.step, collector.observation, collector.present_info)
            history.step += settings.num_envs

            # (d) Choose an action, obtain reward and next state; both are kept as they are
            action = learner.act(collector.observation, explore_uniformly=not learning)
            step, finished = collector.step(action)
            learner.store(step)
            history.record(collector.info)
            for episode in finished:
                history.episodes.append(episode)
                run.records.scalars(
                    history.step,
                    {"episode/return": episode.episode_return, "episode/length": episode.length},
                )

            # (a, b, c, e) Renew the model, p(x'), the values, the policy, p(a) and the temperature
            if learning:
                for _ in range(run.updates_due):
                    metrics = learner.update()
                history.learned(settings.num_envs, time.perf_counter() - step_started)

            # Evaluate without noise, log, keep a checkpoint
            if run.reached(settings.evaluation_interval) or run.finished:
                run.evaluate()
            if metrics and (run.reached(settings.log_interval) or run.finished):
                values = run.progress(metrics)
                bar.set_postfix_str(_postfix(values), refresh=False)
            if run.reached(settings.checkpoint_interval):
                run.save()
            bar.update(min(history.step, settings.total_steps) - bar.n)

        # 3. Close
        bar.close()
        run.save()
        summary = run.write_summary()
        draw_run(settings.out)
        if not run.finished:
            print(f"Stopped at step {history.step}; continue with --resume {settings.out}")
        return summary


def _postfix(values: dict[str, float]) -> str:
    """What the progress bar says beside the count."""
    shown = {
        "return": values["episode/return_mean"],
        "eval": values["eval/return"],
        "nats": values.get("curiosity/nats"),
        "steps/s": values["time/steps_per_second"],
    }
    return ", ".join(f"{name}={value:.3g}" for name, value in shown.items() if value is not None)
