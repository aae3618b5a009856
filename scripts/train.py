"""Train the curious agent on a continuous-control task; --help-all shows every setting."""

import sys

from deep_curiosity.training import train
from deep_curiosity.training.callbacks import stop_when_solved
from deep_curiosity.training.command_line import parse


def main() -> None:
    """Read the command line, train, and say where the run lies."""
    try:
        command = parse(description=__doc__ or "")
        solved = command.stop_when_solved
        on_evaluation = None if solved is None else stop_when_solved(solved)
        summary = train(command.config, resume=command.resume, on_evaluation=on_evaluation)
    except (ImportError, OSError, RuntimeError, TypeError, ValueError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
    folder = command.config.run.out
    print(f"evaluation return {summary['evaluation_return']}, records in {folder}")


if __name__ == "__main__":
    main()
