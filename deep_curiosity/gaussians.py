"""Diagonal Gaussians and their mixtures: densities, samples, entropies and divergences, in nats.

Model, marginal, policy and action prior all speak `DiagonalMixture`; the rest are pure functions.

The bounds of the divergence to a mixture are those of Hershey & Olsen, "Approximating the
Kullback Leibler divergence between Gaussian mixture models" (2007), and Kolchinsky & Tracey,
"Estimating mixture entropy with pairwise distances" (2017).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from inspect import signature, unwrap
from typing import Any, NamedTuple, ParamSpec, get_args

import torch
from jaxtyping import Float, Int, jaxtyped
from torch import Tensor

LEAST_LOG_WEIGHT = -1e30  # whose exponential is zero in any precision
LOG_TWO_PI = math.log(2 * math.pi)
MOST_AT_ONCE = 2**20  # numbers: some megabytes, as caches hold
Parameters = ParamSpec("Parameters")


def checked(function: Callable[Parameters, Tensor]) -> Callable[Parameters, Tensor]:
    """Let a function check arguments by their annotations, and refuse what leaves no number.

    Inside a compiled graph nothing is checked.

    Raises:
        TypeError: If an argument is no tensor of real numbers.
        ValueError: If one has a shape that is not its own or does not fit the others, or the
            answer is NaN, or infinite though all arguments are finite.
    """
    known = signature(function)

    @wraps(function)
    def door(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Tensor:
        if torch.compiler.is_compiling():
            return function(*args, **kwargs)
        given = known.bind(*args, **kwargs).arguments
        with jaxtyped("context"):  # axes of one name have one size
            for name, value in given.items():
                _check_tensor(name, value, known.parameters[name].annotation)
        answer = function(*args, **kwargs)
        _check_answer(answer, given)
        return answer

    return door


def _check_tensor(name: str, value: Any, annotation: Any) -> None:
    """Reject what is not as annotated."""
    if isinstance(value, annotation):
        return
    axes = [
        each.dim_str for each in (annotation, *get_args(annotation)) if hasattr(each, "dim_str")
    ]
    if not axes:
        raise TypeError(f"`{name}` must be a {annotation.__name__}, got {value!r}.")
    if not isinstance(value, Tensor) or not value.is_floating_point():
        kind = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"`{name}` must be a tensor of real numbers, got {kind}.")
    raise ValueError(
        f"`{name}` must have axes ({axes[0].strip()}) that fit the other arguments, "
        f"got shape {tuple(value.shape)}."
    )


def _check_answer(answer: Tensor, given: Mapping[str, Any]) -> None:
    """Reject an answer that is no number, unless a weight or a width is zero."""
    if answer.isfinite().all():
        return
    tensors = {name: value for name, value in given.items() if isinstance(value, Tensor)}
    undefined = [name for name, value in tensors.items() if not value.isfinite().all()]
    zeros = [
        name for name in undefined if "log_" in name and (tensors[name] < math.inf).all()
    ]  # logarithms of zero, which are minus infinity
    if undefined and zeros == undefined and not answer.isnan().any():
        return
    sizes = {name: value.abs().max().item() for name, value in tensors.items()}
    name = undefined[0] if undefined else max(sizes, key=lambda name: sizes[name])
    raise ValueError(
        f"`{name}` must be so small that the answer is a number, got up to {sizes[name]:g}."
    )


class DiagonalMixture(NamedTuple):
    """A mixture of diagonal Gaussians for each place of a batch, often of one component."""

    loc: Float[Tensor, "*batch components dim"]
    log_var: Float[Tensor, "*batch components dim"]
    log_weight: Float[Tensor, "*batch components"]

    def log_prob(self, value: Float[Tensor, "*#batch dim"]) -> Float[Tensor, "*batch"]:
        """Log density of values under the whole mixture, in nats."""
        log_prob = _gaussian_log_prob(value.unsqueeze(-2), self.loc, 0.5 * self.log_var)
        if self.loc.shape[-2] == 1:
            return log_prob.squeeze(-1)
        return torch.logsumexp(log_prob + self.log_weight, dim=-1)

    def cdf(self, value: Float[Tensor, "*#batch dim"]) -> Float[Tensor, "*batch dim"]:
        """Probability of a smaller value, in each coordinate by itself."""
        standard = (value.unsqueeze(-2) - self.loc) * torch.exp(-0.5 * self.log_var)
        return (self.log_weight.exp().unsqueeze(-1) * torch.special.ndtr(standard)).sum(-2)

    def mean(self, value: Float[Tensor, "*places components"]) -> Float[Tensor, "*places"]:
        """Mean over components of a value that each of them has, by their weights."""
        return (self.log_weight.exp() * value).sum(-1)

    def component_samples(
        self, noise: Float[Tensor, "*#batch #components dim"]
    ) -> Float[Tensor, "*batch components dim"]:
        """One point of each component for standard normal `noise`, differentiable."""
        return self.loc + torch.exp(0.5 * self.log_var) * noise

    def sample(self) -> Float[Tensor, "*batch dim"]:
        """One point for each place, from a component chosen by its weight."""
        points = self.component_samples(torch.randn_like(self.loc))
        if points.shape[-2] == 1:
            return points.squeeze(-2)
        return _component_of(points, sample_index(self.log_weight))

    def select(
        self, component: Int[Tensor, "*batch"]
    ) -> tuple[Float[Tensor, "*batch dim"], Float[Tensor, "*batch dim"]]:
        """Mean and log variance of one component for each place."""
        return _component_of(self.loc, component), _component_of(self.log_var, component)

    def coordinates(self, index: Sequence[int]) -> "DiagonalMixture":
        """The mixture's marginal over some coordinates, which is exact.

        Args:
            index: Of each coordinate, from the end where negative.

        Raises:
            ValueError: If there is none, or one is no coordinate.
        """
        dim = self.loc.shape[-1]
        if not index or not all(-dim <= i < dim for i in index):
            raise ValueError(f"`index` must name coordinates of {dim}, got {list(index)}.")
        return DiagonalMixture(
            _columns(self.loc, index), _columns(self.log_var, index), self.log_weight
        )

    def entropy(self) -> Float[Tensor, "*batch"]:
        """Differential entropy, from below in nats; exact for one component."""
        return self.mean(_gaussian_entropy(self.log_var)) + _jensen_shannon_lower(*self)

    def kl_upper(
        self, other: "DiagonalMixture", *, product_dtype: torch.dtype = torch.float64
    ) -> Float[Tensor, "*batch"]:
        """Upper bound of `KL(self || other)` in nats; `other` is one mixture for all places."""
        upper = _kl_to_mixture_upper(self.loc, self.log_var, *other, product_dtype=product_dtype)
        return self.mean(upper) - _jensen_shannon_lower(*self)

    def kl_lower(self, other: "DiagonalMixture") -> Float[Tensor, "*batch"]:
        """Lower bound of `KL(self || other)` in nats; `other` is one mixture for all places."""
        return self.mean(kl_to_mixture_lower(self.loc, self.log_var, *other)) - (
            jensen_shannon_upper(*self)
        )


@checked
def gaussian_log_prob(
    value: Float[Tensor, "*#batch dim"],
    loc: Float[Tensor, "*#batch dim"],
    log_std: Float[Tensor, "*#batch dim"],
) -> Float[Tensor, "*batch"]:
    """Log density of a diagonal Gaussian, in nats."""
    standard = (value - loc) * torch.exp(-log_std)
    return -(0.5 * standard.square() + log_std + 0.5 * LOG_TWO_PI).sum(-1)


def sample_index(log_weight: Float[Tensor, "*batch choices"]) -> Int[Tensor, "*batch"]:
    """A choice for each place, by its probability: Gumbel's trick.

    `torch.multinomial` would look at the values first, for which a device is waited.
    """
    tiny = torch.finfo(log_weight.dtype).tiny  # at 0, what has no weight would come first
    gumbel = -(-torch.rand_like(log_weight).clamp(min=tiny).log()).log()
    return (log_weight + gumbel).argmax(-1)


@checked
def gaussian_entropy(log_var: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch"]:
    """Differential entropy of diagonal Gaussians, in nats.

    Args:
        log_var: Log variance of every coordinate.

    Returns:
        Entropy of each Gaussian.

    Example:
        >>> gaussian_entropy(torch.zeros(1))
        tensor(1.4189)
    """
    dim = log_var.shape[-1]
    return 0.5 * (log_var.sum(-1) + dim * (LOG_TWO_PI + 1))


@checked
def gaussian_kl(
    loc: Float[Tensor, "*#batch dim"],
    log_var: Float[Tensor, "*#batch dim"],
    other_loc: Float[Tensor, "*#batch dim"],
    other_log_var: Float[Tensor, "*#batch dim"],
) -> Float[Tensor, "*batch"]:
    """Divergence `KL(first || other)` of two diagonal Gaussians, in nats."""
    log_ratio = log_var - other_log_var
    distance = (loc - other_loc).square() * torch.exp(-other_log_var)
    return 0.5 * (torch.expm1(log_ratio) - log_ratio + distance).sum(-1)


@checked
def kl_to_mixture_upper(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
    *,
    product_dtype: torch.dtype = torch.float64,
) -> Float[Tensor, "*batch"]:
    r"""Upper bound of the divergence from a Gaussian `f` to a mixture, by Jensen, in nats.

    .. math:: -H(f) - \log \sum_j w_j \exp E_f[\log m_j]

    Args:
        loc: Mean of each Gaussian.
        log_var: Log variance of each Gaussian.
        component_loc: Means of the mixture's components.
        component_log_var: Log variances of the mixture's components.
        component_log_weight: Log weights, normalised; equal when `None`.
        product_dtype: Of the matrix product, see `expected_log_density`.

    Returns:
        The bound for each Gaussian, differentiable in every argument.
    """
    if component_log_weight is not None:  # minus infinity would make second derivatives NaN
        least = max(LEAST_LOG_WEIGHT, torch.finfo(component_log_weight.dtype).min)
        component_log_weight = component_log_weight.clamp(min=least)
    log_density = _expected_log_density(
        loc,
        log_var,
        component_loc,
        component_log_var,
        component_log_weight,
        product_dtype=product_dtype,
    )
    return -_gaussian_entropy(log_var) - torch.logsumexp(log_density, dim=-1)


@checked
def kl_to_mixture_lower(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
) -> Float[Tensor, "*batch"]:
    r"""Lower bound of the divergence from a Gaussian `f` to a mixture, by overlap, in nats.

    .. math:: -H(f) - \log \sum_j w_j \, N(\mu_f; \mu_j, S_f + S_j)

    Arguments are those of `kl_to_mixture_upper`. Where gradients are asked for, memory grows as
    batch x components x dim.
    """
    components = component_loc, component_log_var
    if torch.is_grad_enabled():
        overlap = _log_overlap(loc, log_var, *components)
    else:  # some Gaussians at a time: what there is of all of them at once may be gigabytes
        some = max(1, MOST_AT_ONCE // max(1, component_loc.numel()))
        locs, log_vars = (each.reshape(-1, each.shape[-1]).split(some) for each in (loc, log_var))
        rows = [
            _log_overlap(*gaussians, *components) for gaussians in zip(locs, log_vars, strict=True)
        ]
        overlap = torch.cat(rows).reshape(*loc.shape[:-1], len(component_loc))
    if component_log_weight is None:  # equal weights
        overlap = overlap - math.log(component_loc.shape[0])
    else:
        overlap = overlap + component_log_weight
    return -gaussian_entropy(log_var) - torch.logsumexp(overlap, dim=-1)


def _log_overlap(
    loc: Tensor, log_var: Tensor, component_loc: Tensor, component_log_var: Tensor
) -> Tensor:
    """Log density of each difference of means under both variances, `(*batch, components)`."""
    sum_log_var = torch.logaddexp(
        log_var.unsqueeze(-2), component_log_var
    )  # *batch components dim
    return gaussian_log_prob(loc.unsqueeze(-2), component_loc, 0.5 * sum_log_var)


@checked
def kl_to_mixture_sampled(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
    *,
    samples: Float[Tensor, "samples *batch dim"],
) -> Float[Tensor, "*batch"]:
    """Monte Carlo estimate of the divergence from a Gaussian to a mixture, in nats.

    Args:
        loc: Mean of each Gaussian.
        log_var: Log variance of each Gaussian.
        component_loc: Means of the mixture's components.
        component_log_var: Log variances of the mixture's components.
        component_log_weight: Log weights, normalised; equal when `None`.
        samples: Points sampled from each Gaussian, `loc + exp(log_var / 2) * noise`.

    Returns:
        The unbiased estimate for each Gaussian.
    """
    own = gaussian_log_prob(samples, loc, 0.5 * log_var)  # samples *batch
    mixture = mixture_log_density(samples, component_loc, component_log_var, component_log_weight)
    return (own - mixture).mean(0)


@checked
def jensen_shannon_lower(
    loc: Float[Tensor, "*batch components dim"],
    log_var: Float[Tensor, "*batch components dim"],
    log_weight: Float[Tensor, "*batch components"],
) -> Float[Tensor, " *batch"]:
    r"""Lower bound of the divergence of a mixture's components from the mixture, in nats.

    .. math:: -\sum_k w_k \log \sum_l w_l \exp(-BD(f_k, f_l)) \le \sum_k w_k KL(f_k \| \bar f)

    with the Bhattacharyya distance. Exact for components that coincide or lie far apart; zero for
    one alone. The information of a sample about its component: `KL(mixture || m)` is the mean of
    the components' divergences to `m`, less this.
    """
    return _pairwise_information(_bhattacharyya_distance, loc, log_var, log_weight)


@checked
def jensen_shannon_upper(
    loc: Float[Tensor, "*batch components dim"],
    log_var: Float[Tensor, "*batch components dim"],
    log_weight: Float[Tensor, "*batch components"],
) -> Float[Tensor, " *batch"]:
    """Upper bound of what `jensen_shannon_lower` bounds from below, by pairwise divergences."""
    return _pairwise_information(gaussian_kl, loc, log_var, log_weight)


@checked
def mixture_log_density(
    value: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
) -> Float[Tensor, "*batch"]:
    """Log density of a mixture of diagonal Gaussians at each point, in nats."""
    point = torch.full_like(value, -math.inf)  # the log variance of a Gaussian without width
    log_density = expected_log_density(
        value, point, component_loc, component_log_var, component_log_weight
    )
    return torch.logsumexp(log_density, dim=-1)


@checked
def expected_log_density(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
    *,
    product_dtype: torch.dtype = torch.float64,
) -> Float[Tensor, "*batch components"]:
    """Expected log density `E_f[log w_j m_j]` of each Gaussian under each component, in nats.

    It is linear in the first two moments of the Gaussian: one matrix product for all pairs. The
    product is taken in float64 by default, because sharp components leave small
    differences of large squares; in float32 it is off by some 1e-3 nats at 17 dimensions where
    components have a standard deviation of 0.05, and by less where they are wider. The squares are
    about the origin: subtract a place in their midst from all means where these are 1e5 and more
    standard deviations of a component away from it, or float64 is off by 1e-6 nats and more.
    """
    if loc.ndim == 1:  # one Gaussian alone, for which there is no matrix product
        mixture = component_loc, component_log_var, component_log_weight
        alone = loc.unsqueeze(0), log_var.unsqueeze(0)
        return _expected_log_density(*alone, *mixture, product_dtype=product_dtype).squeeze(0)
    dtype = loc.dtype
    product_dtype = torch.promote_types(product_dtype, dtype)
    loc, log_var = loc.to(product_dtype), log_var.to(product_dtype)
    component_loc = component_loc.to(product_dtype)
    component_log_var = component_log_var.to(product_dtype)
    precision = torch.exp(-component_log_var)
    weighted_loc = component_loc * precision
    offset = -0.5 * (component_log_var + component_loc * weighted_loc + LOG_TWO_PI).sum(-1)
    if component_log_weight is None:  # equal weights
        offset = offset - math.log(component_loc.shape[0])
    else:
        offset = offset + component_log_weight
    # the offset is the slope of a moment that is one: to add it would take a pass over all pairs
    moments = torch.cat([log_var.exp() + loc.square(), loc, torch.ones_like(loc[..., :1])], dim=-1)
    slopes = torch.cat([-0.5 * precision, weighted_loc, offset.unsqueeze(-1)], dim=-1)
    product = torch.mm(moments.flatten(0, -2), slopes.mT)
    return product.to(dtype).unflatten(0, moments.shape[:-1])


def _pairwise_information(
    distance: Callable[[Tensor, Tensor, Tensor, Tensor], Tensor],
    loc: Tensor,
    log_var: Tensor,
    log_weight: Tensor,
) -> Tensor:
    """Information of a sample about its component, from distances between pairs of them."""
    if loc.shape[-2] == 1:
        return torch.zeros_like(log_weight[..., 0])
    pairs = distance(
        loc.unsqueeze(-2), log_var.unsqueeze(-2), loc.unsqueeze(-3), log_var.unsqueeze(-3)
    )
    log_share = torch.logsumexp(log_weight.unsqueeze(-2) - pairs, dim=-1)  # *batch components
    return -(log_weight.exp() * log_share).sum(-1)


def _bhattacharyya_distance(
    loc: Tensor, log_var: Tensor, other_loc: Tensor, other_log_var: Tensor
) -> Tensor:
    """Minus the log overlap of the square roots of two diagonal Gaussians."""
    log_mean_var = torch.logaddexp(log_var, other_log_var) - math.log(2)
    distance = 0.25 * (loc - other_loc).square() * torch.exp(-log_mean_var)
    return 0.5 * (distance + log_mean_var - 0.5 * (log_var + other_log_var)).sum(-1)


def _component_of(
    value: Float[Tensor, "*batch components dim"], component: Int[Tensor, "*batch"]
) -> Float[Tensor, "*batch dim"]:
    """One component's value for each place."""
    return torch.take_along_dim(value, component[..., None, None], dim=-2).squeeze(-2)


def _columns(
    value: Float[Tensor, "*batch dim"], index: Sequence[int]
) -> Float[Tensor, "*batch some"]:
    """Some columns, by slices: in a graph, torch 2.13 gets gradients of indexed ones wrong."""
    index = [i % value.shape[-1] for i in index]
    starts = [place for place, i in enumerate(index) if place == 0 or i != index[place - 1] + 1]
    runs = zip(starts, [*starts[1:], len(index)], strict=True)
    slices = [value[..., index[start] : index[start] + stop - start] for start, stop in runs]
    return slices[0] if len(slices) == 1 else torch.cat(slices, dim=-1)


# the same unchecked, where an update calls them
_gaussian_log_prob = unwrap(gaussian_log_prob)
_gaussian_entropy = unwrap(gaussian_entropy)
_kl_to_mixture_upper = unwrap(kl_to_mixture_upper)
_jensen_shannon_lower = unwrap(jensen_shannon_lower)
_expected_log_density = unwrap(expected_log_density)
