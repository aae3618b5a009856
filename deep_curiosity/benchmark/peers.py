"""Other libraries' agents beside ours, where they are installed.

SBX is `pip install sbx-rl`. MaxInfoRL's SAC is in no package index: a clone of
https://github.com/sukhijab/maxinforl_torch brings `maxinforl_torch`, by `pip install -e .` in it.
"""

import importlib
import os
from collections.abc import Callable
from functools import partial
from importlib.metadata import packages_distributions, version
from importlib.util import find_spec
from typing import Any

from deep_curiosity.benchmark.runners import Runner, import_runner

SBX, MAX_INFO = "sbx", "maxinforl_torch"
ADDRESSES = {
    "SBX": (SBX, "deep_curiosity.benchmark.peers:make_sbx"),
    "MaxInfoSAC": (MAX_INFO, "deep_curiosity.benchmark.peers:make_max_info"),
}
"""Label of each to the package that it needs, and to what makes its runner."""
ONE_THREAD = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
ENSEMBLE: dict[str, Any] = {
    "learn_std": False,
    "features": (256, 256),
    "optimizer_kwargs": {"lr": 3e-4, "weight_decay": 0.0},
}
"""Of MaxInfoSAC, as its authors train it on dm_control."""


def installed_peers(env_id: str, hidden_dim: int = 256) -> dict[str, Callable[[], Runner]]:
    """What makes the runner of each peer that is installed, by its label with its version."""
    return {
        f"{label} {_version(package)}": partial(import_runner, address, env_id, hidden_dim)
        for label, (package, address) in ADDRESSES.items()
        if find_spec(package) is not None
    }


def make_sbx(env_id: str, hidden_dim: int = 256) -> Runner:
    """SBX's soft actor-critic, compiled by JAX, on one thread.

    Raises:
        ImportError: If SBX or Stable-Baselines3 is missing.
    """
    from deep_curiosity.benchmark.stable_baselines import StableBaselines

    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {ONE_THREAD}".strip()
    agent_class = importlib.import_module(SBX).SAC
    return StableBaselines(env_id, hidden_dim=hidden_dim, agent_class=agent_class)


def make_max_info(env_id: str, hidden_dim: int = 256) -> Runner:
    """MaxInfoRL's soft actor-critic, on Stable-Baselines3's, with torch's own precision.

    Raises:
        ImportError: If MaxInfoRL or Stable-Baselines3 is missing.
    """
    from deep_curiosity.benchmark.stable_baselines import StableBaselines

    agent_class = importlib.import_module(f"{MAX_INFO}.commons").MaxInfoSAC
    return StableBaselines(
        env_id,
        hidden_dim=hidden_dim,
        agent_class=agent_class,
        ensemble_model_kwargs=ENSEMBLE | {"features": (hidden_dim, hidden_dim)},
    )


def _version(package: str) -> str:
    """Of the distribution that brings a package; none where it lies on the path alone."""
    distributions = packages_distributions().get(package)
    return version(distributions[0]) if distributions else "of a clone"
