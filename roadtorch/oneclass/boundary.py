"""One-class classifiers that draw a boundary by optimisation (P3): SVDD, MPM, dLP.

Fits are in double precision, on the different samples with their numbers: exact, and small
even where thousands of pixels share a few hundred values.
"""

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
import torch
from pydantic import Field
from scipy.sparse import eye_array, hstack
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.oneclass.base import Classifier, ClassifierSettings, Learned, Road
from roadtorch.oneclass.neighbours import few_distinct, squared_distances

Width = Annotated[float, Field(ge=1e-6, le=1e6)]

VIOLATION = 1e-7
"""Share of the kernel's range by which the smallest ball may miss its optimum."""


class SvddSettings(ClassifierSettings):
    """Support vector data description."""

    sigma: Width | Literal["median"] = Field(
        default=5.0,
        description="width of the kernel exp(-|x-y|²/σ²) in units of the planes, or the median "
        "distance between samples",
    )
    threshold: Literal["radius", "quantile"] = Field(
        default="radius",
        description="the threshold is the ball's own radius, or the rejected fraction",
    )


def smallest_ball(gram: np.ndarray, caps: np.ndarray) -> np.ndarray:
    """Weights a (k,) of the centre Σ a_i φ(y_i) of the smallest soft ball around samples.

    Minimises aᵀ G a with Σ a = 1, 0 ≤ a_i ≤ caps_i: the dual of min R² + C Σ ξ for samples of
    equal norm. gram: (k,k), the kernel, less any constant; caps: C times how often a sample
    occurs, with Σ caps ≥ 1. Pairs of weights are moved, the most violating one with the one
    that gains most (Fan, Chen and Lin, JMLR 2005), until no pair violates the conditions of
    optimality by more than ``VIOLATION`` of the kernel's range; a kernel much wider than the
    gaps between samples and much narrower than all of them may stop at a hundred times that.
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
        bend = np.maximum(diagonal + diagonal[rising] - 2 * gram[rising], np.finfo(float).tiny)
        falling = (np.maximum(excess, 0) ** 2 / bend).argmax()
        room = min(caps[rising] - weights[rising], weights[falling])
        step = min(excess[falling] / bend[falling], room)
        slope += step * (gram[rising] - gram[falling])
        # Set to the bound exactly where it is reached, for the comparisons above.
        full = caps[rising] - weights[rising] <= step
        weights[rising] = caps[rising] if full else weights[rising] + step
        weights[falling] = 0 if weights[falling] <= step else weights[falling] - step
    return weights


def ball_radius(squared: np.ndarray, weights: np.ndarray, caps: np.ndarray) -> float:
    """The squared radius: mean of ``squared`` (k,) over samples on the sphere, 0 < a < cap.

    Where there are none, the middle of what the conditions of optimality allow.
    """
    on_sphere = (weights > 1e-8 * caps) & (weights < caps * (1 - 1e-8))
    if on_sphere.any():
        return float(squared[on_sphere].mean())
    inside, outside = squared[weights < caps / 2], squared[weights >= caps / 2]
    return float((inside.max() + outside.min()) / 2) if len(inside) else float(outside.min())


def _median_distance(points: Tensor, counts: Tensor) -> float:
    """Of all pairs of samples, twins included; their mean where the median is 0."""
    distances = squared_distances(points.T, points).sqrt()
    pairs = counts[:, None] * counts
    pairs.diagonal().sub_(counts)
    flat, order = distances.flatten().sort()
    below = pairs.flatten()[order].cumsum(0)
    median = flat[torch.searchsorted(below, (below[-1] + 1) // 2)]
    return float(median) or float((distances * pairs).sum() / below[-1].clamp(min=1)) or 1.0


def fit_svdd(road: Road, settings: SvddSettings) -> Learned:
    """P3: the distance of a pixel to the centre of the smallest soft ball, in the kernel's space.

    |φ(x) - Σ a_i φ(y_i)|² = 1 + aᵀKa - 2 Σ a_i K(x, y_i), written with K - 1 as Σ a = 1, for
    K is 1 - 1e-5 where the width is much larger than the distances.

    With σ = 5 on planes of order 1, the toolbox's width, the kernel is all but linear and
    the distance is that to the centre of the smallest soft ball in colour space: so it is in
    P3's results, where SVDD, dLP and MPM agree within 0.2 in every combination.
    """
    samples, counts = few_distinct("svdd", road.samples)
    width = settings.sigma if settings.sigma != "median" else _median_distance(samples, counts)
    gram = torch.expm1(-squared_distances(samples.T, samples) / width**2).numpy()
    # A cap above 1 binds no weight, and one sample alone is then on the sphere.
    caps = np.minimum(counts.numpy() / max(settings.rejected * len(road.samples), 1e-9), 2.0)
    solution = smallest_ball(gram, caps)
    centre = float(solution @ gram @ solution)
    squared = np.maximum(centre - 2 * gram @ solution, 0)
    radius = ball_radius(squared, solution, caps) ** 0.5 if settings.threshold == "radius" else None
    kept = torch.from_numpy(solution > 0)
    points, weights = samples[kept].float(), torch.from_numpy(solution)[kept].float()
    scale = torch.tensor(-1 / width**2, dtype=torch.float32)
    norm = torch.tensor(centre, dtype=torch.float32)

    def distance(planes: Tensor) -> Tensor:
        exponent = squared_distances(planes, points).mul_(scale)
        near = weights @ torch.expm1(exponent, out=exponent)
        return (norm - 2 * near).clamp_(min=0).sqrt_()

    return Learned(distance, max(len(points), 4), threshold=radius)


Measure = Callable[[Tensor], Tensor]
"""Of planes (d,n): (n,)."""


def excess_over(measure: Measure, points: Tensor, counts: Tensor, kind: torch.dtype) -> Measure:
    """How far values (n,) of a measure lie above the least one known: > 0, and rising with them.

    The least known is that of the different samples (k,d), which occur counts (k,) times, and of
    their mean (two samples alone have the same value). t above it is t + u, u the thousandth part
    of the samples' mean t, and u²/(u - t) where a pixel does better (t < 0): what is merely cut
    off at 0 would lose the ranks there. 0 for t ≤ 0 if u = 0. kind: of the values.
    """
    shares = counts / counts.sum()
    values = measure(points.T)
    least = torch.minimum(values.min(), measure((shares @ points)[:, None])[0])
    unit = ((shares @ values - least).clamp(min=0) / 1000).to(kind)
    least = least.to(kind)

    def excess(values: Tensor) -> Tensor:
        over = values - least
        better = unit**2 / (unit - over.clamp(max=0)).clamp_(min=torch.finfo(values.dtype).tiny)
        return torch.where(over > 0, over + unit, better)

    return excess


class MinimaxSettings(ClassifierSettings):
    """Minimax probability machine."""

    sigma: Width = Field(
        default=1.0, description="width of the kernel exp(-|x-y|²/σ²) in units of the planes"
    )
    ridge: float = Field(
        default=1e-6, gt=0, le=1e3, description="λ, added to the covariance's diagonal"
    )


def minimax_direction(features: np.ndarray, counts: np.ndarray, ridge: float) -> np.ndarray:
    """Lanckriet et al.: g with least √(gᵀMg) where gᵀf̄ = 1, that is M⁻¹f̄ / ξ², ξ² = f̄ᵀM⁻¹f̄.

    features: (k,k), a row and a column for each of the different samples, which occur counts (k,)
    times; f̄: their mean, M: their covariance (divisor m) + ridge·I, of a feature for every sample.
    Returns g (k,), summed over twins.

    The half-space gᵀf ≥ b keeps at least the share α of every distribution with this mean
    and covariance, for b = 1 - κ/ξ and as long as ξ > κ = √(α/(1-α)). P3 fixes α = 1 - f;
    the toolbox has κ upside down. Neither b nor κ changes a rank.
    """
    mean = counts @ features / counts.sum()
    rows = (features - mean) * np.sqrt(counts / counts.sum())[:, None] * np.sqrt(counts)
    mean = mean * np.sqrt(counts)
    solved = np.linalg.solve(rows.T @ rows + ridge * np.eye(len(mean)), mean)
    return np.sqrt(counts) * solved / float(mean @ solved)


def minimax_score(points: Tensor, counts: Tensor, settings: MinimaxSettings) -> Measure:
    """gᵀf(x) = Σ g_i K(x, y_i), higher is more road-like: float64 (n,).

    points: the different samples (k,d), which occur counts (k,) times. In double precision: the
    terms have both signs and cancel, and in the interior of the samples what remains differs by
    less than single precision can tell.
    """
    numbers = counts.double().numpy()
    scale = torch.tensor(-1 / settings.sigma**2, dtype=torch.float64)
    gram = torch.exp(squared_distances(points.T, points) * scale).numpy()
    weights = torch.from_numpy(minimax_direction(gram, numbers, settings.ridge))
    return lambda planes: weights @ squared_distances(planes, points).mul_(scale).exp_()


def fit_minimax(road: Road, settings: MinimaxSettings) -> Learned:
    """P3's MPM as a distance: the root of how far the score lies below a sample's best.

    Like |x - centre| near the samples.
    """
    points, counts = few_distinct("mpm", road.samples)
    score = minimax_score(points, counts, settings)
    excess = excess_over(lambda planes: -score(planes), points, counts.double(), torch.float64)
    return Learned(lambda planes: excess(-score(planes)).sqrt_().float(), 2 * len(points))


def _sigmoid(distances: Tensor) -> Tensor:
    """The toolbox's 4/(1+exp(-d)) - 2, in place; exact near 0 and twice as fast as tanh."""
    fallen = distances.neg_().expm1_()
    return fallen.div_(fallen + 2).mul_(-2)


DISSIMILARITIES: dict[str, Measure] = {
    "toolbox": _sigmoid,
    "euclid": lambda squared: squared.sqrt_(),
}
"""From squared distances, in place."""

MAX_CONSTRAINTS = 1024
"""Distinct samples that the linear programme takes; the solver's time grows with the cube."""


class LinearSettings(ClassifierSettings):
    """Linear programming distance description."""

    dissimilarity: Literal["toolbox", "euclid"] = Field(
        default="toolbox",
        description="sigmoid of the squared distance (dd_tools; the paper's results ask for it), "
        "or the distance (the paper's words)",
    )
    threshold: Literal["margin", "quantile"] = Field(
        default="margin",
        description="the threshold is the programme's own ρ, or the rejected fraction",
    )


def least_margin(
    dissimilarities: np.ndarray, counts: np.ndarray, rejected: float
) -> tuple[np.ndarray, float]:
    """Pekalska et al.: min ρ + Σ ξ_i / (ν m), with Σ_j w_j d_ij ≤ ρ + ξ_i, Σ w = 1, w, ξ ≥ 0.

    dissimilarities: (k,k) between different samples that occur counts (k,) times, m in all;
    ν = rejected, 0 for no ξ. Returns w (k,) and ρ. The same as a game: a mixture w of
    samples against a worst mixture p of samples, none of which has more than 1/(ν m).
    """
    from scipy.optimize import linprog  # slow to import, and the others do without

    number = len(counts)
    share = rejected * counts.sum()
    slack = counts / share if share > 0 else np.full(number, np.inf)
    # With one sample's price at 1 or more, no sample is ever let go.
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
        raise InputError("dlp", f"the linear programme failed: {solution.message}", "report it")
    weights = np.where(solution.x[:number] > 1e-10, solution.x[:number], 0)
    return weights / weights.sum(), float(solution.x[number])


def fit_linear(road: Road, settings: LinearSettings) -> Learned:
    """P3: L = Σ_j w_j d(x, y_j), over the few samples with a weight, less its least value.

    Its root where the dissimilarity is all but a squared distance. P3's sum runs over the wrong
    index. Its d is "distance"; only with the toolbox's, all but squared, does dLP equal SVDD within
    0.1 in 18 of 19 columns, as it does in P3's results.
    """
    points, counts = few_distinct("dlp", road.samples, MAX_CONSTRAINTS)
    dissimilarity = DISSIMILARITIES[settings.dissimilarity]
    between = dissimilarity(squared_distances(points.T, points))
    # The solver's tolerances are absolute; rescaled so that the mean is 1, they are small.
    scale = float(between.mean()) or 1.0
    weights, margin = least_margin(between.numpy() / scale, counts.numpy(), settings.rejected)
    kept = torch.from_numpy(weights > 0)
    few, shares = points[kept], torch.from_numpy(weights)[kept]
    exact = weighted_sum(few, shares, dissimilarity)
    excess = excess_over(exact, points, counts.double(), torch.float32)
    mixed = weighted_sum(few.float(), shares.float(), dissimilarity)

    def as_distance(values: Tensor) -> Tensor:
        above = excess(values)
        return above.sqrt_() if settings.dissimilarity == "toolbox" else above

    threshold = None
    if settings.threshold == "margin":
        threshold = float(as_distance(torch.tensor(margin * scale).float()))
    return Learned(lambda planes: as_distance(mixed(planes)), max(len(few), 4), threshold=threshold)


def weighted_sum(points: Tensor, weights: Tensor, dissimilarity: Measure) -> Measure:
    """Σ_j w_j d(x, y_j) of planes, with points (s,d) and weights (s,)."""
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
