"""Where the runs of a study are computed: this machine, a Ray cluster, Slurm, any executor."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deep_curiosity.configuration import Group, as_path, setting
from deep_curiosity.experiments.engines.base import Engine
from deep_curiosity.experiments.engines.local import LocalEngine
from deep_curiosity.experiments.engines.ray import RayEngine
from deep_curiosity.experiments.engines.slurm import SlurmEngine
from deep_curiosity.experiments.tables import check_runs
from deep_curiosity.training.command_line import read_settings


@dataclass(frozen=True, kw_only=True)
class EngineArgs(Group):
    """Options of a command whose runs are given to an engine."""

    engine: Literal["local", "ray", "slurm"] = "local"
    """Where runs are computed: by processes of this machine, tasks of Ray, or jobs of Slurm."""
    workers: int = setting(2, at_most=1_024)
    """Processes at a time, on the local engine; Ray and Slurm take what they have."""
    address: str | None = None
    """Of a running Ray cluster, such as auto; without it Ray is started on this machine."""
    engine_options: tuple[str, ...] = ()
    """Options of ray.init and runs_per_gpu, or of submitit's update_parameters and cluster, as
    name=value: slurm_partition=gpu timeout_min=600."""


def make_engine(args: EngineArgs, runs: str | Path) -> Engine:
    """The engine that a command line asks for.

    Args:
        args: The options.
        runs: Folder of the runs, below which Slurm keeps its files.

    Raises:
        ImportError: If its package is missing, with the command that installs it.
        TypeError: If `runs` is no path.
        ValueError: If an option is not one of the engine's.
    """
    runs = as_path("runs", runs).absolute()
    options = read_settings(args.engine_options, "engine_options")
    if args.engine != "ray" and args.address is not None:
        raise ValueError(f"`address` must be left out without the engine ray, got {args.address}.")
    if args.engine == "local":
        if options:
            raise ValueError(
                "`engine_options` must be left out for the engine local, "
                f"got {', '.join(options)}."
            )
        return LocalEngine(args.workers)
    try:
        if args.engine == "ray":
            return RayEngine(args.address, **options)
        check_runs(runs)
        return SlurmEngine(runs / "slurm", **options)
    except (ImportError, OSError):
        raise
    except Exception as error:  # each package has kinds of its own for what it does not take
        name = "engine_options" if options else "address"
        got = " ".join(args.engine_options) or args.address
        if got is None:
            raise
        raise ValueError(
            f"`{name}` must be what the engine {args.engine} takes, got {got}: {error}"
        ) from error
