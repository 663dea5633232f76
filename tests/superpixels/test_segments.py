"""Exposure, measures of segments, likeness and kernel densities."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.imaging.color import STRONGEST, Exposure, brightened, planes
from roadtorch.superpixels.segments import (
    Bandwidths,
    Segments,
    borders,
    class_log_density,
    gradient_length,
    likeness,
    measure_segments,
)
from roadtorch.superpixels.slic import slic


def noise(height: int, width: int, seed: int = 0) -> Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))


def lower_median(image: Tensor) -> float:
    return float(image.mean(0)[int(image.shape[1] * 0.55) :].median())


# --- exposure -----------------------------------------------------------------------------


def test_a_picture_that_is_bright_enough_stays_as_it_is() -> None:
    image = noise(20, 30) * 0.5 + 0.4

    assert brightened(image, Exposure(ground=0.4)) is image


@pytest.mark.parametrize("grey", [0.1, 0.2, 0.35])
def test_the_lower_part_of_a_dark_picture_reaches_the_level(grey: float) -> None:
    image = torch.full((3, 20, 30), grey)
    image[:, :11] = 0.9  # the sky: rows above 0.55 of the height do not count

    assert lower_median(brightened(image, Exposure(ground=0.4))) == pytest.approx(0.4, abs=1e-4)


@pytest.mark.parametrize("dark", [0.02, 0.1, 0.3, 0.6])
def test_brightening_keeps_the_order_of_values_and_the_range(dark: float) -> None:
    image = noise(24, 32) * dark
    image[:, 0, 0], image[:, 0, 1] = 0.0, 1.0

    result = brightened(image, Exposure())

    order = image.reshape(-1).argsort(stable=True)
    assert (result.reshape(-1)[order].diff() >= 0).all()
    assert (result >= image).all()
    assert result.max() <= 1
    assert result[:, 0, 1].tolist() == [1, 1, 1]


def test_the_exponent_has_a_floor() -> None:
    image = torch.full((3, 20, 20), 0.01)

    result = brightened(image, Exposure(ground=0.9))

    assert result.amax() == pytest.approx(0.01**STRONGEST, rel=1e-5)


@pytest.mark.parametrize("size", [(16, 16), (17, 40)])
def test_a_black_picture_stays_nearly_black_and_finite(size: tuple[int, int]) -> None:
    result = brightened(torch.zeros(3, *size), Exposure())

    assert result.isfinite().all()
    assert result.unique().numel() == 1
    assert 0 <= float(result.max()) < 0.1


# --- measures -----------------------------------------------------------------------------


def test_gradients_are_those_of_a_loop() -> None:
    plane = noise(6, 5)[0]

    length = gradient_length(plane)

    for row, column in np.ndindex(6, 5):
        across = down = 0.0
        if 0 < column < 4:
            across = float(plane[row, column + 1] - plane[row, column - 1]) / 2
        if 0 < row < 5:
            down = float(plane[row + 1, column] - plane[row - 1, column]) / 2
        assert float(length[row, column]) == pytest.approx(np.hypot(across, down), abs=1e-6)


def test_segments_are_measured_by_their_pixels() -> None:
    image = noise(24, 36)
    labels = slic(image, 12)
    count = int(labels.max()) + 1

    segments = measure_segments(image, labels)

    lab = planes(image, ("L", "a", "b"))
    gradient = gradient_length(lab)
    for number in range(count):
        inside = labels == number
        rows, columns = inside.nonzero().T
        light = lab[0][inside]
        assert segments.color[:, number].tolist() == pytest.approx(
            lab[:, inside].mean(1).tolist(), abs=1e-5
        )
        wanted = {
            "gradient": gradient[0][inside].mean(),
            "contrast": light.std(unbiased=False),
            "row": (rows + 0.5).mean() / 24,
            "column": (columns + 0.5).mean() / 36,
            "size": inside.float().mean(),
        }
        for name, value in wanted.items():
            measured = float(getattr(segments, name)[number])
            assert measured == pytest.approx(float(value), abs=2e-3 if name == "contrast" else 1e-5)
    assert float(segments.size.sum()) == pytest.approx(1, abs=1e-5)
    assert torch.equal(segments.pairs, borders(labels, gradient[0])[0])
    assert segments.contrast_between.shape == (segments.pairs.shape[1],)
    assert (segments.contrast_between >= 0).all()


@pytest.mark.parametrize("other", [(0.2, 0.2, 0.2), (0.3, 0.6, 0.3), (0.5, 0.5, 0.6)])
def test_the_contrast_between_segments_is_that_of_the_edge_between_them(
    other: tuple[float, float, float],
) -> None:
    image = torch.full((3, 20, 40), 0.5)
    image[:, :, 20:] = torch.tensor(other).view(3, 1, 1)
    labels = torch.arange(40).div(10, rounding_mode="floor").expand(20, 40)

    segments = measure_segments(image, labels)

    assert segments.pairs.tolist() == [[0, 1, 2], [1, 2, 3]]
    first, edge, last = segments.contrast_between.tolist()
    assert max(first, last) < 1e-5
    assert edge > 0.005


@pytest.mark.parametrize("grey", [0.0, 0.5, 1.0])
def test_a_flat_picture_has_no_contrast_anywhere(grey: float) -> None:
    image = torch.full((3, 16, 16), grey)

    segments = measure_segments(image, slic(image, 6))

    for values in (segments.gradient, segments.contrast_between):
        assert values.abs().max() == 0
    assert segments.contrast.max() < 2e-3  # the root of a rounding error
    assert segments.color[1:].abs().max() < 1e-4


# --- likeness and densities ---------------------------------------------------------------


def measured(count: int = 30) -> Segments:
    image = noise(40, 60) * 0.5
    return measure_segments(image, slic(image, count))


USUAL = Bandwidths(0.135, 0.045, 0.07, 0.09, 1.3, 0.8)


@pytest.mark.parametrize("count", [9, 60])
def test_likeness_is_a_product_of_gaussians(count: int) -> None:
    segments = measured(count)
    bandwidths = USUAL._replace(row=0.4, column=0.3)

    alike = likeness(segments, bandwidths)

    scales = {
        "lightness": segments.color[0],
        "gradient": segments.gradient,
        "contrast": segments.contrast,
        "row": segments.row,
        "column": segments.column,
    }
    wanted = torch.ones(len(segments.size), len(segments.size), dtype=torch.float64)
    for name, values in [
        *scales.items(),
        ("chroma", segments.color[1]),
        ("chroma", segments.color[2]),
    ]:
        apart = (values[:, None] - values[None]).double() / getattr(bandwidths, name)
        wanted *= torch.exp(-(apart**2) / 2)
    torch.testing.assert_close(alike.double(), wanted, atol=1e-4, rtol=0.0)


@st.composite
def believed(draw: st.DrawFn) -> tuple[Tensor, Tensor, Tensor]:
    """Likeness (n,n), posteriors (n,C), sizes (n,)."""
    count, classes = draw(st.integers(1, 6)), draw(st.integers(1, 3))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 999)))
    points = torch.rand(count, 2, generator=generator) * draw(st.sampled_from([0.5, 3.0, 20.0]))
    alike = torch.exp(-torch.cdist(points, points).square() / 2)
    posterior = torch.rand(count, classes, generator=generator)
    size = torch.rand(count, generator=generator) + 0.1
    return alike, posterior, size / size.sum()


@given(believed())
def test_the_density_of_a_class_is_the_weighted_mean_of_the_likeness_to_its_segments(
    case: tuple[Tensor, Tensor, Tensor],
) -> None:
    alike, posterior, size = case

    found = class_log_density(*case)

    for segment, kind in np.ndindex(*posterior.shape):
        total = support = 0.0
        for other in range(len(size)):
            weight = float(posterior[other, kind]) * float(size[other])
            total += weight * float(alike[segment, other])
            support += weight
        wanted = np.log(max(total / max(support, 1e-3), 1e-8))
        assert float(found[segment, kind]) == pytest.approx(wanted, abs=1e-3)


def test_a_class_without_support_has_a_finite_density_lower_than_any_other() -> None:
    alike = torch.eye(4)
    posterior = torch.tensor([[1.0, 0.0]]).expand(4, 2)

    density = class_log_density(alike, posterior, torch.full((4,), 0.25))

    assert density.isfinite().all()
    assert (density[:, 1] < density[:, 0]).all()
