"""Matrix products of a compiled update on a CPU, without what torch's own wrap around each."""

from pathlib import Path
from typing import Any

import torch

from deep_curiosity.speed.precision import matmul_is_float32

INSTRUCTIONS = ("AVX2", "AVX512")  # for which torch writes the kernel, at run time


def direct_matmul() -> dict[str, Any]:
    """Options of torch's compiler for them, none where torch's own products do other work.

    That is where `torch.set_float32_matmul_precision` is set to less than float32, where threads
    share a product, and on CPUs the kernel is not for.
    """
    applies = (
        matmul_is_float32()
        and torch.get_num_threads() == 1
        and torch.backends.cpu.get_cpu_capability() in INSTRUCTIONS
    )
    if not applies:
        return {}
    # what is meant to declare functions beside torch's stands at the head of the code, after an
    # `extern`: there it can define one, which takes the place of torch's
    definition = Path(__file__).with_suffix(".cpp").read_text()
    # the comment keeps apart what a cache holds of the CPUs that share it
    head = f"// {torch.backends.cpu.get_cpu_capability()}"
    return {"aot_inductor.custom_ops_to_c_shims": Definitions(f'"C++" {{ {head}\n{definition}}}')}


class Definitions(dict[Any, list[str]]):
    """What takes the place of an operation, by the operation, pickled by its text alone.

    Torch's cache of compiled graphs has a key of all options that can be pickled; for an operation
    it has none, and would compile the same update anew in every process.

    Args:
        text: Of the batched product.
    """

    def __init__(self, text: str) -> None:
        super().__init__({torch.ops.aten.bmm.default: [text]})
        self._text = text

    def __reduce__(self) -> tuple[type["Definitions"], tuple[str]]:
        return Definitions, (self._text,)
