"""Adam as a module: one fused call in eager mode, part of the graph where compiled."""

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.optim.adam import adam


class Adam(nn.Module):
    """Adam over the parameters of one part. Its state lies in buffers, and moves and saves so.

    Gradients are asked for by parameter and never accumulate: a loss may pass through other parts
    and leaves no trace in them, and `torch.compile` can take the whole step into its graph.

    Args:
        parameters: What is stepped, in place.
        learning_rate: Step size.

    Reference: Kingma & Ba, "Adam: A Method for Stochastic Optimization" (2015).
    """

    def __init__(self, parameters: Iterable[nn.Parameter], learning_rate: float) -> None:
        super().__init__()
        self.targets: list[Tensor] = list(parameters)  # a plain list: they belong to the part, not to Adam
        self.learning_rate = learning_rate
        for number, parameter in enumerate(self.targets):
            self.register_buffer(f"mean_{number}", torch.zeros_like(parameter))
            self.register_buffer(f"square_{number}", torch.zeros_like(parameter))
            self.register_buffer(f"count_{number}", torch.zeros((), device=parameter.device))

    def step(self, loss: Tensor) -> None:
        """Take one step down the gradient of a loss."""
        gradients = torch.autograd.grad(loss, self.targets)
        compiling = torch.compiler.is_compiling()
        with torch.no_grad():
            adam(
                self.targets,
                list(gradients),
                self._state("mean"),
                self._state("square"),
                [],
                self._state("count"),
                foreach=compiling,
                fused=not compiling,
                capturable=compiling,
                amsgrad=False,
                beta1=0.9,
                beta2=0.999,
                lr=self.learning_rate,
                weight_decay=0.0,
                eps=1e-8,
                maximize=False,
            )

    def _state(self, name: str) -> list[Tensor]:
        return [getattr(self, f"{name}_{number}") for number in range(len(self.targets))]
