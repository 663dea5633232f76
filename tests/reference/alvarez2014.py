"""P3 from an image to distances of its colours from those of road, slow and simple, as in its text.

Each classifier returns the distances of pixels (n,), greater is less road, and that of the
boundary. The superpixels of the training area are an input.

Choices that the text leaves open are those of docs/how/one_class.md: the area of 640×480, the
circle of hue, Huber's weight, the ridge, the variance of rounding, starts of the mixture.
"""

import cmath

import numpy as np
from scipy.optimize import linprog
from scipy.stats import chi2

from tests.reference import oneclass_density as density
from tests.reference.color import planes_of_pixel
from tests.reference.oneclass_boundary import distance_matrix

Array = np.ndarray
REJECTED, RIDGE = 0.025, 1e-3
SPANS = {"O1": 2**0.5, "O2": 4 / 6**0.5}  # of the planes that do not span 1


def planes(image: Array, names: tuple[str, ...]) -> Array:
    """Return planes (d, H, W) of an image (3, H, W)."""
    result = np.empty((len(names), *image.shape[1:]))
    for row, column in np.ndindex(*image.shape[1:]):
        values = planes_of_pixel(*image[:, row, column])
        result[:, row, column] = [values[name] for name in names]
    return result


def rounding(names: tuple[str, ...]) -> Array:
    """Return the variance of rounding each plane to 8 bits, (d,)."""
    return np.array([(SPANS.get(name, 1) / 255) ** 2 / 12 for name in names])


def training_area(height: int, width: int) -> tuple[slice, slice]:
    """Return the rows and columns of 201×66 pixels, bottom centre, of 640×480; scaled."""
    rows, columns = round(height * 66 / 480), round(width * 201 / 640)
    left = (width - columns) // 2
    return slice(height - rows, height), slice(left, left + columns)


def mean_hue(hues: Array, weights: Array) -> float:
    """Return the direction of the mean vector of hues in turns, by weights."""
    vectors = (
        weight * cmath.exp(2j * cmath.pi * hue) for hue, weight in zip(hues, weights, strict=True)
    )
    return cmath.phase(sum(vectors)) / (2 * cmath.pi) % 1


def unroll(hues: Array, mean: float) -> Array:
    """Return hues in turns as distances along the circle from a mean, -½ to ½."""
    return (hues - mean + 0.5) % 1 - 0.5


def lower_median(values: Array) -> float:
    return float(np.sort(values)[(len(values) - 1) // 2])


def samples_and_pixels(
    image: Array, names: tuple[str, ...], segments: Array
) -> tuple[Array, Array]:
    """Return the medians (m, d) of the area's superpixels, int (h, w), and all pixels (n, d).

    Hue is that along the circle from the samples' mean, weighted by saturation.
    """
    values, hue_and_saturation = planes(image, names), planes(image, ("H", "S"))
    area = (slice(None), *training_area(*image.shape[1:]))
    inside, numbers = values[area], range(segments.max() + 1)
    pixels = values.reshape(len(names), -1).copy()
    rows = []
    for name, plane, row in zip(names, inside, pixels, strict=True):
        if name != "H":
            rows.append([lower_median(plane[segments == number]) for number in numbers])
            continue
        center = mean_hue(*(part.ravel() for part in hue_and_saturation[area]))
        turned = unroll(plane, center)
        hues = np.array([lower_median(turned[segments == number]) + center for number in numbers])
        saturations = inside[names.index("S")] if "S" in names else np.ones(inside.shape[1:])
        weights = [lower_median(saturations[segments == number]) for number in numbers]
        mean = mean_hue(hues % 1, np.array(weights))
        rows.append(unroll(hues % 1, mean))
        row[:] = unroll(row, mean)
    return np.array(rows).T, pixels.T


def rejection_distance(distances: Array) -> float:
    """Return the distance that 2.5 % of the training distances (m,) exceed."""
    ordered = np.sort(distances)
    rank = int((1 - REJECTED) * len(ordered) + 0.5)
    return float((ordered[rank - 1] + ordered[min(rank, len(ordered) - 1)]) / 2)


def robust_gaussian(samples: Array, pixels: Array, widening: Array) -> tuple[Array, float]:
    """Return Mahalanobis distances; samples (m, d) far from the mean have less weight."""
    dimensions = samples.shape[1]
    reach = np.sqrt(chi2.ppf(1 - REJECTED, dimensions))
    mean = np.median(samples, 0)
    spread = 1.4826 * np.median(np.abs(samples - mean), 0)
    covariance = np.diag(spread**2 + widening)
    for _ in range(50):
        weights = reach / np.maximum(reach, mahalanobis(samples, mean, covariance))
        mean = weights @ samples / weights.sum()
        centred = weights[:, None] * (samples - mean)
        covariance = centred.T @ centred / (weights**2).sum()
        ridge = RIDGE * np.trace(covariance) / dimensions
        covariance = (1 - RIDGE) * covariance + np.diag(ridge + widening)
    training = mahalanobis(samples, mean, covariance)
    return mahalanobis(pixels, mean, covariance), rejection_distance(training)


def mahalanobis(points: Array, mean: Array, covariance: Array) -> Array:
    """Return √((x-μ)ᵀ Σ⁻¹ (x-μ)), point by point."""
    inverse = np.linalg.inv(covariance)
    return np.array([np.sqrt((x - mean) @ inverse @ (x - mean)) for x in points])


def mog2(samples: Array, pixels: Array, widening: Array) -> tuple[Array, float]:
    """Return -ln Σ P_n exp(-(x-μ)ᵀ Σ⁻¹ (x-μ)) of pixels (n, d), without ½ and determinants."""
    return formula(likeliest_mixture(samples, 2, widening)[1], samples, pixels)


def mog4(samples: Array, pixels: Array, widening: Array) -> tuple[Array, float]:
    """Return the distance of ``mog2`` with four Gaussians."""
    return formula(likeliest_mixture(samples, 4, widening)[1], samples, pixels)


def mog_opt(samples: Array, pixels: Array, widening: Array) -> tuple[Array, float]:
    """Return it with one to six Gaussians by Schwarz's criterion, which P3 leaves open."""
    count, dimensions = samples.shape
    size = dimensions + dimensions * (dimensions + 1) // 2
    candidates = []
    for number in range(1, 7):
        likelihood, mixture = likeliest_mixture(samples, number, widening)
        candidates.append((np.log(count) * (number - 1 + number * size) - 2 * likelihood, mixture))
    return formula(min(candidates, key=lambda pair: pair[0])[1], samples, pixels)


def likeliest_mixture(
    samples: Array, number: int, widening: Array
) -> tuple[float, tuple[Array, Array, Array]]:
    """Return the log-likelihood, and weights, means, covariances of that number of Gaussians.

    Expectation maximisation from 20 random starts; the likeliest result is used.
    """
    random = np.random.default_rng(0)
    widening = 0.01 * ((samples - samples.mean(0)) ** 2).mean() + widening
    candidates = []
    for _ in range(20 if number > 1 else 1):
        centres = samples[random.choice(len(samples), number, replace=False)]
        nearest = distance_matrix(centres, samples).argmin(0)
        start = np.stack([nearest == component for component in range(number)]).astype(float)
        if start.sum(1).min() > 0:
            mixture = density.expectation_maximisation(samples, start, widening, 100)
            likelihood = density.log_sum(density.log_densities(samples, *mixture)).sum()
            candidates.append((float(likelihood), mixture))
    return max(candidates, key=lambda pair: pair[0])


def formula(
    mixture: tuple[Array, Array, Array], samples: Array, pixels: Array
) -> tuple[Array, float]:
    """Return P3's formula of a mixture, of pixels, and its boundary."""

    def distance(points: Array) -> Array:
        parts = [
            np.log(share) - mahalanobis(points, mean, covariance) ** 2
            for share, mean, covariance in zip(*mixture, strict=True)
        ]
        return -density.log_sum(np.stack(parts))

    return distance(pixels), rejection_distance(distance(samples))


def pca(samples: Array, pixels: Array, _: Array) -> tuple[Array, float]:
    """Return |(x-μ) - PPᵀ(x-μ)|, P the eigenvectors with 95 % of the variance, possibly all."""
    mean = samples.mean(0)
    values, vectors = np.linalg.eigh(np.cov(samples.T))
    shares = np.cumsum(values[::-1]) / values.sum()
    basis = vectors[:, ::-1][:, : int(np.argmax(shares >= 0.95)) + 1]

    def distance(points: Array) -> Array:
        return np.linalg.norm((points - mean) - (points - mean) @ basis @ basis.T, axis=1)

    return distance(pixels), rejection_distance(distance(samples))


def dlp(samples: Array, pixels: Array, _: Array) -> tuple[Array, float]:
    """Return Σ_j w_j |x - y_j|, with the least largest sum over most samples."""
    number = len(samples)
    among = distance_matrix(samples, samples)
    solution = linprog(  # w, ξ and ρ: min ρ + Σ ξ / (ν m) with Σ_j w_j d_ij ≤ ρ + ξ_i, Σ w = 1
        np.r_[np.zeros(number), np.full(number, 1 / (REJECTED * number)), 1],
        A_ub=np.c_[among, -np.eye(number), -np.ones(number)],
        b_ub=np.zeros(number),
        A_eq=np.r_[np.ones(number), np.zeros(number + 1)][None],
        b_eq=[1],
    )
    return distance_matrix(pixels, samples) @ solution.x[:number], float(solution.x[-1])
