"""Train the curious agent, or plain soft actor-critic, on a continuous-control task."""

import sys

import tyro

from deep_curiosity.training import Settings, train


def main() -> None:
    """Read the command line, train, and say where the run lies."""
    settings = tyro.cli(Settings, description=__doc__)
    try:
        summary = train(settings)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)
    folder = settings.resume or settings.out
    print(f"evaluation return {summary['evaluation_return']}, records in {folder}")


if __name__ == "__main__":
    main()
