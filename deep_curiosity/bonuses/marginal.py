"""The usual next state: a mixture density `p_pi(x')` over what the policy leads to."""

import math
from inspect import unwrap
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from deep_curiosity.gaussians import (
    DiagonalMixture,
    expected_log_density,
    gaussian_log_prob,
    mixture_log_density,
)
from deep_curiosity.speed.precision import matmul_is_float32
from deep_curiosity.transitions import check_counts, is_number

LOG_BANDWIDTH_RANGE = (math.log(1e-3), math.log(10.0))  # searched for a target perplexity
TARGET_PERPLEXITY = 8.0
NUM_MEASURED = 256  # components over which a mean is taken
NUM_FOLLOWED = 64  # components over which it is taken at every refresh
MOST_LOG_STRETCH = math.log(1e3)  # of the bandwidth beyond Silverman's
MOST_STEP = 0.3  # of the log stretch at one refresh: where none resembles another, no slope tells
BISECTIONS = 20  # halvings of that range: to a factor of 1.00001

Bandwidth = float | Literal["overlap", "silverman", "perplexity"]

_expected_log_density = unwrap(expected_log_density)  # unchecked: a refresh waits for no device


class Information(NamedTuple):
    """Two estimates of the information `I({X, A}; X')`, in nats, that enclose it on average."""

    lower: Float[Tensor, ""]
    upper: Float[Tensor, ""]


class NextStateMarginal(nn.Module):
    r"""Mixture of predicted next states with a bandwidth, equations (20) and (24).

    The newest predictions replace the oldest. A nearly deterministic environment predicts spikes,
    and a mixture of spikes has holes: every component is therefore widened by `h^2` times the
    variance of the component means, which makes the mixture a kernel density estimate.

    Args:
        dim: Number of whitened features of a state.
        components: Number of Gaussians, M.
        bandwidth: `"silverman"` for `h^2 = (4 / (d + 2))^(2 / (d + 4)) M^(-2 / (d + 4))`;
            `"overlap"` for the same, stretched where it leaves a component with fewer than
            `sqrt(M) / 2` that it resembles; a number for `h` itself; `"perplexity"` for the `h`
            at which a component resembles `target_perplexity`. It resembles itself as well.
        target_perplexity: Read only by `bandwidth="perplexity"`.

    Raises:
        ValueError: If a count or a scale is out of range.

    In many dimensions Silverman's kernels hold one component each, and how far a state lies from
    the mixture is how far it lies from those that happened to be drawn. Kernels that are stretched
    by `t` would blur all that the mixture knows, so their centres move towards the mean, by

    .. math:: s^2 = \frac{1 + h^2 / t^2}{1 + h^2 t^2}

    for Silverman's `h`: the variance of the mixture falls from Silverman's `1 + h^2` to that of
    the components, and the mixture nears their Gaussian. The stretch takes a step of Newton's at
    every refresh, and is kept from one to the next.

    Reference: Silverman, "Density Estimation for Statistics and Data Analysis" (1986), (4.14), and
    section 6.4.1 on kernels that keep a variance.
    """

    loc: Tensor
    log_var: Tensor
    log_weight: Tensor
    bandwidth_log_var: Tensor
    component_loc: Tensor
    """Centre of every component, `(components, dim)`: `loc`, unless kernels are stretched."""
    component_log_var: Tensor
    """Log variance of every component, bandwidth included, `(components, dim)`."""
    num_seen: Tensor
    log_stretch: Tensor
    """Of the bandwidth beyond Silverman's, at least zero; zero unless components shall overlap."""

    def __init__(
        self,
        dim: int,
        *,
        components: int = 2048,
        bandwidth: Bandwidth = "silverman",
        target_perplexity: float = TARGET_PERPLEXITY,
    ) -> None:
        super().__init__()
        check_counts(dim=dim)
        _check_components(components, bandwidth, target_perplexity)
        self.bandwidth = bandwidth
        self.target_perplexity = target_perplexity
        self.register_buffer("loc", torch.zeros(components, dim))
        self.register_buffer("log_var", torch.zeros(components, dim))
        self.register_buffer("log_weight", torch.full((components,), -math.inf))
        self.register_buffer("bandwidth_log_var", torch.full((dim,), -math.inf))
        self.register_buffer("component_loc", torch.zeros(components, dim), persistent=False)
        self.register_buffer("component_log_var", torch.zeros(components, dim), persistent=False)
        self.register_buffer("num_seen", torch.zeros((), dtype=torch.long))
        self.register_buffer("log_stretch", torch.zeros(()))
        self._product_dtype = torch.float64  # of products in which many densities are computed
        self._num_seen = 0  # the same as a plain number: to read it waits for no device
        self.register_load_state_dict_pre_hook(_add_stretch)
        self.register_load_state_dict_post_hook(_restore)

    @torch.no_grad()
    def refresh(
        self, loc: Float[Tensor, "batch dim"], log_var: Float[Tensor, "batch dim"]
    ) -> None:
        """Let predicted next states take the place of the oldest components, and fit `h`.

        Raises:
            TypeError: If one is no tensor of the marginal's dtype.
            ValueError: If one is not of the marginal's features, or there are not as many of both.
        """
        self._check_states(loc, log_var)
        components = self.loc.shape[0]
        loc, log_var = loc[-components:], log_var[-components:]
        slot = (self._num_seen + torch.arange(loc.shape[0], device=loc.device)) % components
        self.loc[slot], self.log_var[slot] = loc, log_var
        self._num_seen += loc.shape[0]
        self.num_seen.fill_(self._num_seen)
        self.log_weight[: self._num_filled] = -math.log(self._num_filled)
        self._fit_bandwidth()

    @torch.no_grad()
    def replace(
        self, loc: Float[Tensor, "batch dim"], log_var: Float[Tensor, "batch dim"]
    ) -> None:
        """Let predicted next states take the place of all components, and fit `h`.

        Raises:
            TypeError: If one is no tensor of the marginal's dtype.
            ValueError: If one is not of the marginal's features, or there are not as many of both.
        """
        self._check_states(loc, log_var)
        self._num_seen = 0
        self.log_weight.fill_(-math.inf)
        self.refresh(loc, log_var)

    @property
    def is_empty(self) -> bool:
        """Whether no state has been observed yet."""
        return self._num_seen == 0

    @property
    def mixture(self) -> DiagonalMixture:
        """The density itself: components widened by the bandwidth, with their weights."""
        return DiagonalMixture(self.component_loc, self.component_log_var, self.log_weight)

    def kl_upper(self, prediction: DiagonalMixture) -> Float[Tensor, "*batch"]:
        """Upper bound of `KL(prediction || marginal)`, equation (18), in nats.

        Every component is widened by the bandwidth, so a float32 product is exact enough, where it
        is float32 indeed.
        """
        return prediction.kl_upper(self.mixture, product_dtype=self._product_dtype)

    def kl_lower(self, prediction: DiagonalMixture) -> Float[Tensor, "*batch"]:
        """Lower bound of `KL(prediction || marginal)`, equation (18), in nats."""
        return prediction.kl_lower(self.mixture)

    def log_density(self, value: Float[Tensor, "*batch dim"]) -> Float[Tensor, "*batch"]:
        """Log density of next states, in nats."""
        return mixture_log_density(value, *self.mixture)

    def perplexity(self) -> Float[Tensor, ""]:
        """How many components a component resembles, itself included: `exp` of mean entropy."""
        return self._perplexity(self.component_loc, self.component_log_var)

    def information(self, noise: Float[Tensor, "samples number dim"]) -> Information:
        r"""Information about the next state in where one is and what one does there, in nats.

        Every component `f_j` is the prediction of a state-action pair, and `x` is sampled from it:

        .. math::
            I_{lower} = E \log \frac{f_j(x)}{\frac{1}{M} \sum_k f_k(x)}, \quad
            I_{upper} = E \log \frac{f_j(x)}{\frac{1}{M-1} \sum_{k \ne j} \tilde f_k(x)}

        With its own component included, a pair is at most `log M` nats from the mixture: the
        estimate is low on average. With it left out, nothing in the mixture knows of the pair, and
        the estimate is high on average, whatever the density: the components `f~` are widened by
        the bandwidth, without which it would be the height of spikes over holes. A pair
        whose bonus is computed is no component itself, so there the question does not arise.

        Args:
            noise: Standard normal numbers for each of the first components, over which the mean
                is taken; the mixture is that of all.

        Returns:
            Both estimates; the upper one is infinite while there are not two components.

        Reference: Poole et al., "On Variational Bounds of Mutual Information" (2019),
        https://arxiv.org/abs/1905.06922; equations (12) and (13).
        """
        number = noise.shape[1]
        loc, log_std = self.loc[:number], 0.5 * self.log_var[:number]
        value = loc + log_std.exp() * noise  # samples number dim
        own = gaussian_log_prob(value, loc, log_std)
        everyone = mixture_log_density(value, self.loc, self.log_var, self.log_weight)
        point = torch.full_like(value, -math.inf)
        others = expected_log_density(value, point, *self.mixture)  # samples number components
        itself = torch.eye(number, len(self.loc), dtype=torch.bool, device=self.loc.device)
        weight = self.log_weight[:number].exp()
        without = torch.logsumexp(others.masked_fill(itself, -math.inf), dim=-1)
        without = without - torch.log1p(-weight)
        share = weight / weight.sum()
        upper = ((own - without).mean(0) * share).sum()
        return Information(
            lower=((own - everyone).mean(0) * share).sum(),
            upper=torch.where(self.num_seen < 2, math.inf, upper),
        )

    def _check_states(self, loc: Tensor, log_var: Tensor) -> None:
        """Reject states that would be spread over the marginal's features, or not fit in."""
        for name, value in (("loc", loc), ("log_var", log_var)):
            kind = value.dtype if isinstance(value, Tensor) else type(value).__name__
            if kind != self.loc.dtype:
                raise TypeError(f"`{name}` must be a tensor of {self.loc.dtype}, got {kind}.")
        dim = self.loc.shape[1]
        if loc.ndim != 2 or loc.shape[1] != dim or len(loc) == 0:
            raise ValueError(f"`loc` must have shape (batch, {dim}), got {tuple(loc.shape)}.")
        if log_var.shape != loc.shape:
            raise ValueError(
                f"`log_var` must have shape {tuple(loc.shape)}, as `loc` has, "
                f"got {tuple(log_var.shape)}."
            )

    def _perplexity(self, component_loc: Tensor, component_log_var: Tensor) -> Tensor:
        """That of the first components, which are many enough for a mean, among all."""
        first = slice(NUM_MEASURED)
        log_share = self._log_share(first, component_loc, component_log_var)
        entropy = torch.special.entr(log_share.exp()).sum(-1)
        weight = self.log_weight[first].exp()
        return ((weight * entropy).sum() / weight.sum()).exp()

    def _log_share(
        self, rows: slice, component_loc: Tensor, component_log_var: Tensor
    ) -> Float[Tensor, "rows components"]:
        """By how much some components resemble each of the others, as shares that sum to 1."""
        number = len(component_loc)
        log_density = _expected_log_density(
            component_loc[rows],
            self.log_var[rows],
            component_loc,
            component_log_var,
            self.log_weight[:number],
        )
        return torch.log_softmax(log_density, dim=-1)

    def _fit_bandwidth(self) -> None:
        """Set the variance that widens every component, `h^2` times the variance of the means."""
        log_var = self.loc[: self._num_filled].var(0, correction=0).log()  # of component means
        if self.bandwidth == "overlap":
            self._set_bandwidth(log_var, self._silverman)  # stretched as before: what it leaves
            self._stretch()
            self._set_bandwidth(log_var, self._silverman)
            return
        self.log_stretch.zero_()  # which a state of other settings may have had
        if self.bandwidth == "silverman":
            log_bandwidth = self._silverman
        elif self.bandwidth == "perplexity":
            log_bandwidth = self._log_bandwidth_at_target(log_var)
        else:
            log_bandwidth = math.log(self.bandwidth)
        self._set_bandwidth(log_var, log_bandwidth)

    @property
    def _num_filled(self) -> int:
        """Components that there are; one while there is none."""
        return max(min(self._num_seen, len(self.loc)), 1)

    @property
    def _silverman(self) -> float:
        return silverman_log_bandwidth(self._num_filled, self.loc.shape[1])

    @property
    def _log_shrinkage(self) -> Tensor:
        """Log of `s^2`, by which the mixture is brought together where kernels are stretched."""
        var, stretch = math.exp(2 * self._silverman), torch.exp(2 * self.log_stretch)
        return torch.log1p(var / stretch) - torch.log1p(var * stretch)

    def _stretch(self) -> None:
        """Take a step towards `sqrt(M) / 2` components that one resembles, or Silverman's.

        Where the kernel is wider than what is predicted, the log densities of which a component's
        shares are made go with `h^-2`. The entropy of the shares then grows with `log h` by twice
        the variance of their logarithms.
        """
        number = self._num_filled
        followed = slice(0, number, max(number // NUM_FOLLOWED, 1))
        log_share = self._log_share(
            followed, self.component_loc[:number], self.component_log_var[:number]
        )
        share = log_share.exp()
        entropy = -(share * log_share).sum(-1)
        variance = (share * log_share.square()).sum(-1) - entropy.square()
        lacking = 0.5 * math.log(number / 4) - entropy.mean()
        step = lacking / (2 * variance.mean()).clamp(min=1e-6)
        step = torch.nan_to_num(step).clamp(-MOST_STEP, MOST_STEP)
        step = step * step.abs() / MOST_STEP  # near the goal a step is mostly chance
        self.log_stretch.copy_((self.log_stretch + step).clamp(0.0, MOST_LOG_STRETCH))

    def _set_bandwidth(self, log_var: Tensor, log_bandwidth: float) -> None:
        """Widen all components by a bandwidth and what it is stretched by."""
        stretched = log_var + 2 * (log_bandwidth + self.log_stretch)
        self.bandwidth_log_var.copy_(stretched + self._log_shrinkage)
        self._widen()

    def _widen(self) -> None:
        """Widen and bring together all components, once for all uses up to the next refresh."""
        exact = matmul_is_float32(self.loc.device.type)
        self._product_dtype = torch.float32 if exact else torch.float64
        mean = self.loc[: self._num_filled].mean(0)
        away = 1 - torch.exp(0.5 * self._log_shrinkage)  # exactly zero where nothing is stretched
        self.component_loc.copy_(self.loc.lerp(mean, away))
        self.component_log_var.copy_(torch.logaddexp(self.log_var, self.bandwidth_log_var))

    def _log_bandwidth_at_target(self, log_var: Tensor) -> float:
        """Bisect `log h`: the perplexity grows with it."""
        low, high = LOG_BANDWIDTH_RANGE
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            widened = torch.logaddexp(self.log_var, log_var + 2 * middle)
            if self._perplexity(self.loc, widened) < self.target_perplexity:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)


def _restore(marginal: NextStateMarginal, _: object) -> None:
    marginal._num_seen = int(marginal.num_seen)
    marginal._widen()


def _add_stretch(
    marginal: NextStateMarginal, state: dict[str, Tensor], prefix: str, *_: object
) -> None:
    """Take states of before there was a stretch."""
    state.setdefault(f"{prefix}log_stretch", torch.zeros_like(marginal.log_stretch))


def silverman_log_bandwidth(num_points: int, dim: int) -> float:
    """Log of Silverman's bandwidth for points of unit variance in `dim` dimensions."""
    return (math.log(4 / (dim + 2)) - math.log(num_points)) / (dim + 4)


def _check_components(components: int, bandwidth: float | str, target_perplexity: float) -> None:
    """Reject a marginal that cannot be."""
    check_counts(components=components)
    if components < 2:
        raise ValueError(f"`components` must be at least 2, got {components}.")
    named = bandwidth in ("overlap", "silverman", "perplexity")
    if not named and not (is_number(bandwidth) and bandwidth > 0):  # type: ignore[operator]
        raise ValueError(
            "`bandwidth` must be 'overlap', 'silverman', 'perplexity' or a positive number, "
            f"got {bandwidth!r}."
        )
    fits = is_number(target_perplexity) and 1 < target_perplexity < components
    if bandwidth == "perplexity" and not fits:
        raise ValueError(
            f"`target_perplexity` must lie between 1 and `components` ({components}), "
            f"got {target_perplexity}."
        )
