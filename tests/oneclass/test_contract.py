"""Properties of every one-class classifier, and distances compared with slow versions."""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any, get_args

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.oneclass import CLASSIFIERS, FittedClassifier, base, fit, make_axes
from roadtorch.oneclass.axes import Hue
from roadtorch.oneclass.base import Classifier
from tests.draws import seeded_generator
from tests.oneclass.cases import (
    HISTOGRAMS,
    RGB,
    around_red,
    asphalt,
    doubles,
    every_classifier,
    every_distance,
    fitted,
    of_asphalt,
    rank_correlation,
    readings,
    road,
    some,
)
from tests.reference import oneclass_boundary, oneclass_density

HS = make_axes(("H", "S"))
WRONG = ((9, 2), (9,), (2, 9, 3))


def colours(count: int = 500, planes: int = 3) -> Tensor:
    return torch.rand(count, planes, generator=seeded_generator(1))


def check_answers(fitted: FittedClassifier, pixels: Tensor) -> None:
    distance = fitted.distance(pixels)
    likelihood = fitted.to_likelihood(distance)
    assert distance.dtype == likelihood.dtype == torch.float32
    assert distance.shape == likelihood.shape == (len(pixels),)
    assert not distance.isnan().any()
    assert distance.min() >= 0
    assert likelihood.isfinite().all()
    assert 0 <= likelihood.min() <= likelihood.max() <= 1
    assert 0 < fitted.threshold < torch.inf


# --- what they find ---------------------------------------------------------------------


@every_classifier
def test_road_ranks_above_other_colours(classifier: Classifier) -> None:
    fitted = of_asphalt(classifier)

    road, colour = fitted.distance(asphalt(seed=5)), fitted.distance(colours())

    above = (road[:, None] < colour).double() + (road[:, None] == colour).double() / 2
    # A histogram of 90 samples has holes; PCA says little of colours along its components.
    assert above.mean() > (0.55 if classifier.name in HISTOGRAMS else 0.85)


@every_distance
def test_the_farther_the_less_likely_even_on_16_bit_levels(classifier: Classifier) -> None:
    samples = asphalt()
    # PCA is blind along the component that it keeps: go across all of them.
    directions = torch.linalg.eigh((samples - samples.mean(0)).T.cov()).eigenvectors
    steps = torch.linspace(0.1, 1.5, 60)[:, None]
    ray = samples.mean(0) + steps * directions[:, 0]

    levels = (of_asphalt(classifier).likelihood(ray).double() * 65535).round()

    assert (levels.diff() < 0).all()


@every_classifier
def test_the_threshold_rejects_about_the_fraction(classifier: Classifier) -> None:
    shares, samples = (0.0, 0.1, 0.5, 0.9), asphalt(150)
    by_share = [fit(classifier, samples, RGB, classifier.settings(rejected=s)) for s in shares]

    for rejected, model in zip(shares, by_share, strict=True):
        outside = int((model.distance(samples) > model.threshold).sum())
        if classifier.name in {"nn", "mst"}:  # samples are at distance 0 of themselves
            assert outside == 0
        elif classifier.name in HISTOGRAMS:  # ties
            assert outside <= 150 * rejected
        else:
            assert outside == pytest.approx(150 * rejected, abs=7)
    # SVDD and dLP change with the share, so that their thresholds are of different distances.
    pixels = asphalt(1000, seed=7)
    accepted = [int((model.distance(pixels) <= model.threshold).sum()) for model in by_share]
    assert accepted == sorted(accepted, reverse=True)
    assert accepted[0] > accepted[-1]


# --- awkward samples ----------------------------------------------------------------------

AWKWARD = {
    "one": torch.full((1, 3), 0.4),
    "identical": torch.full((20, 3), 0.4),
    "black": torch.zeros(20, 3),
    "white": torch.ones(5, 3),
    "m<d": torch.tensor([[0.1, 0.5, 0.2], [0.2, 0.5, 0.3]]),
    "constant plane": torch.cat([asphalt(40)[:, :2], torch.full((40, 1), 0.3)], 1),
    "grey": asphalt(40)[:, :1].expand(-1, 3),
    "two colours": torch.cat([torch.full((16, 3), 0.4), torch.full((2, 3), 0.6)]),
}


@pytest.mark.parametrize(
    ("classifier", "settings"),
    [
        *readings("hue"),
        *(
            pytest.param(classifier, settings, id=f"{name}-{settings}")
            for (name, classifier), settings in product(
                CLASSIFIERS.items(), ({}, {"rejected": 0.0}, {"rejected": 1.0})
            )
        ),
    ],
)
def test_awkward_samples_give_an_answer(classifier: Classifier, settings: dict[str, Any]) -> None:
    for samples in AWKWARD.values():
        fitted = fit(classifier, samples, RGB, classifier.settings.model_validate(settings))

        check_answers(fitted, torch.cat([samples, colours(100)]))
        if "rejected" not in settings:
            assert fitted.likelihood(samples).max() > 0.4999  # rounding may leave none within


@every_distance
def test_samples_of_one_colour_rank_by_the_distance_to_it(classifier: Classifier) -> None:
    colour, pixels = torch.tensor([0.3, 0.5, 0.4]), colours()
    for count in (1, 90):
        fitted = fit(classifier, colour.expand(count, 3), RGB)

        away = (pixels - colour).norm(dim=1)
        assert rank_correlation(fitted.distance(pixels), away) > 0.9999
        assert (fitted.distance(colour[None]) <= fitted.threshold).all()
        assert (fitted.distance(pixels) > fitted.threshold).all()


# --- awkward pixels -----------------------------------------------------------------------


@every_classifier
def test_extreme_and_non_finite_pixels_are_not_road(classifier: Classifier) -> None:
    fitted, broken = of_asphalt(classifier), [3, 7, 8]
    far = torch.tensor([[0.45, 0.45, 0.45], [1e4, 0.4, -1e4], [1e20, 0.4, -1e20]])
    pixels = asphalt()
    pixels[3, 1], pixels[7, 0], pixels[8, 2] = float("nan"), float("inf"), -float("inf")

    # A bin at the edge of the range holds all that lies beyond it; PCA keeps one direction.
    likelihood = fitted.likelihood(far)
    assert (likelihood[1:] <= likelihood[0]).all()
    distance = fitted.distance(pixels)
    assert torch.equal(distance.isinf().nonzero()[:, 0], torch.tensor(broken))
    assert fitted.likelihood(pixels)[broken].tolist() == [0, 0, 0]
    assert torch.equal(distance[:3], fitted.distance(asphalt())[:3])
    assert fitted.likelihood(torch.empty(0, 3)).shape == (0,)


@every_classifier
def test_non_finite_samples_are_ignored(classifier: Classifier) -> None:
    broken = torch.tensor([[float("nan"), 0, 0], [0, float("inf"), 0], [0, 0, -float("inf")]])

    mixed = fit(classifier, torch.cat([broken, asphalt()]), RGB)

    assert torch.equal(mixed.distance(asphalt()), of_asphalt(classifier).distance(asphalt()))
    for none in (broken, asphalt(0)):
        with pytest.raises(InputError, match="samples: none has finite values"):
            fit(classifier, none, RGB)


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        *((torch.rand(size), r"have the shape .* \(give \(number, 3\)") for size in WRONG),
        (torch.randint(256, (90, 3)), r"are torch\.int64"),
    ],
)
def test_another_shape_or_type_is_refused_in_one_line(values: Tensor, problem: str) -> None:
    classifier = CLASSIFIERS["gaussian"]
    with pytest.raises(InputError, match=f"^samples: {problem}"):
        fit(classifier, values, RGB)
    with pytest.raises(InputError, match=f"^pixels: {problem}"):
        of_asphalt(classifier).distance(values)


@every_classifier
def test_one_plane_is_enough_but_for_pca(classifier: Classifier) -> None:
    for plane in ("R", "H", "nr"):
        axes = make_axes((plane,))
        if classifier.name == "pca":
            with pytest.raises(ConfigError, match="pca: one plane has a single principal comp"):
                fit(classifier, asphalt()[:, :1], axes)
        else:
            check_answers(fit(classifier, asphalt()[:, :1], axes), colours(planes=1))


# --- hue ------------------------------------------------------------------------------------


@every_classifier
def test_hue_is_a_circle_in_every_reading_but_the_plain_number(classifier: Classifier) -> None:
    samples = around_red(900 if classifier.name in HISTOGRAMS else 90)  # bins want samples
    for hue in get_args(Hue):
        fitted = fit(classifier, samples, HS, classifier.settings(hue=hue))

        check_answers(fitted, colours(planes=2))
        if hue != "linear":
            hues = torch.tensor([[0.01, 0.4], [0.99, 0.4], [0.5, 0.4]])
            red, cyan = fitted.distance(hues).split([2, 1])
            assert red.max() < cyan
            twin_hues = torch.tensor([[0.0, 0.4], [1.0, 0.4]])
            np.testing.assert_allclose(*fitted.distance(twin_hues), rtol=1e-4, atol=1e-4)


# --- the same again -------------------------------------------------------------------------


@every_classifier
def test_same_samples_same_bytes(classifier: Classifier, monkeypatch: pytest.MonkeyPatch) -> None:
    samples, pixels = asphalt(), colours()

    torch.manual_seed(1)
    first = fit(classifier, samples, RGB).distance(pixels)
    torch.manual_seed(2)  # no classifier may draw from torch's own generator
    again = fit(classifier, samples.double(), RGB)

    assert torch.equal(first, again.distance(pixels))
    assert torch.equal(samples, asphalt())
    assert torch.equal(pixels, colours())
    planes = pixels.T.contiguous()
    np.testing.assert_allclose(again.distance(planes.T), first, rtol=1e-5, atol=1e-5)
    monkeypatch.setattr(base, "CHUNK_FLOATS", 7 * again.model.floats)
    np.testing.assert_allclose(again.distance(pixels), first, rtol=1e-5, atol=1e-5)


# --- slow versions ------------------------------------------------------------------------


ROUNDING = 1 / (12 * 255**2)
"""Variance of rounding to 256 levels, of planes from 0 to 1."""


@pytest.mark.parametrize(
    ("name", "settings", "reference"),
    [
        ("nn", {}, oneclass_boundary.nearest_distance),
        ("mst", {}, oneclass_boundary.tree_distance),
        ("kmeans", {"centres": 50}, oneclass_boundary.nearest_distance),
        ("kcentres", {"centres": 50}, oneclass_boundary.nearest_distance),
        ("gaussian", {}, partial(oneclass_density.gaussian_distance, floor=ROUNDING)),
        ("hist64_s", {}, partial(oneclass_density.histogram_distance, bins=64)),
        ("hist100_s", {}, partial(oneclass_density.histogram_distance, bins=100)),
        ("hist64_s", {"planes": "product"}, oneclass_density.histograms_distance),
        ("pca", {"variance": 0.0}, partial(oneclass_density.residual_distance, count=0)),
        ("pca", {"variance": 0.95}, partial(oneclass_density.residual_distance, count=-1)),
    ],
)
def test_the_distance_is_that_of_the_slow_version(
    name: str, settings: dict[str, Any], reference: Callable[..., np.ndarray]
) -> None:
    classifier = CLASSIFIERS[name]
    for dimensions in (2, 3) if classifier.single_plane_error else (1, 2, 3):
        samples, pixels = road(40, dimensions), some(100, dimensions)
        # Twins change nothing where no variance is divided by m - 1.
        for rows in [samples] if name in {"gaussian", "pca"} else [samples, samples.repeat(2, 1)]:
            learned = fitted(classifier, rows, classifier.settings.model_validate(settings))

            expected = reference(doubles(rows), doubles(pixels))
            np.testing.assert_allclose(learned.distance(pixels), expected, rtol=2e-5, atol=1e-6)
