"""Compiling an update into one graph: losses, their gradients and the optimisers' steps."""

from collections.abc import Callable
from functools import partial, wraps
from inspect import ismethod
from types import CodeType, FunctionType
from typing import Any, ParamSpec, TypeVar

import torch

from deep_curiosity.speed.matmul import direct_matmul

Inputs = ParamSpec("Inputs")
Output = TypeVar("Output")
WARM_UP = 3  # calls in which the graph is traced and settles
CPP_WRAPPER_SINCE = "2.13"  # torch before it has not been tried


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
    plain, owner = _apart(function)
    device = torch.device(device)
    graph = torch.compile(plain, fullgraph=True, dynamic=False, options=_options(device))
    settled: Callable[..., Output] | None = None
    calls = 0

    @wraps(function)
    def run(*args: Inputs.args, **kwargs: Inputs.kwargs) -> Output:
        nonlocal settled, calls
        if settled is not None:
            return settled(*args, **kwargs)
        calls += 1
        try:
            result = _traced(graph, *owner, *args, **kwargs)
        except Exception as error:
            if not fall_back:
                raise
            name = getattr(function, "__name__", "function")
            print(f"{name} runs uncompiled: {type(error).__name__}")
            settled = function
            return function(*args, **kwargs)
        if calls == WARM_UP:
            alone = _graph_alone(plain) if device.type == "cpu" else None
            settled = partial(alone or _unchecked(graph), *owner)
        return result

    return run


def _apart(function: Callable[..., Any]) -> tuple[FunctionType, tuple[Any, ...]]:
    """The same function with code of its own, and apart from it whose method it is, if anyone's.

    Torch keeps graphs with the code of a function and gives up after some; of the many agents that
    a process may train, each would otherwise count against the others.
    """
    plain: Any = function.__func__ if ismethod(function) else function
    copy = _with_code(plain, plain.__code__.replace())
    return copy, (function.__self__,) if ismethod(function) else ()


def _with_code(function: FunctionType, code: CodeType) -> FunctionType:
    copy = FunctionType(
        code,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    return copy


def _traced(graph: Callable[..., Output], *args: Any, **kwargs: Any) -> Output:
    """Call with gradients allowed inside the graph, an option that torch keeps off by default.

    What torch would otherwise note for profilers at every call takes a thirtieth of a millisecond.
    """
    from torch._dynamo import config  # loaded on request: it takes seconds

    with config.patch(trace_autograd_ops=True, record_runtime_overhead=False):
        return graph(*args, **kwargs)


def _graph_alone(function: FunctionType) -> FunctionType | None:
    """What torch runs in place of a function, where that is one graph and can be had.

    The function itself would be looked up at every call among all graphs that torch has made of
    it, which takes a third of a millisecond.
    """
    from torch._dynamo import eval_frame

    entries_of = getattr(eval_frame, "_debug_get_cache_entry_list", None)
    entries = entries_of(function.__code__) if entries_of else []
    return _with_code(function, entries[0].code) if len(entries) == 1 else None


def _unchecked(graph: Callable[..., Output]) -> Callable[..., Output]:
    """The graph, looked up at every call but checked no more."""

    def run(*args: Any, **kwargs: Any) -> Output:
        with torch.compiler.set_stance("default", skip_guard_eval_unsafe=True):
            return graph(*args, **kwargs)

    return run


def _options(device: torch.device) -> dict[str, Any]:
    from deep_curiosity.speed.deduplication import Deduplication  # on request: torch's compiler is big

    options: dict[str, Any] = {
        "fallback_random": True,
        "post_grad_custom_pre_pass": Deduplication(),
    }
    if device.type == "cuda":
        return options | {
            "triton.cudagraphs": True,
            "graph_partition": False,
            # torch 2.11 trips over its own assertion where it tries other orders of loops
            "loop_ordering_after_fusion": False,
        }
    if torch.__version__ < CPP_WRAPPER_SINCE:
        return options
    # what calls the kernels is C++ then, as they are
    return options | {"cpp_wrapper": True} | direct_matmul()
