"""Train the curious agent on a continuous-control task; --help-all shows every setting."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence

from deep_curiosity.cli import INTERRUPTED
from deep_curiosity.training import train
from deep_curiosity.training.callbacks import stop_when_solved
from deep_curiosity.training.command_line import parse

STATUS = {"SIGINT": INTERRUPTED, "SIGTERM": 143}
"""Exit status by the signal that stopped a run, as of a shell's command that it has ended."""


def main(arguments: Sequence[str]) -> int:
    """Train, and say where the run lies; return whether a signal stopped it."""
    command = parse(arguments, description=__doc__ or "", prog="deep-curiosity train")
    solved = command.stop_when_solved
    on_evaluation = None if solved is None else stop_when_solved(solved)
    summary = train(
        command.config,
        resume=command.resume,
        new_episode=command.new_episode,
        on_evaluation=on_evaluation,
    )
    folder = command.config.run.out
    print(f"evaluation return {summary['evaluation_return']}, records in {folder}")
    return STATUS.get(summary["stopped_by"], 0)
