"""Which source a result was made by."""

import subprocess
from functools import cache
from pathlib import Path


@cache
def source_commit() -> str:
    """Commit of the checkout that this package runs from, `+` where it was changed; else empty."""
    return commit_of(Path(__file__).parents[2])


def commit_of(folder: Path) -> str:
    """Commit of a checkout of this package, `+` where it was changed; empty where it is none."""
    if not (folder / ".git").exists():
        return ""
    git = ["git", "-C", str(folder)]
    try:
        commit = subprocess.run(
            [*git, "rev-parse", "--short=10", "HEAD"], capture_output=True, text=True, check=True
        )
        changed = subprocess.run(
            [*git, "status", "--porcelain", "--untracked-files=no", "deep_curiosity", "envs"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return ""
    return commit.stdout.strip() + ("+" if changed.stdout else "")
