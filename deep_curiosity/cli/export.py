"""Write the policy of a run for use elsewhere: ONNX, torch.export, or a folder of safetensors."""
# ruff: noqa: E402  # what is missing is reported before anything needs it

from deep_curiosity.requirements import require_training

require_training()

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from deep_curiosity.arguments import read_arguments
from deep_curiosity.configuration import Group
from deep_curiosity.trained.export import export


@dataclass(frozen=True)
class Args(Group):
    """What to write, and where."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run."""
    out: Annotated[Path, tyro.conf.Positional]
    """A file ending in .onnx or .pt2, or the name of a folder for safetensors and settings."""
    curious: bool = False
    """Take the curious policy in the place of the greedy one; a folder holds both."""


def main(arguments: Sequence[str]) -> int:
    """Write it, and say where."""
    args = read_arguments(Args, arguments, description=__doc__, prog="deep-curiosity export")
    print(export(args.folder, args.out, curious=args.curious))
    return 0
