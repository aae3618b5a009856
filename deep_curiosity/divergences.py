"""Entropies and divergences of diagonal Gaussians and their mixtures, as pure functions in nats.

The bounds of the divergence to a mixture are those of Hershey & Olsen, "Approximating the
Kullback Leibler divergence between Gaussian mixture models" (2007), and Kolchinsky & Tracey,
"Estimating mixture entropy with pairwise distances" (2017).
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from deep_curiosity.distributions import gaussian_log_prob

LOG_TWO_PI = math.log(2 * math.pi)


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


def kl_to_mixture_upper(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
) -> Float[Tensor, "*batch"]:
    r"""Upper bound of the divergence from a Gaussian `f` to a mixture, by Jensen, in nats.

    .. math:: -H(f) - \log \sum_j w_j \exp E_f[\log m_j]

    Args:
        loc: Mean of each Gaussian.
        log_var: Log variance of each Gaussian.
        component_loc: Means of the mixture's components.
        component_log_var: Log variances of the mixture's components.
        component_log_weight: Log weights, normalised; equal when `None`.

    Returns:
        The bound for each Gaussian, differentiable in every argument.
    """
    log_density = expected_log_density(loc, log_var, component_loc, component_log_var)
    return -gaussian_entropy(log_var) - _log_mean(log_density, component_log_weight)


def kl_to_mixture_lower(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
) -> Float[Tensor, "*batch"]:
    r"""Lower bound of the divergence from a Gaussian `f` to a mixture, by product overlap, in nats.

    .. math:: -H(f) - \log \sum_j w_j \, N(\mu_f; \mu_j, S_f + S_j)

    Arguments are those of `kl_to_mixture_upper`. Memory grows as batch x components x dim.
    """
    sum_log_var = torch.logaddexp(
        log_var.unsqueeze(-2), component_log_var
    )  # *batch components dim
    overlap = gaussian_log_prob(loc.unsqueeze(-2), component_loc, 0.5 * sum_log_var)
    return -gaussian_entropy(log_var) - _log_mean(overlap, component_log_weight)


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
        samples: Points drawn from each Gaussian, `loc + exp(log_var / 2) * noise`.

    Returns:
        The unbiased estimate for each Gaussian.
    """
    own = gaussian_log_prob(samples, loc, 0.5 * log_var)  # samples *batch
    mixture = mixture_log_density(samples, component_loc, component_log_var, component_log_weight)
    return (own - mixture).mean(0)


def mixture_log_density(
    value: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
    component_log_weight: Float[Tensor, " components"] | None = None,
) -> Float[Tensor, "*batch"]:
    """Log density of a mixture of diagonal Gaussians at each point, in nats."""
    no_spread = torch.zeros_like(value)
    log_density = _expected_log_density(value, no_spread, component_loc, component_log_var)
    return _log_mean(log_density, component_log_weight)


def expected_log_density(
    loc: Float[Tensor, "*batch dim"],
    log_var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
) -> Float[Tensor, "*batch components"]:
    """Negative cross-entropy `E_f[log m_j]` of each Gaussian with each component, in nats."""
    return _expected_log_density(loc, log_var.exp(), component_loc, component_log_var)


def _expected_log_density(
    loc: Float[Tensor, "*batch dim"],
    var: Float[Tensor, "*batch dim"],
    component_loc: Float[Tensor, "components dim"],
    component_log_var: Float[Tensor, "components dim"],
) -> Float[Tensor, "*batch components"]:
    """Expected log density under every component: linear in two moments, so one product."""
    centre = component_loc.mean(0)  # a common shift, so that the squares below lose fewer digits
    loc, component_loc = loc - centre, component_loc - centre
    precision = torch.exp(-component_log_var)
    weighted_loc = component_loc * precision
    moments = torch.cat([var + loc.square(), loc], dim=-1)
    slopes = torch.cat([-0.5 * precision, weighted_loc], dim=-1)  # components 2*dim
    offset = -0.5 * (component_log_var + component_loc * weighted_loc + LOG_TWO_PI).sum(-1)
    return moments @ slopes.mT + offset


def _log_mean(
    log_density: Float[Tensor, "*batch components"],
    component_log_weight: Float[Tensor, " components"] | None,
) -> Float[Tensor, "*batch"]:
    """Log of the weighted mean over components."""
    if component_log_weight is None:
        return torch.logsumexp(log_density, dim=-1) - math.log(log_density.shape[-1])
    return torch.logsumexp(log_density + component_log_weight, dim=-1)
