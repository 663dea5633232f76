"""What all one-class classifiers share: axes, hue, thresholds, likelihoods, chunks."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field
from torch import Tensor

from roadtorch.errors import ConfigError
from roadtorch.oneclass import base
from roadtorch.oneclass.axes import (
    Axes,
    arranged,
    arranged_axes,
    axes_of,
    circular_mean,
    mean_hues,
    unrolled,
)
from roadtorch.oneclass.base import (
    Classifier,
    ClassifierSettings,
    Learned,
    Road,
    fit,
    rejecting_distance,
)
from tests.oneclass.cases import kept
from tests.reference import oneclass_density as reference

PLANE = axes_of(("S",))


class ScaledSettings(ClassifierSettings):
    """Settings of the classifier below."""

    scale: float = Field(default=1.0, gt=0)


def _fit_middle(road: Road, settings: ScaledSettings) -> Learned:
    middle = road.samples.mean(0).float() / settings.scale
    return Learned(partial(_from_middle, middle=middle), floats=2)


def _from_middle(pixels: Tensor, middle: Tensor) -> Tensor:
    return (pixels - middle[:, None]).abs().amax(0)


MIDDLE = Classifier("middle", "distance to the middle", ScaledSettings, _fit_middle)


def line(*values: float) -> Tensor:
    return torch.tensor(values)[:, None]


# --- axes and hue ---------------------------------------------------------------------------


def test_axes_have_the_ranges_of_their_planes() -> None:
    axes = axes_of(("H", "O1"))

    assert (axes.names, axes.circular) == (("H", "O1"), (True, False))
    np.testing.assert_allclose(axes.span, [1, math.sqrt(2)])
    np.testing.assert_allclose(axes.quantum, [1 / 255, math.sqrt(2) / 255])
    with pytest.raises(ConfigError, match="Hue: unknown plane"):
        axes_of(("Hue",))


def test_the_mean_hue_follows_the_circle() -> None:
    assert float(circular_mean(torch.tensor([0.9, 0.1]))) == pytest.approx(0, abs=1e-7)
    assert float(circular_mean(torch.tensor([0.6, 0.7]))) == pytest.approx(0.65)
    assert float(circular_mean(torch.tensor([0.0, 0.5]))) == 0  # they cancel


def test_saturated_colours_decide_on_the_mean_hue() -> None:
    samples = torch.tensor([[0.3, 0.7, 0.7], [0.8, 0.0, 0.0]])

    assert mean_hues(samples, axes_of(("H", "S"))).tolist() == pytest.approx([0.3, 0])
    grey = torch.tensor([[0.2, 0.4], [0.0, 0.0]])
    assert mean_hues(grey, axes_of(("H", "S"))).tolist() == pytest.approx([0.3, 0])


@given(st.floats(0, 1, width=32), st.floats(0, 1, width=32))
def test_unrolled_hue_differs_from_the_mean_by_the_way_along_the_circle(
    hue: float, mean: float
) -> None:
    away = float(unrolled(torch.tensor([hue]), mean))

    assert -0.5 - 1e-7 <= away <= 0.5
    along = abs(hue - mean)
    assert abs(away) == pytest.approx(min(along, abs(1 - along)), abs=1e-6)


def test_the_chord_puts_hue_on_a_circle_of_circumference_one() -> None:
    axes, planes = axes_of(("H", "S")), torch.tensor([[0.0, 0.25, 0.01], [0.1, 0.2, 0.3]])

    points = arranged(planes, axes, "chord", torch.zeros(2))

    assert arranged_axes(axes, "chord").names == ("cos H", "sin H", "S")
    np.testing.assert_allclose(points[:2].norm(dim=0), [1 / (2 * math.pi)] * 3, rtol=1e-6)
    assert float((points[:2, 2] - points[:2, 0]).norm()) == pytest.approx(0.01, rel=1e-3)
    assert torch.equal(points[2], planes[1])


def test_hue_as_a_plain_number_is_left_as_it_is() -> None:
    axes, planes = axes_of(("H",)), torch.rand(1, 5)

    assert arranged(planes, axes, "linear", torch.zeros(1)) is planes
    assert arranged_axes(axes, "linear") == axes
    assert arranged_axes(axes, "unrolled") == Axes(("H",), (-0.5,), (0.5,), (True,))


# --- thresholds and likelihoods ----------------------------------------------------------------


@given(
    st.lists(st.floats(0, 100), min_size=1, max_size=50),
    st.sampled_from([0.0, 0.025, 0.1, 0.5, 1.0]),
)
def test_the_boundary_lies_between_kept_and_rejected_samples(
    distances: list[float], rejected: float
) -> None:
    found = rejecting_distance(np.array(distances), rejected)

    assert found == pytest.approx(reference.rejecting_distance(np.array(distances), rejected))


@pytest.mark.parametrize(("count", "outside"), [(90, 2), (13266, 332)])
def test_p3s_fraction_rejects_as_many_samples_as_the_toolbox(count: int, outside: int) -> None:
    distances = np.random.default_rng(0).random(count)

    assert int((distances > rejecting_distance(distances, 0.025)).sum()) == outside


def test_the_likelihood_is_a_half_at_the_threshold_and_falls_with_the_root_of_the_distance() -> (
    None
):
    fitted = fit(MIDDLE, line(0.3, 0.4, 0.5, 0.6, 0.7), PLANE, ScaledSettings(rejected=0.4))

    assert float(fitted.threshold) == pytest.approx(0.15)
    found = fitted.likelihood(line(0.5, 0.65, 1.1)).tolist()
    assert found == pytest.approx([1, 1 / 2, 1 / 3], rel=1e-3)


def test_a_classifier_may_bring_its_threshold_or_the_distances_for_it() -> None:
    def with_own(road: Road, settings: ScaledSettings) -> Learned:
        return replace(_fit_middle(road, settings), threshold=7.0)

    def left_out(road: Road, settings: ScaledSettings) -> Learned:
        return replace(_fit_middle(road, settings), training=torch.tensor([1.0, 3.0]))

    def threshold(how: Callable[..., Learned], rejected: float) -> float:
        kind, settings = (
            Classifier("own", "", ScaledSettings, how),
            ScaledSettings(rejected=rejected),
        )
        return float(fit(kind, line(0.1, 0.2), PLANE, settings).threshold)

    assert threshold(with_own, 0.5) == 7
    assert threshold(left_out, 0.5) == 2


def test_one_quantum_is_the_threshold_where_samples_say_nothing() -> None:
    fitted = fit(MIDDLE, line(0.4, 0.4, 0.4), PLANE)

    assert float(fitted.threshold) == pytest.approx(1 / 255, rel=1e-4)


def test_settings_reach_the_fit_and_a_refusal_is_an_error() -> None:
    wide = fit(MIDDLE, line(0.2, 0.4), PLANE, ScaledSettings(scale=2.0))
    refusing = Classifier("picky", "", ScaledSettings, _fit_middle, "not today")

    assert float(kept(wide, "middle")) == pytest.approx(0.15)
    with pytest.raises(ConfigError, match=r"^picky: not today .choose other planes"):
        fit(refusing, line(0.2), PLANE)


def test_a_fit_sees_hue_as_distance_from_the_mean() -> None:
    fitted = fit(MIDDLE, line(0.9, 0.1), axes_of(("H",)), ScaledSettings(rejected=0.0))

    assert float(kept(fitted, "middle")) == pytest.approx(0, abs=1e-6)
    found = fitted.distance(line(0.95, 0.05, 0.5, 1.0)).tolist()
    assert found == pytest.approx([0.05, 0.05, 0.5, 0], abs=1e-6)


def test_memory_is_bounded_by_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = []

    def watched(pixels: Tensor) -> Tensor:
        sizes.append(pixels.shape[1])
        return pixels[0]

    watching = Classifier("watching", "", ScaledSettings, lambda *_: Learned(watched, floats=2))
    fitted = fit(watching, line(0.4, 0.5), PLANE)
    sizes.clear()
    monkeypatch.setattr(base, "CHUNK", 200)

    fitted.distance(torch.rand(1001, 1))

    assert max(sizes) <= 100
    assert sum(sizes) == 1001
