"""Train the curious agent on a continuous-control task; --help-all shows every setting."""

from deep_curiosity.cli import answering
from deep_curiosity.training import train
from deep_curiosity.training.command_line import parse


def main() -> None:
    """Read the command line, train, and say where the run lies."""
    command = parse(description=__doc__ or "")
    summary = train(command.config, resume=command.resume)
    folder = command.config.run.out
    print(f"evaluation return {summary['evaluation_return']}, records in {folder}")


if __name__ == "__main__":
    with answering():
        main()
