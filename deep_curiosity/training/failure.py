"""Environments that raise: what is said of it, and how they are left."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import gymnasium
from gymnasium.vector import SyncVectorEnv, VectorEnv

from deep_curiosity.training.config import Config

RAISED: tuple[type[BaseException], ...] = (Exception, SystemExit)
"""What code of others may raise: one that exits would take along what was not saved yet."""


class EnvironmentFailedError(RuntimeError):
    """An environment has raised an error while it was stepped or reset."""


def environment_failure(
    config: Config, error: BaseException, activity: str, *, step: int, kept: str
) -> EnvironmentFailedError:
    """An error that says which environment failed where.

    Args:
        config: Settings of the run.
        error: What the environment raised.
        activity: What it was stepped for.
        step: The last step that is complete.
        kept: What is saved of the run, and how to go on with it.
    """
    own, index = config.environment, failed_index(error)
    which = "" if index is None else f", number {index} of {own.num_envs}"
    return EnvironmentFailedError(
        f"`env_id` must name an environment that steps and resets without an error, got "
        f"{type(error).__name__}: {error}, from {own.env_id}{which}, in {activity} after step "
        f"{step}; {kept}."
    )


def way_on(config: Config, functions: Sequence[str] = ()) -> str:
    """How to continue a run.

    Args:
        config: Its settings.
        functions: Arguments by which the caller gave functions, which no folder holds.
    """
    out = config.run.out
    if not functions:
        return f"continue with --resume {out}"
    given = "".join(f", {name}=..." for name in functions)
    return f"continue with deep_curiosity.continue_run({str(out)!r}{given})"


def failed_index(error: BaseException) -> int | None:
    """Which of several environments that are stepped in turn has raised, from 0, where known."""
    for frame, _ in traceback.walk_tb(error.__traceback__):
        index = frame.f_locals.get("i")
        if isinstance(frame.f_locals.get("self"), SyncVectorEnv) and isinstance(index, int):
            return index
    return None


def note(error: BaseException, text: str) -> None:
    """Have an error say more; before Python 3.11, where none takes a note, a warning says it."""
    if hasattr(error, "add_note"):
        error.add_note(text)
    else:
        warnings.warn(text, stacklevel=2)


@contextmanager
def closed_at_the_end(environment: gymnasium.Env | VectorEnv) -> Iterator[None]:
    """Close environments however it ends; where that is by an error, it is the one to come out."""
    try:
        yield
    except BaseException:
        with suppress(*RAISED):
            _close(environment)
        raise
    _close(environment)


def _close(environment: gymnasium.Env | VectorEnv) -> None:
    """Close environments, whose processes may have heard the signal that ended the run."""
    try:
        environment.close()
    except (ConnectionError, EOFError):  # a pipe that is broken is such a connection
        if isinstance(environment, VectorEnv):
            close_at_once(environment)


def close_at_once(environment: VectorEnv) -> None:
    """Close environments that were cut off within a call, waiting for none of their processes."""
    with warnings.catch_warnings(), suppress(Exception):
        warnings.simplefilter("ignore")  # that a call is pending
        environment.close(terminate=True)
