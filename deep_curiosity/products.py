"""Matrix products of a compiled update on a CPU, without what torch's own wrap around each."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor, fx
from torch._inductor.custom_graph_pass import CustomGraphPass, get_hash_for_files

from deep_curiosity.precision import matmul_is_float32

SOURCE = Path(__file__).with_suffix(".cpp")
INSTRUCTIONS = ("AVX2", "AVX512")  # of CPUs that the kernel is written for as the program runs


@torch.library.custom_op("deep_curiosity::product", mutates_args=())
def product(left: Tensor, right: Tensor) -> Tensor:
    """The product of two float32 matrices or batches of them; C++ where it is compiled."""
    return left @ right


@product.register_fake
def _(left: Tensor, right: Tensor) -> Tensor:
    return left @ right


class DirectProducts(CustomGraphPass):
    """Pass over a graph of torch's own operations: float32 products are handed to the kernel."""

    def __call__(self, graph: fx.Graph) -> None:
        """Rewrite the graph in place."""
        operations = torch.ops.aten
        for target in (operations.bmm.default, operations.mm.default):
            for node in graph.find_nodes(op="call_function", target=target):
                values = [source.meta["val"] for source in node.all_input_nodes]
                if all(value.dtype == torch.float32 and value.numel() for value in values):
                    node.target = torch.ops.deep_curiosity.product.default

    def uuid(self) -> Any:
        """What torch's cache of compiled graphs knows the pass by."""
        return get_hash_for_files((__file__, str(SOURCE)))


def direct_products() -> dict[str, Any]:
    """Options of torch's compiler for them, none where torch's own products do other work.

    That is where `torch.set_float32_matmul_precision` asks for less than float32, where threads
    share a product, and on CPUs the kernel is not for.
    """
    applies = (
        matmul_is_float32()
        and torch.get_num_threads() == 1
        and torch.backends.cpu.get_cpu_capability() in INSTRUCTIONS
    )
    if not applies:
        return {}
    operation = torch.ops.deep_curiosity.product.default
    definition = f'"C++" {{\n{SOURCE.read_text()}}}'  # torch puts it behind an `extern`
    return {
        "post_grad_custom_post_pass": DirectProducts(),
        "aot_inductor.custom_ops_to_c_shims": {operation: [definition]},
    }
