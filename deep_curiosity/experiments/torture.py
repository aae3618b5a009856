"""Runs that are killed at random moments and continued, compared with one that is left in peace.

Nothing but children of this process is ever killed. Each attempt is a fork, so that what is
imported once serves all of them.
"""

import hashlib
import itertools
import json
import os
import random
import shutil
import signal
import time
import traceback
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from deep_curiosity.training import figures, loop
from deep_curiosity.training.checkpoint import has_checkpoint, load_checkpoint
from deep_curiosity.training.config import Config
from deep_curiosity.training.log import CONFIG, PROGRESS, read_progress

TIMED = ("time/steps_per_second",)
VARIANTS = tuple(itertools.product((1, 4), ("uniform", "learned")))
"""Numbers of environments, and priors."""
MAX_KILLS = 12
"""Of one run, which then comes to its end."""
PATIENCE = 120.0
"""Seconds after which an attempt counts as hanging."""


@dataclass
class Tally:
    """What was done to runs, and what came of it."""

    kills: int = 0
    chains: int = 0
    corrupt_checkpoints: int = 0
    failed_resumes: int = 0
    wrong_rows: int = 0
    unequal_chains: int = 0

    @property
    def faults(self) -> int:
        """Everything that must not be."""
        return (
            self.corrupt_checkpoints + self.failed_resumes + self.wrong_rows + self.unequal_chains
        )


def torture(folder: Path, *, kills: int, seed: int, seconds: float) -> dict[str, Tally]:
    """Kill runs so many times, or for so long, each until it has come to its end after all.

    Args:
        folder: Scratch, which is new; runs are deleted once they are compared.
        kills: SIGKILLs, over all variants.
        seed: Of the moments.
        seconds: After which no new chain is begun.

    Returns:
        A tally for each variant, by its name.
    """
    torch.set_num_threads(1)  # a pool of threads does not outlive a fork
    folder.mkdir(parents=True)
    chance, ends = random.Random(seed), time.monotonic() + seconds
    tallies: dict[str, Tally] = {}
    references = {}
    for number in itertools.count():
        done = sum(tally.kills for tally in tallies.values())
        if done >= kills or (time.monotonic() > ends and number >= len(VARIANTS)):
            return tallies
        num_envs, prior = VARIANTS[number % len(VARIANTS)]
        name = f"{num_envs} environments, {prior} prior"
        config = tortured_config(num_envs, prior)
        if name not in references:
            references[name] = _reference(config.override(out=folder / f"reference{number}"))
        left = min(kills - done, MAX_KILLS, -(-kills // len(VARIANTS)))
        run = config.override(out=folder / f"chain{number}")
        _chain(run, references[name], tallies.setdefault(name, Tally()), left, chance)
    raise AssertionError


def tortured_config(num_envs: int, prior: str) -> Config:
    """A run of half a second that trains, evaluates, logs and saves all the time."""
    return Config.of(
        env_id="ReacherSparse",
        num_envs=num_envs,
        prior=prior,
        total_steps=96,
        learning_starts=16,
        update_to_data=0.25,
        hidden_dim=8,
        batch_size=8,
        components=8,
        num_members=2,
        refresh_interval=3,
        log_interval=8,
        evaluation_interval=32,
        evaluation_episodes=1,
        checkpoint_interval=12,
        replay_capacity=500,
        matmul_precision="highest",
        compile="off",
    )


def _reference(config: Config) -> tuple[float, dict[str, str], list[dict[str, str]]]:
    """How long an uninterrupted run takes, and what it leaves."""
    started = time.monotonic()
    if _end(_begin(config), PATIENCE) != 0:
        raise RuntimeError(f"the uninterrupted run in {config.run.out} failed.")
    return time.monotonic() - started, *_left(config.run.out)


def _chain(
    config: Config,
    reference: tuple[float, dict[str, str], list[dict[str, str]]],
    tally: Tally,
    kills: int,
    chance: random.Random,
) -> None:
    """Kill a run up to so many times, let it end, and compare it with one that was not killed."""
    lasting, weights, rows = reference
    tally.chains += 1
    for _ in range(kills):
        if _end(_begin(config), chance.uniform(0.0, 0.7 * lasting)) is None:
            tally.kills += 1
        tally.corrupt_checkpoints += _corrupt(config.run.out)
        tally.wrong_rows += not _is_start(config.run.out, rows)
        if (config.run.out / "summary.json").exists():
            break
    if _end(_begin(config), PATIENCE) != 0:
        tally.failed_resumes += 1
        return
    left_weights, left_rows = _left(config.run.out)
    tally.unequal_chains += left_weights != weights
    tally.wrong_rows += left_rows != rows
    if tally.faults == 0:
        shutil.rmtree(config.run.out)


def _begin(config: Config) -> int:
    """Begin or continue a run in a fork; returns its process."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # newer Pythons warn of threads, which the child has none of
        process = os.fork()
    if process:
        return process
    status = 1
    try:
        with (config.run.out.parent / "output.txt").open("a") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
        warnings.simplefilter("error")  # nothing may be damaged
        figures.plot_run = _unplotted
        loop.train(config, resume=(config.run.out / CONFIG).exists(), show_progress=False)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def _unplotted(folder: Path) -> Path:
    """In place of a picture, which takes as long as the run."""
    return folder


def _end(process: int, seconds: float) -> int | None:
    """Exit status of a child that ends by itself in time; else it is killed, and `None`."""
    ends = time.monotonic() + seconds
    while time.monotonic() < ends:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(process, signal.SIGKILL)
    _, status = os.waitpid(process, 0)
    code = os.waitstatus_to_exitcode(status)
    return None if code == -signal.SIGKILL else code


def _corrupt(folder: Path) -> int:
    """Number of checkpoints that are there and cannot be read."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            if has_checkpoint(folder):
                load_checkpoint(folder)
        except (UserWarning, FileNotFoundError):
            return 1
    return 0


def _is_start(folder: Path, rows: list[dict[str, str]]) -> bool:
    """Whether progress.csv, but for a row that was being written, begins as it should."""
    path = folder / PROGRESS
    if not path.exists():
        return True
    whole = path.read_bytes().rpartition(b"\n")[0].decode()
    there = [line.split(",")[0] for line in whole.splitlines()[1:]]
    return there == [row["step"] for row in rows[: len(there)]]


def _left(folder: Path) -> tuple[dict[str, str], list[dict[str, str]]]:
    """Hashes of all that a run has learned and will do, and its rows, but for times."""
    state = load_checkpoint(folder)
    parts = {name: state[name] for name in ("learner", "collector", "metrics")}
    parts["run_log"] = {k: v for k, v in state["run_log"].items() if "seconds" not in k}
    rows = [
        {name: value for name, value in row.items() if name not in TIMED}
        for row in read_progress(folder)
    ]
    return {name: _digest(part) for name, part in parts.items()}, rows


def _digest(state: Any) -> str:
    """Hash of a nested state, its tensors by their bytes."""
    digest = hashlib.sha256()
    for path, leaf in _leaves(state):
        digest.update(path.encode())
        if isinstance(leaf, torch.Tensor):
            digest.update(leaf.contiguous().numpy().tobytes())
        else:
            digest.update(repr(leaf).encode())
    return digest.hexdigest()


def _leaves(state: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    items: Any = enumerate(state) if isinstance(state, list | tuple) else None
    items = state.items() if isinstance(state, dict) else items
    if items is None:
        yield path, state
        return
    for name, value in items:
        yield from _leaves(value, f"{path}/{name}")


def as_lines(tallies: dict[str, Tally]) -> str:
    """The tallies as lines of JSON."""
    return "\n".join(json.dumps({"variant": n} | vars(t)) for n, t in tallies.items())
