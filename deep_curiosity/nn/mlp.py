"""Networks: one multilayer perceptron whose weights carry a leading axis of members."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn
from torch.nn.functional import pad


class StackedLinear(nn.Module):
    """Several linear layers of one shape, applied in one batched product.

    Args:
        members: Number of layers stacked along the leading axis.
        in_features: Size of each input.
        out_features: Size of each output.
    """

    def __init__(self, members: int, in_features: int, out_features: int) -> None:
        super().__init__()
        bound = 1 / math.sqrt(in_features)  # as torch.nn.Linear draws its own
        self.weight = nn.Parameter(
            torch.empty(members, in_features, out_features).uniform_(-bound, bound)
        )
        self.bias = nn.Parameter(torch.empty(members, 1, out_features).uniform_(-bound, bound))

    def forward(
        self, value: Float[Tensor, "members batch in_features"]
    ) -> Float[Tensor, "members batch out_features"]:
        """Apply each member's layer to its own batch."""
        if self.weight.shape[-1] == 1:  # a product with one column is dearer than a weighted sum
            return (value * self.weight.mT).sum(-1, keepdim=True) + self.bias
        # the bias apart, which a graph adds for nothing; `baddbmm` would first copy it to all rows
        return torch.bmm(value, self.weight) + self.bias


class StackedMLP(nn.Module):
    """Several multilayer perceptrons of one shape, one batched product per layer.

    Args:
        members: Number of networks.
        in_features: Size of each input.
        hidden_dims: Width of every hidden layer.
        out_features: Size of each output.
    """

    def __init__(
        self, members: int, in_features: int, hidden_dims: Sequence[int], out_features: int
    ) -> None:
        super().__init__()
        widths = [in_features, *hidden_dims, out_features]
        self.members = members
        self.layers = nn.ModuleList(StackedLinear(members, *pair) for pair in pairwise(widths))

    def forward(
        self,
        value: Float[Tensor, "batch in_features"] | Float[Tensor, "members batch in_features"],
    ) -> Float[Tensor, "members batch out_features"]:
        """Apply every member to one shared batch, or each member to its own."""
        return self.layers[-1](self.hidden(value))

    def hidden(
        self,
        value: Float[Tensor, "batch in_features"] | Float[Tensor, "members batch in_features"],
    ) -> Float[Tensor, "members batch hidden_dim"]:
        """What the last layer is told: the activations before it."""
        if value.ndim == 2:
            value = value.repeat(self.members, 1, 1)  # a product would copy what is expanded
        for layer in self.layers[:-1]:
            value = torch.relu(layer(value))
        return value


def assign_rows(
    num_rows: int, members: int, device: torch.device
) -> tuple[Int[Tensor, "members turns"], Bool[Tensor, "members turns"]]:
    """Share rows out among members: row `r` is for member `r % members`.

    Returns:
        The rows of each member, the last ones repeating the first where the division leaves a
        rest, and whether each entry is no such repetition.
    """
    turns = torch.arange(-(-num_rows // members), device=device)
    row = torch.arange(members, device=device).unsqueeze(1) + members * turns
    return row % num_rows, row < num_rows


def restore_order(
    value: Shaped[Tensor, "members turns *rest"], num_rows: int
) -> Shaped[Tensor, "num_rows *rest"]:
    """What members made of the rows that `assign_rows` gave them, in the order of the rows."""
    return value.transpose(0, 1).flatten(0, 1)[:num_rows]


def log_softmax_of_rest(
    logits: Float[Tensor, "*batch others"],
) -> Float[Tensor, "*batch others+1"]:
    """Log weights of alternatives of which the first has logit zero: one alone needs no logit."""
    if logits.shape[-1] == 0:
        return logits.new_zeros(*logits.shape[:-1], 1)
    return torch.log_softmax(pad(logits, (1, 0)), dim=-1)


@contextmanager
def frozen(module: nn.Module) -> Iterator[None]:
    """Let gradients pass through a module without reaching its parameters.

    A compiled graph computes only the gradients that are asked for, and needs no freezing.
    """
    if torch.compiler.is_compiling():
        yield
        return
    parameters = [parameter for parameter in module.parameters() if parameter.requires_grad]
    for parameter in parameters:
        parameter.requires_grad_(False)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)
