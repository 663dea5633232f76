"""One-class classifiers by reconstruction: PCA and k-means; and k-centres (P3, section III-B).

They tell how much of a pixel is lost when it is replaced by its projection or by the
nearest of a few centres. k-centres differs from k-means in how the centres are found alone.
"""

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.oneclass.base import Classifier, ClassifierSettings, Learned, Road
from roadtorch.oneclass.density import floor_of, length_of, moments
from roadtorch.oneclass.mixture import spread_starts
from roadtorch.oneclass.neighbours import MAX_DISTINCT, few_distinct, squared_distances

MAX_ROUNDS = 100
"""Of moving centres at most."""

TOLERANCE = 1e-5
"""Moving means ends when the inertia falls by less than this share (dd_tools)."""


class ComponentSettings(ClassifierSettings):
    """Principal components."""

    variance: float = Field(
        default=0.95, ge=0, le=1, description="share of the variance that is kept; the paper: 95 %"
    )
    full: Literal["cap", "strict", "mean"] = Field(
        default="cap",
        description="where that needs all components and nothing would be lost: keep one less, "
        "lose nothing (no information), or keep none (distance to the mean)",
    )


def kept_components(variances: Tensor, share: float) -> int:
    """The least number of the largest variances (d,) that has a share of all; 0 if all are 0."""
    total = float(variances.sum())
    if total <= 0:
        return 0
    reached = variances.cumsum(0) >= share * total * (1 - 1e-12)
    return int((~reached).sum()) + 1 if share > 0 else 0


def fit_components(road: Road, settings: ComponentSettings) -> Learned:
    """P3: |(x-μ) - P(x-μ)|, P the projection on the eigenvectors with 95 % of the variance.

    The square that P3 writes changes no rank.
    """
    mean, covariance = moments(road.samples)
    variances, directions = torch.linalg.eigh(covariance)
    # What rounding to float32 makes of a constant plane is no variance.
    variances = torch.where(variances > 1e-6 * floor_of(road.axes).min(), variances, 0)
    order = variances.argsort(descending=True, stable=True)
    kept = kept_components(variances[order], settings.variance)
    if kept == len(mean):
        kept = {"cap": kept - 1, "strict": kept, "mean": 0}[settings.full]
    # The residual lies in the directions that are not kept.
    centre, lost = mean.float(), directions[:, order[kept:]].T.float().contiguous()

    def distance(pixels: Tensor) -> Tensor:
        centred = pixels - centre[:, None]
        return length_of(lost @ centred) if len(lost) else torch.zeros_like(centred[0])

    return Learned(distance, 4 * len(mean))


class CentreSettings(ClassifierSettings):
    """A few centres."""

    centres: int = Field(default=5, ge=1, le=1000, description="how many; the paper does not say")
    restarts: int = Field(default=10, ge=1, le=1000, description="starts, the best is kept")


class SampleCentreSettings(CentreSettings):
    """A few centres among the samples."""

    restarts: int = Field(
        default=25, ge=1, le=1000, description="random starts besides a greedy one"
    )


def k_means(samples: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Lloyd's algorithm from R starts at once: centres (R,k,d) and inertias (R,).

    samples: float64 (m,d); start: (R,k,d). Each sample belongs to the nearest centre, each
    centre moves to the mean of its samples, until no inertia falls by more than ``TOLERANCE``
    of itself. A centre without samples goes to the sample that is worst off.
    """
    centres, inertia = start, samples.new_full((len(start),), torch.inf)
    numbers = torch.arange(start.shape[1])[:, None]
    for _ in range(MAX_ROUNDS):
        squared = (samples.T - centres[..., None]).square_().sum(2)
        least, nearest = squared.min(1)
        before, inertia = inertia, least.sum(1)
        if bool((before - inertia <= TOLERANCE * inertia).all()):
            break
        member = (nearest[:, None] == numbers).to(samples)
        size = member.sum(2, keepdim=True)
        worst = samples[least.argmax(1)][:, None]
        centres = torch.where(size > 0, member @ samples / size.clamp_min(1), worst)
    return centres, inertia


def fit_means(road: Road, settings: CentreSettings) -> Learned:
    """The best means of all starts."""
    samples = road.samples
    count = min(settings.centres, len(samples.unique(dim=0)))
    numbers = torch.full((settings.restarts,), count)
    weights = samples.new_ones(settings.restarts, len(samples))
    member = spread_starts(samples, weights, numbers, road.generator)
    start = member @ samples / member.sum(2, keepdim=True).clamp_min(1)
    centres, inertia = k_means(samples, start)
    return to_nearest(centres[int(inertia.argmin())])


def farthest_first(apart: Tensor, count: int, first: int = 0) -> Tensor:
    """``count`` samples, each the farthest from those before: int64 (count,) (Gonzalez 1985).

    apart: distances (m,m). Their radius is at most twice the least possible.
    """
    chosen = [first]
    for _ in range(count - 1):
        chosen.append(int(apart[chosen].amin(0).argmax()))
    return torch.tensor(chosen)


def k_centres(apart: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Centres among samples with a small largest distance, from R starts at once.

    apart: distances (m,m); start: int64 (R,k). Each sample belongs to the nearest centre;
    of each cell the sample whose farthest fellow is nearest becomes the centre; until none
    changes (dd_tools). Returns int64 (R,k) and radii (R,). P3's objective min max min, read
    with the maximum over the samples and equal balls.
    """
    centres = start
    for _ in range(MAX_ROUNDS):
        nearest = apart[centres].argmin(1)
        fellows = nearest[:, None, :] == nearest[:, :, None]
        farthest = torch.where(fellows, apart, 0).amax(2)
        cells = torch.arange(centres.shape[1])[:, None] == nearest[:, None, :]
        best = torch.where(cells, farthest[:, None, :], torch.inf).min(2)
        moved = torch.where(best.values.isfinite(), best.indices, centres)
        if torch.equal(moved, centres):
            break
        centres = moved
    return centres, apart[centres].amin(1).amax(1)


def fit_centres(road: Road, settings: SampleCentreSettings) -> Learned:
    """The best centres of a greedy start and of random ones."""
    points, _ = few_distinct("kcentres", road.samples)
    count, restarts = min(settings.centres, len(points)), settings.restarts
    apart = squared_distances(points.T, points).sqrt_()
    draws = [torch.randperm(len(points), generator=road.generator)[:count] for _ in range(restarts)]
    middle = int(apart.amax(1).argmin())
    start = torch.stack([farthest_first(apart, count, middle), *draws])
    together = max(1, MAX_DISTINCT**2 // len(points) ** 2)  # each takes as much room as ``apart``
    runs = [k_centres(apart, part) for part in start.split(together)]
    centres, radii = (torch.cat(parts) for parts in zip(*runs, strict=True))
    return to_nearest(points[centres[int(radii.argmin())]])


def to_nearest(centres: Tensor) -> Learned:
    """min_j |x - c_j| of centres (k,d). P3 has the square, which changes no rank."""
    points = centres.float()
    return Learned(
        lambda pixels: squared_distances(pixels, points).amin(0).sqrt_(), 2 * len(points)
    )


PCA = Classifier(
    "pca",
    "distance to the principal components",
    ComponentSettings,
    fit_components,
    single="one plane has a single principal component, and without it nothing is left",
    paper={"full": "strict"},
)
K_MEANS = Classifier("kmeans", "distance to the nearest of a few means", CentreSettings, fit_means)
K_CENTRES = Classifier(
    "kcentres",
    "distance to the nearest of a few samples that cover the others",
    SampleCentreSettings,
    fit_centres,
)
