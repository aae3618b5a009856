"""Compiling an update into one graph: losses, their gradients and the optimisers' steps."""

from collections.abc import Callable
from functools import cache, partial, wraps
from inspect import ismethod
from types import CodeType, FunctionType
from typing import Any, ParamSpec, TypeVar

import torch
from torch import nn

from deep_curiosity.speed.config import SpeedConfig
from deep_curiosity.speed.matmul import direct_matmul

Inputs = ParamSpec("Inputs")
Output = TypeVar("Output")
WARM_UP = 3  # calls in which the graph is traced and settles
CPP_WRAPPER_SINCE = "2.13"  # torch before it has not been tried


def compiled(
    function: Callable[Inputs, Output],
    *,
    speed: SpeedConfig | None = None,
    fall_back: bool = False,
) -> Callable[Inputs, Output]:
    """Compile a function that takes gradients and steps optimisers inside.

    Random numbers are sampled as in eager mode, so that a seed means the same in both. After the
    first calls nothing is checked any more: shapes, kinds and attributes must stay as they were.
    To set an attribute of a module that belongs to the function's owner raises an error from then
    on, since the graph would not follow; parameters, buffers and properties may be set.

    Args:
        function: Free of Python that looks at values of tensors.
        speed: Where all tensors are, and what the compiler may do. On a GPU torch makes a
            CUDA graph, whose outputs live until the next call.
        fall_back: Run the function as it is where it cannot be compiled; otherwise torch's error
            is raised.
    """
    plain, owner = _apart(function)
    speed = SpeedConfig() if speed is None else speed
    device = torch.device(speed.device)
    graph = torch.compile(plain, fullgraph=True, dynamic=False, options=_options(speed))
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
            for each in owner:
                seal_modules(each)
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


def _options(speed: SpeedConfig) -> dict[str, Any]:
    options: dict[str, Any] = {"fallback_random": True}
    if speed.deduplicate:
        from deep_curiosity.speed.deduplication import (  # on request: torch's compiler is big
            Deduplication,
        )

        options["post_grad_custom_pre_pass"] = Deduplication()
    if torch.device(speed.device).type == "cuda":
        return options | {
            "triton.cudagraphs": True,
            "graph_partition": False,
            # torch 2.11 trips over its own assertion where it tries other orders of loops
            "loop_ordering_after_fusion": False,
        }
    if torch.__version__ < CPP_WRAPPER_SINCE:
        return options
    # what calls the kernels is C++ then, as they are
    return options | {"cpp_wrapper": True} | (direct_matmul() if speed.direct_matmul else {})


def seal_modules(owner: object) -> None:
    """Let the attributes of all modules that an object holds be set no more."""
    held = [owner] if isinstance(owner, nn.Module) else vars(owner).values()
    for module in held:
        if isinstance(module, nn.Module):
            for part in module.modules():
                part.__class__ = _sealed(type(part))  # type: ignore[arg-type]


@cache
def _sealed(kind: Any) -> Any:
    """A class like another whose instances refuse to have plain public attributes set."""
    if hasattr(kind, "_sealed_from"):
        return kind

    def refuse(module: nn.Module, name: str, value: Any) -> None:
        swallowed = name in vars(module) and not name.startswith("_") and name != "training"
        if swallowed:
            raise AttributeError(
                f"`{name}` of this {kind.__name__} is part of a compiled update, which would not "
                f"follow; set it before the first update, or compile nothing, got {value!r}."
            )
        kind.__setattr__(module, name, value)

    def unsealed(module: nn.Module) -> tuple[Any, ...]:
        return _blank, (kind,), vars(module)

    body = {"__setattr__": refuse, "_sealed_from": kind, "__reduce__": unsealed}
    return type(kind.__name__, (kind,), body)


def _blank(kind: type[nn.Module]) -> nn.Module:
    """An instance without state, of a class that pickle takes for the instance's own."""
    return kind.__new__(kind)
