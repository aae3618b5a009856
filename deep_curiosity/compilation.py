"""Compiling an update into one graph: losses, their gradients and the optimisers' steps."""

from collections.abc import Callable
from functools import wraps
from inspect import ismethod
from types import FunctionType, MethodType
from typing import Any, ParamSpec, TypeVar

import torch

Inputs = ParamSpec("Inputs")
Output = TypeVar("Output")
WARM_UP = 3  # calls in which the graph is traced and settles


def compiled(
    function: Callable[Inputs, Output],
    *,
    device: str | torch.device = "cpu",
    fall_back: bool = False,
) -> Callable[Inputs, Output]:
    """Compile a function that takes gradients and steps optimisers inside.

    Random numbers are drawn as in eager mode, so that a seed means the same in both. After the
    first calls nothing is checked any more: shapes, kinds and attributes must stay as they were.

    Args:
        function: Free of Python that looks at values of tensors.
        device: Where all tensors are. On a GPU torch is asked for a CUDA graph, whose outputs live
            until the next call.
        fall_back: Run the function as it is where it cannot be compiled; otherwise torch's error
            is raised.
    """
    graph = torch.compile(
        _copied(function), fullgraph=True, dynamic=False, options=_options(device)
    )
    calls, failed = 0, False

    @wraps(function)
    def run(*args: Inputs.args, **kwargs: Inputs.kwargs) -> Output:
        nonlocal calls, failed
        calls += 1
        if failed:
            return function(*args, **kwargs)
        if calls > WARM_UP:
            with torch.compiler.set_stance("default", skip_guard_eval_unsafe=True):
                return graph(*args, **kwargs)
        try:
            return _traced(graph, *args, **kwargs)
        except Exception as error:
            if not fall_back:
                raise
            failed = True
            name = getattr(function, "__name__", "function")
            print(f"{name} runs uncompiled: {type(error).__name__}")
            return function(*args, **kwargs)

    return run


def _copied(function: Callable[Inputs, Output]) -> Callable[Inputs, Output]:
    """The same function with code of its own.

    Torch keeps graphs with the code of a function and gives up after some; of the many agents that
    a process may train, each would otherwise count against the others.
    """
    plain: Any = function.__func__ if ismethod(function) else function
    code = plain.__code__.replace()
    copy = FunctionType(
        code, plain.__globals__, plain.__name__, plain.__defaults__, plain.__closure__
    )
    copy.__kwdefaults__ = plain.__kwdefaults__
    return MethodType(copy, function.__self__) if ismethod(function) else copy


def _traced(
    graph: Callable[Inputs, Output], *args: Inputs.args, **kwargs: Inputs.kwargs
) -> Output:
    """Call with gradients allowed inside the graph, an option that torch keeps off by default."""
    from torch._dynamo import config  # loaded on request: it takes seconds

    with config.patch(trace_autograd_ops=True):
        return graph(*args, **kwargs)


def _options(device: str | torch.device) -> dict[str, Any]:
    options: dict[str, Any] = {"fallback_random": True}
    if torch.device(device).type == "cuda":
        options |= {
            "triton.cudagraphs": True,
            "graph_partition": False,
            # torch 2.11 trips over its own assertion where it tries other orders of loops
            "loop_ordering_after_fusion": False,
        }
    return options
