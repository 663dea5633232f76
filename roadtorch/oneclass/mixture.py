"""Mixtures of 2, 4 and an optimised number of Gaussians (P3, section III-B).

All restarts, numbers of components and folds of one fit run side by side as one batch of
expectation maximisation in float64. Weights tell the samples that a run may see.
"""

import math
from functools import partial
from typing import Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.oneclass.base import (
    Classifier,
    ClassifierSettings,
    Learned,
    Road,
    rejecting_distance,
)
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


class MixtureSettings(ClassifierSettings):
    """A mixture of Gaussians."""

    components: int = Field(default=2, ge=1, le=64, description="number of Gaussians")
    restarts: int = Field(default=5, ge=1, le=100, description="starts, of which the best is kept")
    formula: Literal["density", "paper"] = Field(
        default="density",
        description="the density of a mixture, or the paper's formula, which lacks the 1/2 in the "
        "exponent and the determinants",
    )


class LargerMixtureSettings(MixtureSettings):
    """A mixture of four Gaussians."""

    components: int = Field(default=4, ge=1, le=64, description="number of Gaussians")


class BestMixtureSettings(MixtureSettings):
    """A mixture whose number of Gaussians is chosen for the samples."""

    components: int = Field(default=6, ge=1, le=64, description="the largest number tried")
    select: Literal["bic", "aic", "cv", "consistent"] = Field(
        default="bic",
        description="how the number is chosen (the paper does not say): by an information "
        "criterion, by the likelihood of held-out tenths, or the largest that rejects as few of "
        "these as asked",
    )


class Mixtures(NamedTuple):
    """Mixtures side by side, float64: R runs of N components each.

    log_shares (R,N), minus infinity where a run has fewer; means (R,N,d);
    whitening (R,N,d,d), Wᵀ W = Σ⁻¹.
    """

    log_shares: Tensor
    means: Tensor
    whitening: Tensor


# --- expectation maximisation -----------------------------------------------------------


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


def log_density(samples: Tensor, mixtures: Mixtures) -> Tensor:
    """ln p of samples (m,d) under each mixture: (R,m)."""
    return log_parts(_powers(samples), mixtures).logsumexp(1)


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


# --- how many -----------------------------------------------------------------------------


def parameters(components: Tensor, dimensions: int) -> Tensor:
    """Free numbers of mixtures of N Gaussians: N-1 shares, N·d means, N·d(d+1)/2 variances."""
    each = dimensions + dimensions * (dimensions + 1) // 2
    return components - 1 + components * each


def held_out(
    samples: Tensor, most: int, widening: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Mixtures of 1…most Gaussians learned without one tenth of the samples each.

    Returns ln p (most,folds,m) of all samples under them, and the tenth int64 (m,) of each.
    """
    count = len(samples)
    folds = min(10, count)
    fold = torch.randperm(count, generator=generator).remainder(folds)
    seen = (fold != torch.arange(folds)[:, None]).to(samples)
    numbers = torch.arange(1, most + 1).repeat_interleave(folds)
    weights = seen.repeat(most, 1)
    start = spread_starts(samples, weights, numbers, generator)
    shares, _ = maximise(samples, weights, start, widening)
    mixtures = mixtures_of(samples, shares * weights[:, None], widening)
    return log_density(samples, mixtures).reshape(most, folds, count), fold


def by_consistency(densities: Tensor, fold: Tensor, rejected: float) -> int:
    """The last number before clearly more held-out samples than f are rejected (Tax).

    Clearly: by two standard deviations, f + 2√(f(1-f)/m). The toolbox dd_tools returns the
    first number after that.
    """
    count = len(fold)
    limit = rejected + 2 * (rejected * (1 - rejected) / count) ** 0.5
    number = 1
    for tried, of_number in enumerate(-densities, start=1):
        edges = [
            rejecting_distance(row[fold != tenth].numpy(), rejected)
            for tenth, row in enumerate(of_number)
        ]
        outside = of_number[fold, torch.arange(count)] > torch.tensor(edges).to(of_number)[fold]
        if float(outside.double().mean()) > limit:
            break
        number = tried
    return number


def chosen_number(
    samples: Tensor,
    likelihoods: Tensor,
    widening: Tensor,
    settings: BestMixtureSettings,
    generator: torch.Generator,
) -> int:
    """How many Gaussians samples (m,d) call for; likelihoods (most,): the best ln p of 1…most."""
    count, dimensions = samples.shape
    most = len(likelihoods)
    penalty = {"bic": math.log(count), "aic": 2.0}.get(settings.select)
    if penalty is not None:
        paid = penalty * parameters(torch.arange(1, most + 1), dimensions)
        return 1 + int((paid - 2 * likelihoods).argmin())
    if count == 1:
        return 1
    densities, fold = held_out(samples, most, widening, generator)
    if settings.select == "cv":
        return 1 + int(densities[:, fold, torch.arange(count)].sum(1).argmax())
    return by_consistency(densities, fold, settings.rejected)


# --- the classifiers ------------------------------------------------------------------------


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
    """The likeliest mixture of all starts, of the number of components that is chosen."""
    centre, generator = road.samples.mean(0), road.generator
    samples = road.samples - centre
    most = min(settings.components, len(samples.unique(dim=0)))
    widening = WIDENING * samples.square().mean() + floor_of(road.axes)
    if isinstance(settings, BestMixtureSettings):
        numbers = list(range(1, most + 1))
        runs, likelihoods = _best_runs(samples, numbers, widening, settings.restarts, generator)
        run = chosen_number(samples, likelihoods, widening, settings, generator) - 1
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
    log_weights = log_weights - log_weights.logsumexp(0)
    means = means + centre
    distance = partial(
        mixture_distance,
        log_weights=log_weights.float(),
        whiten=whiten.float().contiguous(),
        offsets=-(whiten @ means[..., None]).flatten(0, 1).float(),
    )
    return Learned(distance, 2 * means.numel() + 2 * len(means))


def mixture_distance(
    pixels: Tensor, log_weights: Tensor, whiten: Tensor, offsets: Tensor
) -> Tensor:
    """√(2 ln(peak/p)) of pixels (d,n): (n,), with p = Σ_n P_n N(x; μ_n, Σ_n) of P3.

    ``peak`` is the sum of the components' peaks. One component gives its Mahalanobis
    distance. Nothing is exponentiated before the largest term is taken out: in float32 a
    density underflows at a distance of 14. P3's formula has no 1/2 in the exponent and no
    determinant; for that there are W·√2 and the bare shares. whiten: W (N,d,d); offsets: -Wμ.
    """
    parts = torch.addmm(offsets, whiten.flatten(0, 1), pixels).unflatten(0, whiten.shape[:2])
    squared = parts[:, 0].square_()
    for axis in range(1, whiten.shape[1]):
        squared.addcmul_(parts[:, axis], parts[:, axis])
    if len(squared) == 1:
        return squared[0].sqrt_()
    exponents = torch.add(log_weights[:, None], squared, alpha=-0.5)
    top = exponents.clamp_min_(MIN_EXPONENT).amax(0)
    # Below that they are lost in the sum, and subnormal numbers are slow.
    total = exponents.sub_(top).clamp_min_(-80).exp_().sum(0).log_()
    return total.add_(top).mul_(-2).clamp_min_(0).sqrt_()


CLASSIFIERS = tuple(
    Classifier(name, summary, settings, fit_mixture, paper={"formula": "paper"})
    for name, summary, settings in (
        ("mog2", "mixture of 2 Gaussians", MixtureSettings),
        ("mog4", "mixture of 4 Gaussians", LargerMixtureSettings),
        ("mog_opt", "mixture of as many Gaussians as the samples call for", BestMixtureSettings),
    )
)
"""The mixtures of P3."""
