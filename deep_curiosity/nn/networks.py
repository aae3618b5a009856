"""Networks whose weights carry a leading axis of members, and Adam, which steps them."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import torch
from jaxtyping import Bool, Float, Int, Shaped
from torch import Tensor, nn
from torch.nn.functional import layer_norm as normalize_layer
from torch.nn.functional import pad
from torch.optim.adam import adam

from deep_curiosity.transitions import check_counts

ALL = slice(None)
MEAN_DECAY, SQUARE_DECAY, EPSILON = 0.9, 0.999, 1e-8


class StackedLinear(nn.Module):
    """Several linear layers of one shape, applied in one batched product.

    Args:
        members: Number of layers stacked along the leading axis.
        in_features: Size of each input.
        out_features: Size of each output.
    """

    def __init__(self, members: int, in_features: int, out_features: int) -> None:
        super().__init__()
        bound = 1 / math.sqrt(in_features)  # as torch.nn.Linear samples its own
        self.weight = nn.Parameter(
            torch.empty(members, in_features, out_features).uniform_(-bound, bound)
        )
        self.bias = nn.Parameter(torch.empty(members, 1, out_features).uniform_(-bound, bound))

    def forward(
        self, value: Float[Tensor, "members batch in_features"]
    ) -> Float[Tensor, "members batch out_features"]:
        """Apply each member's layer to its own batch."""
        # the bias apart, which a graph adds for nothing; `baddbmm` would first copy it to all rows
        return torch.bmm(value, self.weight) + self.bias


class StackedMLP(nn.Module):
    """Several multilayer perceptrons of one shape, one batched product per layer.

    Args:
        members: Number of networks.
        in_features: Size of each input.
        hidden_dims: Width of every hidden layer.
        out_features: Size of each output.
        normalized: Number of networks, the first ones, of which every hidden layer is brought to
            mean 0 and standard deviation 1 before it is cut.
    """

    layers: Sequence[StackedLinear]

    def __init__(
        self,
        members: int,
        in_features: int,
        hidden_dims: Sequence[int],
        out_features: int,
        *,
        normalized: int = 0,
    ) -> None:
        super().__init__()
        check_hidden_dims(hidden_dims)
        check_counts(members=members, in_features=in_features)
        self.normalized = normalized
        widths = [in_features, *hidden_dims, out_features]
        self.members = members
        self.layers = nn.ModuleList(  # type: ignore[assignment]  # of linear layers
            StackedLinear(members, *pair) for pair in pairwise(widths)
        )

    def forward(
        self,
        value: Float[Tensor, "batch in_features"] | Float[Tensor, "members batch in_features"],
        some: slice = ALL,
    ) -> Float[Tensor, "members batch out_features"]:
        """Apply every member, or some of them, to one shared batch, or each to its own."""
        if value.ndim == 2:  # a product would copy what is expanded
            value = value.repeat(len(self.layers[0].weight[some]), 1, 1)
        *hidden, last = self.layers  # written out, as it is done most often of all
        normalized = len(range(self.normalized)[some])
        for layer in hidden:
            value = torch.bmm(value, layer.weight[some]) + layer.bias[some]
            if normalized:
                first, rest = value.tensor_split([normalized])
                value = torch.cat([normalize_layer(first, first.shape[-1:]), rest])
            value = torch.relu(value)
        weight, bias = last.weight[some], last.bias[some]
        if weight.shape[-1] == 1:  # a product with one column is dearer than a weighted sum
            return (value * weight.mT).sum(-1, keepdim=True) + bias
        return torch.bmm(value, weight) + bias

    def hidden(
        self,
        value: Float[Tensor, "batch in_features"] | Float[Tensor, "members batch in_features"],
    ) -> Float[Tensor, "members batch hidden_dim"]:
        """Input of the last layer: the activations before it."""
        if value.ndim == 2:
            value = value.repeat(self.members, 1, 1)
        for layer in self.layers[:-1]:
            value = layer(value)
            if self.normalized:
                first, rest = value.tensor_split([self.normalized])
                value = torch.cat([normalize_layer(first, first.shape[-1:]), rest])
            value = torch.relu(value)
        return value


def check_hidden_dims(hidden_dims: Any) -> None:
    """Reject what are no widths of layers.

    Raises:
        TypeError: If they are no sequence of whole numbers.
        ValueError: If one is below 1.
    """
    if not isinstance(hidden_dims, Sequence) or isinstance(hidden_dims, str):
        raise TypeError(f"`hidden_dims` must be a sequence of widths, got {hidden_dims!r}.")
    for width in hidden_dims:
        check_counts(hidden_dims=width)


def assign_rows(
    num_rows: int, members: int, device: torch.device
) -> tuple[Int[Tensor, "members rows"], Bool[Tensor, "members rows"]]:
    """Share rows out among members: row `r` is for member `r % members`.

    Returns:
        The rows of each member, the last ones repeating the first where the division leaves a
        rest, and whether each entry is no such repetition.
    """
    number = torch.arange(-(-num_rows // members), device=device)
    row = torch.arange(members, device=device).unsqueeze(1) + members * number
    return row % num_rows, row < num_rows


def restore_order(
    value: Shaped[Tensor, "members rows *rest"], num_rows: int
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

    A compiled graph computes only the gradients that are used, and needs no freezing. Within a
    transform of `torch.func`, where no flag may be changed, others take the parameters' places.
    """
    if torch.compiler.is_compiling():
        yield
        return
    if torch._C._are_functorch_transforms_active():
        with _detached(module):
            yield
        return
    parameters = []
    for parameter in module.parameters():
        if parameter.requires_grad:
            parameter.requires_grad_(False)
            parameters.append(parameter)
    try:
        yield
    finally:
        for parameter in parameters:
            parameter.requires_grad_(True)


@contextmanager
def _detached(module: nn.Module) -> Iterator[None]:
    """Put tensors without a gradient in the places of a module's parameters for a while."""
    places = [part._parameters for part in module.modules()]
    before = [dict(place) for place in places]
    try:
        for place in places:
            detached = {name: each.detach() for name, each in place.items() if each is not None}
            place.update(detached)  # type: ignore[arg-type]  # where only parameters are set
        yield
    finally:
        for place, own in zip(places, before, strict=True):
            place.update(own)


@contextmanager
def evaluating(module: nn.Module) -> Iterator[None]:
    """Hold batch normalisation and dropout still, and leave each layer in the mode it was in."""
    modes = {part: part.training for part in module.modules()}
    module.eval()
    try:
        yield
    finally:
        for part, mode in modes.items():
            part.training = mode


class Adam(nn.Module):
    """Adam over the parameters of one part. Its state lies in buffers, and moves and saves so.

    Gradients are computed by parameter and never accumulate: a loss may pass through other parts
    and leaves no trace in them, and `torch.compile` can take the whole step into its graph.

    Args:
        parameters: What is stepped, in place. Where others take their place in the part, as by
            `load_state_dict(..., assign=True)`, it must be told so by `replace_targets`; an agent
            and a `BonusLearner` tell it where they are loaded as a whole.
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
        root = math.sqrt(1 - SQUARE_DECAY)  # bias corrections of the first step
        self.step_size.fill_(learning_rate * root / (1 - MEAN_DECAY))
        self.epsilon.fill_(EPSILON * root)

    def step(self, loss: Tensor) -> None:
        """Take one step down the gradient of a loss.

        Raises:
            ValueError: If the loss does not depend on every parameter.
        """
        # a graph is made of this as torch has it by default, and says so itself
        allow_unused = not torch.compiler.is_compiling()
        gradients = torch.autograd.grad(loss, self.targets, allow_unused=allow_unused)
        means, squares = [], []
        for number in range(len(self.targets)):
            if gradients[number] is None:
                raise ValueError(
                    "`loss` must depend on every parameter that is stepped, got one that "
                    f"leaves out number {number} of {len(self.targets)}: after "
                    "`load_state_dict(..., assign=True)` of a part, call `replace_targets`."
                )
            means.append(getattr(self, f"mean_{number}"))
            squares.append(getattr(self, f"square_{number}"))
        with torch.no_grad():
            if torch.compiler.is_compiling():
                self._step_in_graph(gradients, means, squares)
            else:
                adam(
                    self.targets,
                    list(gradients),
                    means,
                    squares,
                    [],
                    list(self.count.float().repeat(len(self.targets))),
                    fused=True,
                    amsgrad=False,
                    beta1=MEAN_DECAY,
                    beta2=SQUARE_DECAY,
                    lr=self.learning_rate,
                    weight_decay=0.0,
                    eps=EPSILON,
                    maximize=False,
                )
            self.count.copy_(self.count + 1)
            # bias corrections of the step to come, ahead of it: a graph then reads two numbers,
            # where inside the step they would be worked out again for every parameter
            count = self.count + 1
            root = (-torch.expm1(count * math.log(SQUARE_DECAY))).sqrt()
            mean_share = -torch.expm1(count * math.log(MEAN_DECAY))
            self.step_size.copy_(self.learning_rate * root / mean_share)
            self.epsilon.copy_(EPSILON * root)

    def replace_targets(self, parameters: Iterable[nn.Parameter]) -> None:
        """Step others from now on, which have taken the place of those before one by one.

        Args:
            parameters: In the order in which the others were given, of the same shapes.

        Raises:
            AttributeError: If they are others, and those before are part of a compiled update.
        """
        targets: list[Tensor] = list(parameters)
        if any(new is not old for new, old in zip(targets, self.targets, strict=True)):
            self.targets = targets

    def _step_in_graph(
        self, gradients: tuple[Tensor, ...], means: list[Tensor], squares: list[Tensor]
    ) -> None:
        """The same in the paper's cheaper order of computation, end of its section 2."""
        # in float64, torch 2.13 would lose what a graph writes to a tensor without dimensions
        assert self.count.dtype == torch.float32, "only float32 can be compiled"
        torch._foreach_lerp_(means, gradients, 1 - MEAN_DECAY)
        torch._foreach_mul_(squares, SQUARE_DECAY)
        torch._foreach_addcmul_(squares, gradients, gradients, value=1 - SQUARE_DECAY)
        roots = torch._foreach_sqrt(squares)
        torch._foreach_add_(roots, self._read(self.epsilon))
        steps = torch._foreach_div(means, roots)
        torch._foreach_mul_(steps, self._read(self.step_size))
        torch._foreach_sub_(self.targets, steps)

    def _read(self, number: Tensor) -> Any:
        """A number for every parameter: read at once on a CPU, never waited for on a GPU."""
        return [number] * len(self.targets) if number.is_cuda else number
