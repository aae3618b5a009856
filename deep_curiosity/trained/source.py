"""What is read of a folder, be it of a run or of a policy that was exported."""

from pathlib import Path
from typing import Any, NamedTuple

from torch import Tensor

from deep_curiosity.bonuses.config import BONUS_CONFIGS
from deep_curiosity.configuration import as_path
from deep_curiosity.requirements import require
from deep_curiosity.training.checkpoint import load_checkpoint, usual_observation_of
from deep_curiosity.training.config import Config
from deep_curiosity.training.log import CONFIG, WEIGHTS, read_values
from deep_curiosity.training.spaces import TaskSpaces, read_spaces

BONUS_WEIGHTS = "bonus.safetensors"
POLICY_PREFIX = "policy."
SCALING_PREFIX = "observation_scaling."
USUAL_OBSERVATION = "usual_observation"

Weights = dict[str, Tensor]


class Trained(NamedTuple):
    """Settings and weights of a run, on the CPU, without what only training needs."""

    folder: Path
    config: Config
    spaces: TaskSpaces | None
    """Of the task; `None` for a run that did not write them down."""
    policy: Weights
    scaling: Weights
    """What brings observations to a size; nothing where the policy sees them as they are."""
    bonus: Weights
    """Models and statistics of the bonus; nothing where there is no bonus."""
    usual_observation: Tensor | None
    """How large each entry usually is of what the policy is shown, a window where frames are
    stacked; `None` for a run, or an export, that is too old to say."""


Learned = tuple[Weights, Weights, Weights, Tensor | None]
"""The last four of `Trained`."""


def read_trained(folder: str | Path) -> Trained:
    """Read the newest checkpoint of a run, or a folder that `export` wrote.

    Settings that its version did not have yet are as they are by default.

    Raises:
        FileNotFoundError: If the folder holds neither, or no checkpoint that can be read.
        ImportError: If a folder that was exported is to be read, and safetensors is missing.
        TypeError: If the folder is no path.
        ValueError: If its settings are none.
    """
    folder = as_path("folder", folder)
    # where and how it was trained matters no more: the GPU may not be here
    values = read_values(folder) | {"device": "cpu", "out": str(folder)}
    config = Config.from_json(_with_younger(values), source=str(folder / CONFIG))
    learned = _read_export(folder) if (folder / WEIGHTS).exists() else _read_run(folder)
    return Trained(folder, config, read_spaces(folder), *learned)


def _with_younger(values: dict[str, Any]) -> dict[str, Any]:
    """Settings as they are written, and those that are younger than they by their defaults."""
    kind = values.get("bonus")
    return Config.of(bonus=kind).to_json() | values if kind in BONUS_CONFIGS else values


def _read_run(folder: Path) -> Learned:
    checkpoint = load_checkpoint(folder)
    agent, bonus = checkpoint["learner"]["agent"], checkpoint["learner"]["bonus"]
    policy, scaling = (_under(prefix, agent) for prefix in (POLICY_PREFIX, SCALING_PREFIX))
    return policy, scaling, bonus, usual_observation_of(checkpoint)


def _read_export(folder: Path) -> Learned:
    require("safetensors", extra="export")
    from safetensors.torch import load_file

    bonus = folder / BONUS_WEIGHTS
    weights = load_file(folder / WEIGHTS)
    usual = weights.pop(USUAL_OBSERVATION, None)
    scaling = _under(SCALING_PREFIX, weights)
    policy = {name: weights[name] for name in weights if not name.startswith(SCALING_PREFIX)}
    return policy, scaling, load_file(bonus) if bonus.exists() else {}, usual


def _under(prefix: str, weights: Weights) -> Weights:
    """Those whose name begins so, by the rest of it."""
    return {
        name.removeprefix(prefix): value
        for name, value in weights.items()
        if name.startswith(prefix)
    }
