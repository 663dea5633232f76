"""Mixtures of 2, 4 and an optimised number of Gaussians (P3, section III-B).

All restarts and numbers of components of a fit run as one batch of expectation maximisation in
float64.
"""

import math
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.oneclass.base import Classifier, ClassifierSettings, DistanceModel, RoadSamples
from roadtorch.oneclass.density import variance_floor, whitening_matrix

MAX_EM_ROUNDS = 100  # most rounds of expectation maximisation

LIKELIHOOD_TOLERANCE = 1e-3
"""Change of the mean log-likelihood at which it ends: scikit-learn's, not dd_tools's."""

TRIAL_EM_ROUNDS = 10  # rounds of each start before the best continues
MIN_EXPONENT = -1e37  # lower bound of exponents: the difference of two infinities is undefined
WIDENING = 0.01  # fraction of the samples' mean variance added to each component's (dd_tools)
MIN_WEIGHT = 1e-300  # stands for a weight of 0 in logarithms


Components = Annotated[int, Field(ge=1, le=64, description="number of Gaussians")]


class MixtureSettings(ClassifierSettings):
    """A mixture of Gaussians."""

    components: Components = 2
    restarts: int = Field(default=5, ge=1, le=100, description="number of starts; the best is used")
    formula: Literal["density", "paper"] = Field(
        default="density",
        description="density of a mixture, or the paper's formula without the 1/2 in the exponent "
        "and the determinants",
    )


class LargerMixtureSettings(MixtureSettings):
    """A mixture of four Gaussians."""

    components: Components = 4


class BestMixtureSettings(MixtureSettings):
    """A mixture whose number of Gaussians is chosen by BIC; the paper does not say how."""

    components: int = Field(default=6, ge=1, le=64, description="largest number of Gaussians tried")


class Mixtures(NamedTuple):
    """A batch of mixtures, float64: R runs of N components each.

    ``log_weights`` (R, N) are log mixture weights, minus infinity where a run has fewer components;
    ``means`` are (R, N, d), ``whitening`` (R, N, d, d) with Wᵀ W = Σ⁻¹.
    """

    log_weights: Tensor
    means: Tensor
    whitening: Tensor


def _polynomial_features(samples: Tensor) -> Tensor:
    """Return 1, x and xxᵀ of samples (m, d), (m, 1+d+d²), in which all sums here are linear."""
    squares = (samples[:, :, None] * samples[:, None, :]).flatten(1)
    return torch.cat([samples.new_ones(len(samples), 1), samples, squares], 1)


def log_densities(features: Tensor, mixtures: Mixtures) -> Tensor:
    """Return ln(P_n N(x; μ_n, Σ_n)), (R, N, m), of polynomial features of centred samples."""
    dimensions = mixtures.means.shape[-1]
    inverse = mixtures.whitening.mT @ mixtures.whitening
    slope = (inverse @ mixtures.means[..., None])[..., 0]
    volume = mixtures.whitening.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    constant = mixtures.log_weights + volume - dimensions / 2 * math.log(2 * math.pi)
    constant = constant - (slope * mixtures.means).sum(-1) / 2
    return torch.cat([constant[..., None], slope, inverse.flatten(-2) / -2], -1) @ features.T


def m_step(features: Tensor, memberships: Tensor, widening: Tensor) -> Mixtures:
    """Return the mixtures whose components have the weights (R, N, m) of the samples."""
    dimensions = len(widening)
    sums = memberships @ features
    total = sums[..., :1].clamp_min(MIN_WEIGHT)
    means = sums[..., 1 : 1 + dimensions] / total
    second = (sums[..., 1 + dimensions :] / total).unflatten(-1, (dimensions, dimensions))
    covariance = second - means[..., :, None] * means[..., None, :] + torch.diag(widening)
    log_weights = (sums[..., 0] / sums[..., 0].sum(1, keepdim=True)).log()
    return Mixtures(log_weights, means, whitening_matrix(covariance))


def expectation_maximisation(
    samples: Tensor, start: Tensor, widening: Tensor, rounds: int = MAX_EM_ROUNDS
) -> tuple[Tensor, Tensor]:
    """Run expectation maximisation of R mixtures: memberships (R, N, m), log-likelihoods (R,).

    Ends when no run's mean log-likelihood changes by more than ``LIKELIHOOD_TOLERANCE``.

    Args:
        samples: float64, roughly centred, shape (m, d).
        start: initial memberships, shape (R, N, m); a component without any stays empty.
        widening: variances added in each round, shape (d,).
        rounds: most rounds.
    """
    features, memberships = _polynomial_features(samples), start
    likelihood = samples.new_full((len(start),), -math.inf)
    limit = LIKELIHOOD_TOLERANCE * len(samples)
    for _ in range(rounds):
        parts = log_densities(features, m_step(features, memberships, widening))
        top = parts.amax(1, keepdim=True)
        memberships = (parts - top).exp_()
        total = memberships.sum(1, keepdim=True)
        memberships = memberships / total
        previous, likelihood = likelihood, (top + total.log())[:, 0].sum(1)
        if bool(((likelihood - previous).abs() <= limit).all()):
            break
    return memberships, likelihood


def k_means_plus_plus(samples: Tensor, numbers: Tensor, generator: torch.Generator) -> Tensor:
    """Run k-means++ for R runs: return one-hot memberships (R, N, m) of the nearest start.

    Each start is sampled with a probability proportional to the squared distance to the previous
    ones (Arthur and Vassilvitskii 2007). ``numbers`` (R,) are the starts of each run, N the
    largest.
    """
    max_count = int(numbers.max())
    equal = samples.new_ones(len(numbers), len(samples))
    probabilities, nearest = equal, torch.full_like(equal, math.inf)
    owner = torch.zeros(equal.shape, dtype=torch.int64)
    for number in range(max_count):
        chosen = torch.multinomial(probabilities, 1, generator=generator)[:, 0]
        squared = (samples - samples[chosen][:, None]).square().sum(-1)
        closer = (squared < nearest) & (number < numbers)[:, None]
        owner.masked_fill_(closer, number)
        nearest = torch.where(closer, squared, nearest)
        # Fewer distinct samples than starts: sample any; it stays without members.
        probabilities = torch.where(nearest.sum(1, keepdim=True) > 0, nearest, equal)
    return torch.nn.functional.one_hot(owner, max_count).mT.to(samples.dtype)


def count_parameters(components: Tensor, dimensions: int) -> Tensor:
    """Count the free parameters of N Gaussians: N-1 weights, N·d means, N·d(d+1)/2 variances."""
    size = dimensions + dimensions * (dimensions + 1) // 2
    return components - 1 + components * size


def _best_runs(
    samples: Tensor, numbers: list[int], widening: Tensor, restarts: int, generator: torch.Generator
) -> tuple[Mixtures, Tensor]:
    """Return the best mixture and its log-likelihood (len,) for each number of components.

    All starts run for a few rounds, and the best of each number to the end (Biernacki, Celeux and
    Govaert 2003).
    """
    # A single component needs one start.
    runs = torch.tensor([n for n in numbers for _ in range(restarts if n > 1 else 1)])
    start = k_means_plus_plus(samples, runs, generator)
    memberships, likelihoods = expectation_maximisation(samples, start, widening, TRIAL_EM_ROUNDS)
    best = torch.stack([likelihoods.masked_fill(runs != n, -math.inf).argmax() for n in numbers])
    memberships, likelihoods = expectation_maximisation(samples, memberships[best], widening)
    return m_step(_polynomial_features(samples), memberships, widening), likelihoods


def fit_mixture(road: RoadSamples, settings: MixtureSettings) -> DistanceModel:
    """Fit √(2 ln(peak/p)), p = Σ_n P_n N(x; μ_n, Σ_n) of P3, peak the sum of all peaks.

    The likeliest mixture of all starts; of several numbers of components that with the least
    Bayesian information criterion, parameters · ln m - 2 ln p. One component gives its Mahalanobis
    distance. P3's formula has no 1/2 in the exponent and no determinant, hence W·√2 and the bare
    weights.
    """
    centre, generator = road.samples.mean(0), road.generator
    samples = road.samples - centre
    max_count = min(settings.components, len(samples.unique(dim=0)))
    widening = WIDENING * samples.square().mean() + variance_floor(road.axes)
    if isinstance(settings, BestMixtureSettings):
        numbers = list(range(1, max_count + 1))
        runs, likelihoods = _best_runs(samples, numbers, widening, settings.restarts, generator)
        penalty = math.log(len(samples)) * count_parameters(torch.tensor(numbers), samples.shape[1])
        run = int((penalty - 2 * likelihoods).argmin())
    else:
        runs, _ = _best_runs(samples, [max_count], widening, settings.restarts, generator)
        run = 0
    # Without the components that the run does not have, the last in this order.
    order = runs.log_weights[run].argsort(descending=True, stable=True)
    order = order[: int(runs.log_weights[run].isfinite().sum())]
    log_weights, means, whiten = (part[run][order] for part in runs)
    if settings.formula == "density":
        log_weights = log_weights + whiten.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    else:
        whiten = whiten * 2**0.5
    # Relative to the sum of all peaks, which no density exceeds: precise near the peak.
    log_weights = (log_weights - log_weights.logsumexp(0)).float()
    offsets = -(whiten @ (means + centre)[..., None]).flatten(0, 1).float()
    whiten = whiten.float().contiguous()

    def distance(pixels: Tensor) -> Tensor:
        parts = torch.addmm(offsets, whiten.flatten(0, 1), pixels).unflatten(0, whiten.shape[:2])
        squared = parts[:, 0].square_()
        for axis in range(1, whiten.shape[1]):
            squared.addcmul_(parts[:, axis], parts[:, axis])
        if len(squared) == 1:
            return squared[0].sqrt_()
        exponents = torch.add(log_weights[:, None], squared, alpha=-0.5)
        # log-sum-exp: in float32 a density underflows at a distance of 14.
        top = exponents.clamp_min_(MIN_EXPONENT).amax(0)
        # Smaller terms do not change the sum, and subnormal numbers are slow.
        total = exponents.sub_(top).clamp_min_(-80).exp_().sum(0).log_()
        return total.add_(top).mul_(-2).clamp_min_(0).sqrt_()

    return DistanceModel(distance, 2 * means.numel() + 2 * len(means))


MIXTURES = tuple(
    Classifier(name, summary, settings, fit_mixture, paper={"formula": "paper"})
    for name, summary, settings in (
        ("mog2", "mixture of 2 Gaussians", MixtureSettings),
        ("mog4", "mixture of 4 Gaussians", LargerMixtureSettings),
        ("mog_opt", "mixture of Gaussians, their number chosen by BIC", BestMixtureSettings),
    )
)
"""Mixtures of P3."""
