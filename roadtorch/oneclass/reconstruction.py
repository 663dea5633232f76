"""One-class classifiers by reconstruction (P3, section III-B): PCA, k-means, k-centres.

The distance is the error of replacing a pixel by its projection or by the nearest of a few centres.
k-centres differs from k-means only in how the centres are found.
"""

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.oneclass.base import Classifier, ClassifierSettings, DistanceModel, RoadSamples
from roadtorch.oneclass.density import column_norms, moments, variance_floor
from roadtorch.oneclass.mixture import k_means_plus_plus
from roadtorch.oneclass.neighbours import MAX_DISTINCT, distinct_samples, squared_distances

MAX_ROUNDS = 100  # most rounds of moving centres
INERTIA_TOLERANCE = 1e-5  # relative change of the inertia at which k-means ends (dd_tools)


class ComponentSettings(ClassifierSettings):
    """Principal components."""

    variance: float = Field(
        default=0.95,
        ge=0,
        le=1,
        description="fraction of the variance in the components; paper: 0.95",
    )
    full: Literal["cap", "strict"] = Field(
        default="cap",
        description="if that fraction needs all components: use one less (cap), or all (strict: "
        "all distances are 0)",
    )


def count_components(variances: Tensor, fraction: float) -> int:
    """Return the least n such that the first n of sorted variances (d,) reach the fraction."""
    total = float(variances.sum())
    if total <= 0:
        return 0
    reached = variances.cumsum(0) >= fraction * total * (1 - 1e-12)
    return int((~reached).sum()) + 1 if fraction > 0 else 0


def fit_components(road: RoadSamples, settings: ComponentSettings) -> DistanceModel:
    """Fit P3's |(x-μ) - P(x-μ)|, P the projection on the eigenvectors with 95 % of the variance.

    The square in P3's formula changes no rank.
    """
    mean, covariance = moments(road.samples)
    variances, directions = torch.linalg.eigh(covariance)
    # Variance that is only the float32 rounding of a constant plane is set to 0.
    variances = torch.where(variances > 1e-6 * variance_floor(road.axes).min(), variances, 0)
    order = variances.argsort(descending=True, stable=True)
    count = count_components(variances[order], settings.variance)
    if count == len(mean) and settings.full == "cap":
        count -= 1
    # The residual is in the remaining directions.
    centre, basis = mean.float(), directions[:, order[count:]].T.float().contiguous()

    def distance(pixels: Tensor) -> Tensor:
        centred = pixels - centre[:, None]
        return column_norms(basis @ centred) if len(basis) else torch.zeros_like(centred[0])

    return DistanceModel(distance, 4 * len(mean))


class CentreSettings(ClassifierSettings):
    """A few centres."""

    centres: int = Field(
        default=5, ge=1, le=1000, description="number of centres; not in the paper"
    )
    restarts: int = Field(
        default=10, ge=1, le=1000, description="number of starts; the best is used"
    )


class SampleCentreSettings(CentreSettings):
    """A few centres among the samples."""

    restarts: int = Field(
        default=25, ge=1, le=1000, description="random starts, in addition to a greedy one"
    )


def k_means(samples: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Run Lloyd's algorithm from R starts (R, k, d): return centres (R, k, d), inertias (R,).

    Each sample, float64 (m, d), is assigned to the nearest centre, each centre moves to the mean of
    its samples, until no inertia falls by more than ``INERTIA_TOLERANCE`` of itself. A centre
    without samples moves to the sample with the largest error.
    """
    centres, inertia = start, samples.new_full((len(start),), torch.inf)
    numbers = torch.arange(start.shape[1])[:, None]
    for _ in range(MAX_ROUNDS):
        least, nearest = (samples.T - centres[..., None]).square_().sum(2).min(1)
        previous, inertia = inertia, least.sum(1)
        if bool((previous - inertia <= INERTIA_TOLERANCE * inertia).all()):
            break
        member = (nearest[:, None] == numbers).to(samples)
        size = member.sum(2, keepdim=True)
        worst = samples[least.argmax(1)][:, None]
        centres = torch.where(size > 0, member @ samples / size.clamp_min(1), worst)
    return centres, inertia


def fit_means(road: RoadSamples, settings: CentreSettings) -> DistanceModel:
    """Fit k-means; the best of all starts is used."""
    samples = road.samples
    count = min(settings.centres, len(samples.unique(dim=0)))
    numbers = torch.full((settings.restarts,), count)
    member = k_means_plus_plus(samples, numbers, road.generator)
    start = member @ samples / member.sum(2, keepdim=True).clamp_min(1)
    centres, inertia = k_means(samples, start)
    return distance_to_nearest(centres[int(inertia.argmin())])


def farthest_first(distances: Tensor, count: int, first: int = 0) -> Tensor:
    """Return ``count`` samples, each the farthest from the previous ones: int64 (count,).

    ``distances`` are (m, m). The radius is at most twice the least possible (Gonzalez 1985).
    """
    chosen = [first]
    for _ in range(count - 1):
        chosen.append(int(distances[chosen].amin(0).argmax()))
    return torch.tensor(chosen)


def k_centres(distances: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Return centres among samples, int64 (R, k), from R starts, and radii (R,).

    ``distances`` are (m, m). Each sample is assigned to the nearest centre; in each cell the sample
    with the least largest distance becomes the centre; until none changes (dd_tools). This lowers
    the largest distance of a sample to its nearest centre (P3's min max min).
    """
    centres = start
    for _ in range(MAX_ROUNDS):
        nearest = distances[centres].argmin(1)
        farthest = torch.where(nearest[:, None, :] == nearest[:, :, None], distances, 0).amax(2)
        cells = torch.arange(centres.shape[1])[:, None] == nearest[:, None, :]
        best = torch.where(cells, farthest[:, None, :], torch.inf).min(2)
        moved = torch.where(best.values.isfinite(), best.indices, centres)
        if torch.equal(moved, centres):
            break
        centres = moved
    return centres, distances[centres].amin(1).amax(1)


def fit_centres(road: RoadSamples, settings: SampleCentreSettings) -> DistanceModel:
    """Fit k-centres; the best of a greedy start and random ones is used."""
    points, _ = distinct_samples("kcentres", road.samples)
    count, restarts = min(settings.centres, len(points)), settings.restarts
    distances = squared_distances(points.T, points).sqrt_()
    randoms = [
        torch.randperm(len(points), generator=road.generator)[:count] for _ in range(restarts)
    ]
    middle = int(distances.amax(1).argmin())
    start = torch.stack([farthest_first(distances, count, middle), *randoms])
    batch = max(1, MAX_DISTINCT**2 // len(points) ** 2)  # each run needs as much as ``distances``
    runs = [k_centres(distances, part) for part in start.split(batch)]
    centres, radii = (torch.cat(parts) for parts in zip(*runs, strict=True))
    return distance_to_nearest(points[centres[int(radii.argmin())]])


def distance_to_nearest(centres: Tensor) -> DistanceModel:
    """Return min_j |x - c_j| of centres (k, d) as a model. P3's square changes no rank."""
    points = centres.float()
    return DistanceModel(
        lambda pixels: squared_distances(pixels, points).amin(0).sqrt_(), 2 * len(points)
    )


PCA = Classifier(
    "pca",
    "distance to the principal components",
    ComponentSettings,
    fit_components,
    single_plane_error="one plane has a single principal component, and no residual",
    paper={"full": "strict"},
)
K_MEANS = Classifier("kmeans", "distance to the nearest of a few means", CentreSettings, fit_means)
K_CENTRES = Classifier(
    "kcentres",
    "distance to the nearest of a few samples that cover the rest",
    SampleCentreSettings,
    fit_centres,
)
