"""Policies that leave the house: as ONNX, as a torch program, or as safetensors with settings."""

import io
import logging
import secrets
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from torch import Tensor, nn

from deep_curiosity.configuration import as_path
from deep_curiosity.requirements import require
from deep_curiosity.trained.policy import ActionBounds, TrainedPolicy
from deep_curiosity.trained.source import (
    BONUS_WEIGHTS,
    SCALING_PREFIX,
    USUAL_OBSERVATION,
    Trained,
    Weights,
    read_trained,
)
from deep_curiosity.training.log import CONFIG, WEIGHTS, write_json, written_whole
from deep_curiosity.training.outliers import LIMIT
from deep_curiosity.training.spaces import SPACES
from deep_curiosity.transitions import check_flags

Format = Literal["onnx", "torch", "safetensors"]
FORMATS: dict[str, Format] = {".onnx": "onnx", ".pt2": "torch"}
"""By the ending of a file; a folder is of safetensors."""
OPSET = 18  # the lowest that torch's exporter writes without converting
OF_A_MACHINE = ("out", "device", "init_from", "init_replay", "threads", "matmul_precision")
"""Settings that mean nothing where the files are read."""


class Actor(nn.Module):
    """One policy of a run as a plain network: observations in, actions of the task out.

    Args:
        policy: Of the run.
        curious: Take the curious policy, in the place of the greedy one.
    """

    low: Tensor
    high: Tensor
    usual_observation: Tensor | None

    def __init__(self, policy: TrainedPolicy, *, curious: bool = False) -> None:
        super().__init__()
        network, number = policy.network, -1 if curious else 0
        self.layers = nn.ModuleList(
            _linear(layer.weight[number], layer.bias[number, 0])
            for layer in network.network.layers
        )
        self.scaling = policy.scaling
        self.action_dim = network.action_dim
        self.components = network.mixture_components
        usual = policy.usual_observation
        self.register_buffer(USUAL_OBSERVATION, None if usual is None else usual.float())
        exact = policy.spaces.action_dtype == "float64"  # whose bounds float32 may not tell apart
        dtype = torch.float64 if exact else torch.float32
        self.register_buffer("low", torch.tensor(policy.spaces.action_low, dtype=dtype))
        self.register_buffer("high", torch.tensor(policy.spaces.action_high, dtype=dtype))

    def forward(self, observation: Tensor, hunger: Tensor | None = None) -> Tensor:
        """Centre of the policy, in units of the task.

        Args:
            observation: `(batch, observation_dim)`; windows where the run stacked frames, whose
                actions lie in [-1, 1].
            hunger: `(batch, 1)`, of a run that is conditioned on it.
        """
        value = self._cut(observation)
        value = value if self.scaling is None else self.scaling(value)
        value = value if hunger is None else torch.cat([value, hunger], dim=-1)
        for layer in self.layers[:-1]:
            value = torch.relu(layer(value))
        action = torch.tanh(self._centre(self.layers[-1](value))).to(self.low.dtype)
        rescaled = self.low + (self.high - self.low) * (action + 1) / 2
        return torch.minimum(torch.maximum(rescaled, self.low), self.high)

    def _cut(self, observation: Tensor) -> Tensor:
        """What is absurd at its usual size, as `predict` takes it."""
        usual = self.usual_observation
        if usual is None:
            return observation
        absurd = observation.abs() > LIMIT * usual
        return torch.where(absurd, observation.sign() * usual, observation)

    def _centre(self, output: Tensor) -> Tensor:
        """Mean of the weightiest component."""
        width = 2 * self.action_dim
        if self.components == 1:
            return output[:, : self.action_dim]
        means = output[:, : width * self.components].unflatten(-1, (self.components, width))
        others = output[:, width * self.components :]
        logits = torch.cat([torch.zeros_like(others[:, :1]), others], dim=-1)
        chosen = logits.argmax(-1, keepdim=True).unsqueeze(-1).expand(-1, 1, self.action_dim)
        return means[..., : self.action_dim].gather(1, chosen).squeeze(1)


def export(
    folder: str | Path,
    out: str | Path,
    *,
    format: Format | None = None,
    curious: bool = False,
    action_bounds: ActionBounds | None = None,
) -> Path:
    """Write the policy of a run for use elsewhere.

    A file of ONNX or of torch takes `observation`, `(batch, observation_dim)` in float32, and
    behind it `hunger`, `(batch, 1)`, of a run that is conditioned on it; it gives `action`,
    `(batch, action_dim)`, the centre of the policy in units of the task, in float64 where its
    action space is and else in float32. A folder of safetensors
    holds the settings, both policies, and models and statistics of the bonus: `load`, `load_model`
    and `load_bonus` read it.

    Args:
        folder: Of a finished or interrupted run, or of an export of safetensors.
        out: A file ending in .onnx or .pt2, or the name of a folder.
        format: By default as `out` ends: `"onnx"`, `"torch"` for .pt2, and `"safetensors"` for a
            folder.
        curious: Take the curious policy; a folder holds both anyway.
        action_bounds: As for `load`.

    Returns:
        What was written.

    Raises:
        FileExistsError: If there is something of this name.
        ImportError: If what the format needs is missing.
        OSError: If it cannot be written; nothing is left of it.
        TypeError: If `folder` or `out` is no path, or `curious` neither True nor False.
        ValueError: If the format is unknown, or the run has no curious policy of its own.
    """
    check_flags(curious=curious)
    out = as_path("out", out)
    chosen = format or _format_of(out)
    if chosen not in get_args(Format):
        raise ValueError(f"`format` must be one of {', '.join(get_args(Format))}, got {chosen!r}.")
    if out.exists():
        raise FileExistsError(f"`out` must not be there yet, got {out}.")
    trained = read_trained(folder)
    policy = TrainedPolicy(trained, action_bounds)
    if curious and (chosen == "safetensors" or not policy.has_curious_policy):
        raise ValueError(
            "`curious` must be False for a run with one policy, and for a folder of safetensors, "
            f"which holds both, got True for {folder}."
        )
    with _new_place(out) as partial:
        if chosen == "safetensors":
            _write_folder(trained, policy, partial)
        elif chosen == "onnx":
            _write_onnx(Actor(policy, curious=curious).eval(), _example(policy), partial)
        else:
            _write_program(Actor(policy, curious=curious).eval(), _example(policy), partial)
    return out


@contextmanager
def _new_place(out: Path) -> Iterator[Path]:
    """Path of what takes the place of `out` once it is written whole; errors name the argument."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(out, mark=f"{secrets.token_hex(4)}.partial") as partial:
            yield partial
    except OSError as error:
        raise OSError(f"`out` must be where all can be written, got {out}: {error}") from error


def _format_of(out: Path) -> Format:
    """Format that the ending of a name stands for; a folder has none, or a number as in v1.2."""
    ending = out.suffix.lower()
    if ending in FORMATS:
        return FORMATS[ending]
    if ending[1:2].isalpha():
        raise ValueError(
            f"`out` must end in {' or '.join(FORMATS)}, or name a folder without an ending, got "
            f"{out}; or say which `format`."
        )
    return "safetensors"


def _linear(weight: Tensor, bias: Tensor) -> nn.Linear:
    layer = nn.Linear(*weight.shape)
    layer.load_state_dict({"weight": weight.mT.contiguous(), "bias": bias})
    return layer.requires_grad_(False)


def _example(policy: TrainedPolicy) -> dict[str, Tensor]:
    """Inputs of the right sizes."""
    input_dim = policy.network.network.layers[0].weight.shape[1]
    batch = 2  # torch takes a batch of one for a constant
    hunger = {"hunger": torch.ones(batch, 1)} if policy.is_conditioned else {}
    return {"observation": torch.zeros(batch, input_dim - len(hunger))} | hunger


def _write_program(actor: Actor, example: dict[str, Tensor], out: Path) -> None:
    program = torch.export.export(actor, (), example, dynamic_shapes=_batch_sizes(example))
    buffer = io.BytesIO()  # torch's own writer ends the process where the disk is full
    torch.export.save(program, buffer)
    out.write_bytes(buffer.getbuffer())


def _write_onnx(actor: Actor, example: dict[str, Tensor], out: Path) -> None:
    require("onnx", "onnxscript", extra="export")
    with _quiet_exporter():
        torch.onnx.export(
            actor,
            (),
            str(out),
            kwargs=example,
            input_names=list(example),
            output_names=["action"],
            dynamic_shapes=_batch_sizes(example),
            opset_version=OPSET,
            external_data=False,
            dynamo=True,
            verbose=False,
        )


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Keep from a user what torch's exporter says of itself, and of packages it can do without.

    Errors come through.
    """
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)


def _batch_sizes(example: dict[str, Tensor]) -> dict[str, Any]:
    batch = torch.export.Dim("batch")
    return {name: {0: batch} for name in example}


def _write_folder(trained: Trained, policy: TrainedPolicy, out: Path) -> None:
    require("safetensors", extra="export")
    from safetensors.torch import save_file

    out.mkdir()
    settings = trained.config.to_json()
    kept = {name: value for name, value in settings.items() if name not in OF_A_MACHINE}
    write_json(out / CONFIG, kept)
    write_json(out / SPACES, policy.spaces.to_json())
    scaling = {SCALING_PREFIX + name: value for name, value in trained.scaling.items()}
    usual = trained.usual_observation
    sizes = {} if usual is None else {USUAL_OBSERVATION: usual}
    save_file(_contiguous(trained.policy | scaling | sizes), out / WEIGHTS)
    if trained.bonus:
        save_file(_contiguous(trained.bonus), out / BONUS_WEIGHTS)


def _contiguous(weights: Weights) -> Weights:
    """Copies, since safetensors refuses tensors that share memory."""
    return {name: value.detach().clone().contiguous() for name, value in weights.items()}
