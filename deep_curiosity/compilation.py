"""Compiling an update as one graph: losses, their gradients and the optimisers' steps."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import torch

Inputs = ParamSpec("Inputs")
Output = TypeVar("Output")


def compiled(function: Callable[Inputs, Output]) -> Callable[Inputs, Output]:
    """Compile a function that takes gradients and steps optimisers inside.

    Random numbers are drawn as in eager mode, so that a seed means the same in both.

    Args:
        function: Free of Python that looks at values of tensors.
    """
    options: dict[str, Any] = {"fallback_random": True}
    if torch.cuda.is_available():
        options["triton.cudagraphs"] = True
    graph = torch.compile(function, fullgraph=True, dynamic=False, options=options)
    from torch._dynamo import config

    calls = [0]
    @wraps(function)
    def run(*args: Inputs.args, **kwargs: Inputs.kwargs) -> Output:
        calls[0] += 1
        if calls[0] > 3:
            with torch.compiler.set_stance("default", skip_guard_eval_unsafe=True):
                return graph(*args, **kwargs)
        with config.patch(trace_autograd_ops=True):
            return graph(*args, **kwargs)

    return run
