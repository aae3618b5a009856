"""Adam as a module: one fused call in eager mode, part of the graph where compiled."""

import math
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.adam import adam

MEAN_DECAY, SQUARE_DECAY, EPSILON = 0.9, 0.999, 1e-8


class Adam(nn.Module):
    """Adam over the parameters of one part. Its state lies in buffers, and moves and saves so.

    Gradients are asked for by parameter and never accumulate: a loss may pass through other parts
    and leaves no trace in them, and `torch.compile` can take the whole step into its graph.

    Args:
        parameters: What is stepped, in place.
        learning_rate: Step size.

    Reference: Kingma & Ba, "Adam: A Method for Stochastic Optimization" (2015).
    """

    count: Tensor
    step_size: Tensor
    epsilon: Tensor

    def __init__(self, parameters: Iterable[nn.Parameter], learning_rate: float) -> None:
        super().__init__()
        self.targets: list[Tensor] = list(parameters)  # not registered: the part has them
        self.learning_rate = learning_rate
        for number, parameter in enumerate(self.targets):
            self.register_buffer(f"mean_{number}", torch.zeros_like(parameter))
            self.register_buffer(f"square_{number}", torch.zeros_like(parameter))
        device = self.targets[0].device
        for name in ("count", "step_size", "epsilon"):
            self.register_buffer(name, torch.zeros((), dtype=torch.float32, device=device))
        self._correct_next()

    def step(self, loss: Tensor) -> None:
        """Take one step down the gradient of a loss."""
        gradients = torch.autograd.grad(loss, self.targets)
        with torch.no_grad():
            if torch.compiler.is_compiling():
                self._step_in_graph(gradients)
            else:
                self._step_fused(gradients)
            self.count.copy_(self.count + 1)
            self._correct_next()

    def _step_fused(self, gradients: tuple[Tensor, ...]) -> None:
        count = self.count.float()
        adam(
            self.targets,
            list(gradients),
            self._state("mean"),
            self._state("square"),
            [],
            [count.clone() for _ in self.targets],
            fused=True,
            amsgrad=False,
            beta1=MEAN_DECAY,
            beta2=SQUARE_DECAY,
            lr=self.learning_rate,
            weight_decay=0.0,
            eps=EPSILON,
            maximize=False,
        )

    def _step_in_graph(self, gradients: tuple[Tensor, ...]) -> None:
        """The same in the paper's cheaper order of computation, end of its section 2."""
        # in float64, torch 2.13 would lose what a graph writes to a tensor without dimensions
        assert self.count.dtype == torch.float32, "only float32 can be compiled"
        means, squares = self._state("mean"), self._state("square")
        torch._foreach_lerp_(means, gradients, 1 - MEAN_DECAY)
        torch._foreach_mul_(squares, SQUARE_DECAY)
        torch._foreach_addcmul_(squares, gradients, gradients, value=1 - SQUARE_DECAY)
        roots = torch._foreach_sqrt(squares)
        torch._foreach_add_(roots, self._read(self.epsilon))
        steps = torch._foreach_div(means, roots)
        torch._foreach_mul_(steps, self._read(self.step_size))
        torch._foreach_sub_(self.targets, steps)

    def _correct_next(self) -> None:
        """Bias corrections of the step to come, ahead of it: a graph then reads two numbers.

        Worked out inside the step, they would be worked out again for every parameter.
        """
        count = self.count + 1
        mean_share, square_share = (
            -torch.expm1(count * math.log(decay)) for decay in (MEAN_DECAY, SQUARE_DECAY)
        )
        root = square_share.sqrt()
        self.step_size.copy_(self.learning_rate * root / mean_share)
        self.epsilon.copy_(EPSILON * root)

    def _read(self, number: Tensor) -> Any:
        """A number for every parameter: read at once on a CPU, never waited for on a GPU."""
        return [number] * len(self.targets) if number.is_cuda else number

    def _state(self, name: str) -> list[Tensor]:
        return [getattr(self, f"{name}_{number}") for number in range(len(self.targets))]
