"""Computing once what a graph would compute twice, such as one pass that two parts need.

Torch does so for graphs of which it makes a forward and a backward part, not for one that has its
gradients inside.
"""

import operator
from typing import Any

import torch
from torch import fx
from torch._inductor.custom_graph_pass import CustomGraphPass, get_hash_for_files


class Deduplication(CustomGraphPass):
    """Pass over a graph of torch's own operations: equal ones of equal inputs become one.

    What samples random numbers stays apart, and so does what the graph returns.
    """

    def __call__(self, graph: fx.Graph) -> None:
        """Rewrite the graph in place."""
        returned = set(graph.output_node().all_input_nodes)
        first: dict[Any, fx.Node] = {}
        for node in graph.nodes:
            if node.op != "call_function" or node in returned or not _is_function(node.target):
                continue
            twin = first.setdefault(
                (node.target, _hashable(node.args), _hashable(node.kwargs)), node
            )
            if twin is not node:
                node.replace_all_uses_with(twin)
                graph.erase_node(node)

    def uuid(self) -> Any:
        """What torch's cache of compiled graphs knows the pass by.

        The CPU is part of it: of a cache that machines share torch would take code whose steps are
        as wide as another's registers, and what that computes is not a number.
        """
        return get_hash_for_files((__file__,)), torch.backends.cpu.get_cpu_capability()


def _is_function(target: Any) -> bool:
    """Whether equal inputs give equal outputs, and no input is written to."""
    if not isinstance(target, torch._ops.OpOverload):
        return target is operator.getitem
    is_random = torch.Tag.nondeterministic_seeded in target.tags
    return not is_random and not target._schema.is_mutable


def _hashable(value: Any) -> Any:
    """Arguments as a key; numbers as written, since 1 is 1.0 and 0.0 is -0.0 to Python."""
    if isinstance(value, dict):
        return tuple((name, _hashable(item)) for name, item in value.items())
    if isinstance(value, list | tuple):
        return tuple(map(_hashable, value))
    return repr(value) if isinstance(value, int | float) else value
