"""Mixtures of 2, 4 and an optimised number of Gaussians (P3, section III-B).

All restarts, numbers of components and folds of one fit run side by side as one batch of
expectation maximisation in float64. Weights tell the samples that a run may see.
"""

import math
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.oneclass.base import Classifier, ClassifierSettings, Learned, Road
from roadtorch.oneclass.density import floor_of, whitening

MAX_ROUNDS = 100
"""Of expectation maximisation at most."""

TOLERANCE = 1e-3
"""It ends when the mean log-likelihood of the samples changes by less, as in scikit-learn.
The toolbox dd_tools goes on until the sum changes by less than 1e-6 of itself."""

TRIAL_ROUNDS = 10
"""Rounds of each start before the best of them goes on."""

MIN_EXPONENT = -1e37
"""Of two infinite ones the difference would be no number."""

WIDENING = 0.01
"""Share of the samples' mean variance added to each component's (dd_tools)."""

MIN_WEIGHT = 1e-300
"""Stands for no weight at all where a logarithm is taken."""


Components = Annotated[int, Field(ge=1, le=64, description="number of Gaussians")]


class MixtureSettings(ClassifierSettings):
    """A mixture of Gaussians."""

    components: Components = 2
    restarts: int = Field(default=5, ge=1, le=100, description="starts, of which the best is kept")
    formula: Literal["density", "paper"] = Field(
        default="density",
        description="the density of a mixture, or the paper's formula, which lacks the 1/2 in the "
        "exponent and the determinants",
    )


class LargerMixtureSettings(MixtureSettings):
    """A mixture of four Gaussians."""

    components: Components = 4


class BestMixtureSettings(MixtureSettings):
    """A mixture whose number of Gaussians is chosen by BIC; the paper does not say how."""

    components: int = Field(default=6, ge=1, le=64, description="the largest number tried")


class Mixtures(NamedTuple):
    """Mixtures side by side, float64: R runs of N components each.

    log_shares (R,N), minus infinity where a run has fewer; means (R,N,d);
    whitening (R,N,d,d), Wᵀ W = Σ⁻¹.
    """

    log_shares: Tensor
    means: Tensor
    whitening: Tensor


def _powers(samples: Tensor) -> Tensor:
    """1, x and xxᵀ of samples (m,d): (m, 1+d+d²). All that is asked of them is linear in these."""
    squares = (samples[:, :, None] * samples[:, None, :]).flatten(1)
    return torch.cat([samples.new_ones(len(samples), 1), samples, squares], 1)


def log_parts(powers: Tensor, mixtures: Mixtures) -> Tensor:
    """ln P_n N(x; μ_n, Σ_n) of the powers of samples, about centred: (R,N,m).

    P3 with its factors.
    """
    dimensions = mixtures.means.shape[-1]
    inverse = mixtures.whitening.mT @ mixtures.whitening
    slope = (inverse @ mixtures.means[..., None])[..., 0]
    volume = mixtures.whitening.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    constant = mixtures.log_shares + volume - dimensions / 2 * math.log(2 * math.pi)
    constant = constant - (slope * mixtures.means).sum(-1) / 2
    factors = torch.cat([constant[..., None], slope, inverse.flatten(-2) / -2], -1)
    return factors @ powers.T


def _maximised(powers: Tensor, shares: Tensor, widening: Tensor) -> Mixtures:
    """The mixtures whose components have the weights (R,N,m) of the samples."""
    dimensions = len(widening)
    sums = shares @ powers
    total = sums[..., :1].clamp_min(MIN_WEIGHT)
    means = sums[..., 1 : 1 + dimensions] / total
    second = (sums[..., 1 + dimensions :] / total).unflatten(-1, (dimensions, dimensions))
    covariance = second - means[..., :, None] * means[..., None, :] + torch.diag(widening)
    log_shares = (sums[..., 0] / sums[..., 0].sum(1, keepdim=True)).log()
    return Mixtures(log_shares, means, whitening(covariance))


def maximise(
    samples: Tensor, weights: Tensor, start: Tensor, widening: Tensor, rounds: int = MAX_ROUNDS
) -> tuple[Tensor, Tensor]:
    """Expectation maximisation of R mixtures at once: memberships (R,N,m), likelihoods (R,).

    samples: float64 (m,d), about centred. weights: (R,m), 1 for a sample that a run sees,
    else 0. start: memberships of the samples; a component without any stays empty.
    widening: (d,), added to the variances in each round. Ends when no run's mean
    log-likelihood changes by more than ``TOLERANCE``. The likelihoods are those of the last
    mixtures, from which the memberships come; ``mixtures_of`` makes the next ones.
    """
    powers, shares = _powers(samples), start
    before = samples.new_full((len(weights),), -math.inf)
    limit = TOLERANCE * weights.sum(1)
    for _ in range(rounds):
        parts = log_parts(powers, _maximised(powers, shares * weights[:, None], widening))
        top = parts.amax(1, keepdim=True)
        shares = (parts - top).exp_()
        total = shares.sum(1, keepdim=True)
        shares = shares / total
        after = ((top + total.log())[:, 0] * weights).sum(1)
        if bool(((after - before).abs() <= limit).all()):
            return shares, after
        before = after
    return shares, before


def mixtures_of(samples: Tensor, shares: Tensor, widening: Tensor) -> Mixtures:
    """The mixtures whose components have the memberships (R,N,m) of samples (m,d)."""
    return _maximised(_powers(samples), shares, widening)


def spread_starts(
    samples: Tensor, weights: Tensor, numbers: Tensor, generator: torch.Generator
) -> Tensor:
    """k-means++ for R runs: one-hot memberships (R,N,m) of the nearest start.

    Each next start is drawn with a probability that grows as the squared distance to those
    before (Arthur and Vassilvitskii 2007). weights: (R,m), samples with 0 are not drawn;
    numbers: int64 (R,), how many starts a run has, N the largest.
    """
    most = int(numbers.max())
    runs = torch.arange(len(weights))
    chances, nearest = weights.clone(), samples.new_full(weights.shape, math.inf)
    owner = torch.zeros(weights.shape, dtype=torch.int64)
    for number in range(most):
        drawn = torch.multinomial(chances, 1, generator=generator)[:, 0]
        squared = (samples - samples[drawn][:, None]).square().sum(-1)
        closer = (squared < nearest) & (number < numbers)[runs, None]
        owner.masked_fill_(closer, number)
        nearest = torch.where(closer, squared, nearest)
        chances = nearest * weights
        # Fewer different samples than starts: draw any, it stays without members.
        chances = torch.where(chances.sum(1, keepdim=True) > 0, chances, weights)
    return torch.nn.functional.one_hot(owner, most).mT.to(samples.dtype)


def parameters(components: Tensor, dimensions: int) -> Tensor:
    """Free numbers of mixtures of N Gaussians: N-1 shares, N·d means, N·d(d+1)/2 variances."""
    each = dimensions + dimensions * (dimensions + 1) // 2
    return components - 1 + components * each


def _best_runs(
    samples: Tensor, numbers: list[int], widening: Tensor, restarts: int, generator: torch.Generator
) -> tuple[Mixtures, Tensor]:
    """For each number of components the best mixture and its log-likelihood: (len,).

    All starts run for a few rounds, and the best of each number to the end (Biernacki,
    Celeux and Govaert 2003).
    """
    # A single component has but one start.
    runs = torch.tensor([n for n in numbers for _ in range(restarts if n > 1 else 1)])
    weights = samples.new_ones(len(runs), len(samples))
    start = spread_starts(samples, weights, runs, generator)
    shares, likelihoods = maximise(samples, weights, start, widening, TRIAL_ROUNDS)
    best = torch.stack([likelihoods.masked_fill(runs != n, -math.inf).argmax() for n in numbers])
    shares, likelihoods = maximise(samples, weights[best], shares[best], widening)
    return mixtures_of(samples, shares, widening), likelihoods


def fit_mixture(road: Road, settings: MixtureSettings) -> Learned:
    """√(2 ln(peak/p)), p = Σ_n P_n N(x; μ_n, Σ_n) of P3, ``peak`` the sum of the components' peaks.

    The likeliest mixture of all starts; of several numbers of components that of the least
    Bayesian information criterion, numbers · ln m - 2 ln p. One
    component gives its Mahalanobis distance. P3's formula has no 1/2 in the exponent and no
    determinant; for that there are W·√2 and the bare shares.
    """
    centre, generator = road.samples.mean(0), road.generator
    samples = road.samples - centre
    most = min(settings.components, len(samples.unique(dim=0)))
    widening = WIDENING * samples.square().mean() + floor_of(road.axes)
    if isinstance(settings, BestMixtureSettings):
        numbers = list(range(1, most + 1))
        runs, likelihoods = _best_runs(samples, numbers, widening, settings.restarts, generator)
        paid = math.log(len(samples)) * parameters(torch.arange(1, most + 1), samples.shape[1])
        run = int((paid - 2 * likelihoods).argmin())
    else:
        runs, _ = _best_runs(samples, [most], widening, settings.restarts, generator)
        run = 0
    # Without the components that the run does not have; they are the last of this order.
    order = runs.log_shares[run].argsort(descending=True, stable=True)
    order = order[: int(runs.log_shares[run].isfinite().sum())]
    log_weights, means, whiten = (part[run][order] for part in runs)
    if settings.formula == "density":
        log_weights = log_weights + whiten.diagonal(dim1=-2, dim2=-1).log().sum(-1)
    else:
        whiten = whiten * 2**0.5
    # Of the sum of all peaks, which no density exceeds: then near the top little is lost.
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
        # Nothing is exponentiated before the largest term is taken out: in float32 a density
        # underflows at a distance of 14.
        top = exponents.clamp_min_(MIN_EXPONENT).amax(0)
        # Below that they are lost in the sum, and subnormal numbers are slow.
        total = exponents.sub_(top).clamp_min_(-80).exp_().sum(0).log_()
        return total.add_(top).mul_(-2).clamp_min_(0).sqrt_()

    return Learned(distance, 2 * means.numel() + 2 * len(means))


CLASSIFIERS = tuple(
    Classifier(name, summary, settings, fit_mixture, paper={"formula": "paper"})
    for name, summary, settings in (
        ("mog2", "mixture of 2 Gaussians", MixtureSettings),
        ("mog4", "mixture of 4 Gaussians", LargerMixtureSettings),
        ("mog_opt", "mixture of as many Gaussians as the samples call for", BestMixtureSettings),
    )
)
"""The mixtures of P3."""
