"""One-class classifiers that optimise a boundary (P3): SVDD, MPM, dLP.

Fits are in double precision, on the distinct samples with their counts: exact, and small where
thousands of pixels have a few hundred values.
"""

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field
from scipy.sparse import eye_array, hstack
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.oneclass.base import Classifier, ClassifierSettings, DistanceModel, RoadSamples
from roadtorch.oneclass.neighbours import distinct_samples, squared_distances

Width = Annotated[float, Field(ge=1e-6, le=1e6)]

VIOLATION = 1e-7  # fraction of the kernel's range by which the smallest ball may violate optimality


class SvddSettings(ClassifierSettings):
    """Support vector data description."""

    sigma: Width = Field(
        default=5.0, description="σ of the kernel exp(-|x-y|²/σ²) in units of the planes"
    )
    threshold: Literal["radius", "quantile"] = Field(
        default="radius", description="threshold: the ball's radius, or the rejected fraction"
    )


def smallest_ball(gram: np.ndarray, caps: np.ndarray) -> np.ndarray:
    """Return weights a (k,) of the centre Σ a_i φ(y_i) of the smallest soft ball around samples.

    Minimises aᵀ G a with Σ a = 1, 0 ≤ a_i ≤ caps_i: the dual of min R² + C Σ ξ for samples of equal
    norm. Sequential minimal optimisation: the most violating weight moves with the one that gains
    most (Fan, Chen and Lin, JMLR 2005), until no pair violates optimality by more than
    ``VIOLATION`` of the kernel's range, or for 1000 + 200 k steps.

    Args:
        gram: kernel matrix of the samples, up to an additive constant, shape (k, k).
        caps: C times the count of each sample, with a sum ≥ 1, shape (k,).
    """
    weights = np.minimum(caps, np.maximum(0.0, 1 - np.cumsum(caps) + caps))
    slope = gram @ weights
    diagonal = np.diagonal(gram)
    allowed = VIOLATION * (gram.max() - gram.min())
    for _ in range(1000 + 200 * len(gram)):
        rising = np.where(weights < caps, slope, np.inf).argmin()
        excess = np.where(weights > 0, slope - slope[rising], 0)
        if excess.max() <= allowed:
            break
        curvature = np.maximum(diagonal + diagonal[rising] - 2 * gram[rising], np.finfo(float).tiny)
        falling = (np.maximum(excess, 0) ** 2 / curvature).argmax()
        limit = min(caps[rising] - weights[rising], weights[falling])
        step = min(excess[falling] / curvature[falling], limit)
        slope += step * (gram[rising] - gram[falling])
        # Exactly the bound where it is reached, for the comparisons above.
        full = caps[rising] - weights[rising] <= step
        weights[rising] = caps[rising] if full else weights[rising] + step
        weights[falling] = 0 if weights[falling] <= step else weights[falling] - step
    return weights


def ball_radius(squared: np.ndarray, weights: np.ndarray, caps: np.ndarray) -> float:
    """Return the squared radius: the mean of ``squared`` (k,) where 0 < a < cap, on the sphere.

    Without such samples, the middle of the interval that optimality allows.
    """
    on_sphere = (weights > 1e-8 * caps) & (weights < caps * (1 - 1e-8))
    if on_sphere.any():
        return float(squared[on_sphere].mean())
    inside, outside = squared[weights < caps / 2], squared[weights >= caps / 2]
    return float((inside.max() + outside.min()) / 2) if len(inside) else float(outside.min())


def fit_svdd(road: RoadSamples, settings: SvddSettings) -> DistanceModel:
    """Fit P3's distance to the centre of the smallest soft ball, in the kernel's space.

    |φ(x) - Σ a_i φ(y_i)|² = 1 + aᵀKa - 2 Σ a_i K(x, y_i), computed with K - 1 as Σ a = 1, for K is
    1 - 1e-5 where the width is much larger than the distances.

    With σ = 5 on planes of order 1, the toolbox's width, the kernel is nearly linear and the
    distance is that to the centre of the smallest soft ball in colour space: so it is in P3's
    results, where SVDD, dLP and MPM agree within 0.2 in every combination.
    """
    samples, counts = distinct_samples("svdd", road.samples)
    width = settings.sigma
    gram = torch.expm1(-squared_distances(samples.T, samples) / width**2).numpy()
    # A cap above 1 binds no weight; a single sample is then on the sphere.
    caps = np.minimum(counts.numpy() / max(settings.rejected * len(road.samples), 1e-9), 2.0)
    solution = smallest_ball(gram, caps)
    centre = float(solution @ gram @ solution)
    squared = np.maximum(centre - 2 * gram @ solution, 0)
    radius = ball_radius(squared, solution, caps) ** 0.5 if settings.threshold == "radius" else None
    support = torch.from_numpy(solution > 0)
    points, weights = samples[support].float(), torch.from_numpy(solution)[support].float()
    scale = torch.tensor(-1 / width**2, dtype=torch.float32)
    norm = torch.tensor(centre, dtype=torch.float32)

    def distance(planes: Tensor) -> Tensor:
        exponent = squared_distances(planes, points).mul_(scale)
        near = weights @ torch.expm1(exponent, out=exponent)
        return (norm - 2 * near).clamp_(min=0).sqrt_()

    return DistanceModel(distance, max(len(points), 4), threshold=radius)


PixelFunction = Callable[[Tensor], Tensor]  # function of planes (d, n) with values (n,)


def excess_over_minimum(
    measure: PixelFunction, points: Tensor, counts: Tensor, dtype: torch.dtype
) -> PixelFunction:
    """Return a function of values (n,): their excess over the samples' minimum, > 0, increasing.

    The minimum is over the distinct samples (k, d), with counts (k,), and their mean (two samples
    alone have the same value). An excess t becomes t + u, with u a thousandth of the samples' mean
    t; for t < 0 it becomes u²/(u - t), as clipping at 0 would lose the ranks there; 0 for t ≤ 0 if
    u = 0.
    """
    weights = counts / counts.sum()
    values = measure(points.T)
    least = torch.minimum(values.min(), measure((weights @ points)[:, None])[0])
    unit = ((weights @ values - least).clamp(min=0) / 1000).to(dtype)
    least = least.to(dtype)

    def excess(values: Tensor) -> Tensor:
        over = values - least
        better = unit**2 / (unit - over.clamp(max=0)).clamp_(min=torch.finfo(values.dtype).tiny)
        return torch.where(over > 0, over + unit, better)

    return excess


class MinimaxSettings(ClassifierSettings):
    """Minimax probability machine."""

    sigma: Width = Field(
        default=1.0, description="σ of the kernel exp(-|x-y|²/σ²) in units of the planes"
    )
    ridge: float = Field(
        default=1e-6, gt=0, le=1e3, description="λ, added to the covariance's diagonal"
    )


def minimax_direction(features: np.ndarray, counts: np.ndarray, ridge: float) -> np.ndarray:
    """Return g (k,) with least √(gᵀMg) where gᵀf̄ = 1: M⁻¹f̄ / ξ², ξ² = f̄ᵀM⁻¹f̄ (Lanckriet).

    ``features`` (k, k) has a row and a column for each distinct sample, with counts (k,); f̄ is
    their mean, M their covariance (divisor m) + ridge·I over all samples; g is summed over
    duplicates.

    The half-space gᵀf ≥ b has at least the fraction α of every distribution with this mean and
    covariance, for b = 1 - κ/ξ and as long as ξ > κ = √(α/(1-α)). P3 fixes α = 1 - f; the toolbox
    has κ upside down. Neither b nor κ changes a rank.
    """
    mean = counts @ features / counts.sum()
    rows = (features - mean) * np.sqrt(counts / counts.sum())[:, None] * np.sqrt(counts)
    mean = mean * np.sqrt(counts)
    solved = np.linalg.solve(rows.T @ rows + ridge * np.eye(len(mean)), mean)
    return np.sqrt(counts) * solved / float(mean @ solved)


def minimax_score(points: Tensor, counts: Tensor, settings: MinimaxSettings) -> PixelFunction:
    """Return the function gᵀf(x) = Σ g_i K(x, y_i), higher is more road-like: float64 (n,).

    ``points`` (k, d) are the distinct samples, with counts (k,). In double precision: the terms
    have both signs and cancel, and differences among the samples are below single precision.
    """
    numbers = counts.double().numpy()
    scale = torch.tensor(-1 / settings.sigma**2, dtype=torch.float64)
    gram = torch.exp(squared_distances(points.T, points) * scale).numpy()
    weights = torch.from_numpy(minimax_direction(gram, numbers, settings.ridge))
    return lambda planes: weights @ squared_distances(planes, points).mul_(scale).exp_()


def fit_minimax(road: RoadSamples, settings: MinimaxSettings) -> DistanceModel:
    """Fit P3's MPM as a distance: the root of how far the score is below a sample's best.

    Like |x - centre| near the samples.
    """
    points, counts = distinct_samples("mpm", road.samples)
    score = minimax_score(points, counts, settings)
    excess = excess_over_minimum(
        lambda planes: -score(planes), points, counts.double(), torch.float64
    )
    return DistanceModel(lambda planes: excess(-score(planes)).sqrt_().float(), 2 * len(points))


def _sigmoid(distances: Tensor) -> Tensor:
    """Return the toolbox's 4/(1+exp(-d)) - 2, in place; exact near 0 and twice as fast as tanh."""
    values = distances.neg_().expm1_()
    return values.div_(values + 2).mul_(-2)


DISSIMILARITIES: dict[str, PixelFunction] = {
    "toolbox": _sigmoid,
    "euclid": lambda squared: squared.sqrt_(),
}
"""Functions of squared distances, in place."""

MAX_CONSTRAINTS = 1024
"""Most distinct samples of the linear program; the solver's time grows with the cube."""


class LinearSettings(ClassifierSettings):
    """Linear programming distance description."""

    dissimilarity: Literal["toolbox", "euclid"] = Field(
        default="toolbox",
        description="sigmoid of the squared distance (dd_tools; matches the paper's results), or "
        "the distance (the paper's text)",
    )
    threshold: Literal["margin", "quantile"] = Field(
        default="margin", description="threshold: ρ of the linear program, or the rejected fraction"
    )


def least_margin(
    dissimilarities: np.ndarray, counts: np.ndarray, rejected: float
) -> tuple[np.ndarray, float]:
    """Solve min ρ + Σ ξ_i / (ν m), Σ_j w_j d_ij ≤ ρ + ξ_i, Σ w = 1, w, ξ ≥ 0 (Pekalska et al.).

    Returns w (k,) and ρ for dissimilarities (k, k) between distinct samples with counts (k,), m in
    all; ν = ``rejected``, 0 for no ξ. Equivalent to a game: a mixture w of samples against a worst
    mixture p of samples, none of which has more than 1/(ν m).
    """
    from scipy.optimize import linprog  # slow to import

    number = len(counts)
    budget = rejected * counts.sum()
    slack = counts / budget if budget > 0 else np.full(number, np.inf)
    # At a price of 1 or more no sample is excluded: 2 is as good as infinity.
    slack = np.minimum(slack, 2.0)
    bounds = hstack([dissimilarities, -np.ones((number, 1)), -eye_array(number)], format="csc")
    total = np.concatenate([np.ones(number), np.zeros(number + 1)])[None]
    solution = linprog(
        np.concatenate([np.zeros(number), [1.0], slack]),
        A_ub=bounds,
        b_ub=np.zeros(number),
        A_eq=total,
        b_eq=[1.0],
        method="highs",
    )
    if not solution.success:
        raise InputError("dlp", f"the linear program failed: {solution.message}", "report it")
    weights = np.where(solution.x[:number] > 1e-10, solution.x[:number], 0)
    return weights / weights.sum(), float(solution.x[number])


def fit_linear(road: RoadSamples, settings: LinearSettings) -> DistanceModel:
    """Fit P3's L = Σ_j w_j d(x, y_j), over the few samples with a weight, minus its least value.

    Its root where the dissimilarity is nearly a squared distance. P3's sum runs over the wrong
    index. Its d is "distance"; only with the toolbox's, nearly squared, does dLP equal SVDD within
    0.1 in 18 of 19 columns, as it does in P3's results.
    """
    points, counts = distinct_samples("dlp", road.samples, MAX_CONSTRAINTS)
    dissimilarity = DISSIMILARITIES[settings.dissimilarity]
    between = dissimilarity(squared_distances(points.T, points))
    # The solver's tolerances are absolute: they are small for dissimilarities with mean 1.
    scale = float(between.mean()) or 1.0
    weights, margin = least_margin(between.numpy() / scale, counts.numpy(), settings.rejected)
    support = torch.from_numpy(weights > 0)
    few, mixing = points[support], torch.from_numpy(weights)[support]
    exact = weighted_sum(few, mixing, dissimilarity)
    excess = excess_over_minimum(exact, points, counts.double(), torch.float32)
    mixed = weighted_sum(few.float(), mixing.float(), dissimilarity)

    def as_distance(values: Tensor) -> Tensor:
        distance = excess(values)
        return distance.sqrt_() if settings.dissimilarity == "toolbox" else distance

    threshold = None
    if settings.threshold == "margin":
        threshold = float(as_distance(torch.tensor(margin * scale).float()))
    return DistanceModel(
        lambda planes: as_distance(mixed(planes)), max(len(few), 4), threshold=threshold
    )


def weighted_sum(points: Tensor, weights: Tensor, dissimilarity: PixelFunction) -> PixelFunction:
    """Return the function Σ_j w_j d(x, y_j) of planes, for points (s, d) and weights (s,)."""
    return lambda planes: weights @ dissimilarity(squared_distances(planes, points))


SVDD = Classifier(
    "svdd",
    "distance to the centre of the smallest soft ball around the samples",
    SvddSettings,
    fit_svdd,
)
MPM = Classifier("mpm", "minimax probability machine", MinimaxSettings, fit_minimax)
DLP = Classifier(
    "dlp",
    "weighted sum of distances to a few samples, by linear programming",
    LinearSettings,
    fit_linear,
    paper={"dissimilarity": "euclid"},
)
