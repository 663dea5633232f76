"""The model-based classifiers: histograms from the samples, and with a noisy copy."""

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.errors import ConfigError
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.histogram import HistogramSettings, bin_of, with_noisy_copy
from tests.draws import seeded
from tests.reference import oneclass_density as reference

SIMPLE, NOISY = CLASSIFIERS["hist64_s"], CLASSIFIERS["hist64_sn"]


def samples_of(planes: int, count: int = 2000) -> Tensor:
    return 0.3 + 0.2 * torch.rand(count, planes, generator=seeded())


@pytest.mark.parametrize("name", ["hist64_s", "hist100_s"])
@pytest.mark.parametrize("planes", [("O2",), ("a", "b"), ("R", "G", "B")])
def test_histograms_are_numpys(name: str, planes: tuple[str, ...]) -> None:
    axes, samples = axes_of(planes), samples_of(len(planes))
    pixels = torch.rand(500, len(planes), generator=seeded(1)) * 0.6 + 0.1
    bins = {"hist64_s": 64, "hist100_s": 100}[name]

    found = fit(CLASSIFIERS[name], samples, axes).distance(pixels)

    expected = reference.histogram_distance(
        samples.double().numpy(),
        pixels.double().numpy(),
        bins,
        np.array(axes.low),
        np.array(axes.high),
    )
    # On the edge of a bin the last digit decides.
    assert np.isclose(found, expected, atol=1e-5).mean() > 0.99


def test_distance_zero_is_the_fullest_bin_and_an_empty_one_is_infinitely_far() -> None:
    samples = torch.tensor([[0.1], [0.5], [0.5], [0.5], [0.9]])

    found = fit(SIMPLE, samples, axes_of(("S",))).distance(torch.tensor([[0.5], [0.1], [0.3]]))

    assert found[0] == 0
    assert float(found[1]) == pytest.approx((2 * np.log(3)) ** 0.5)
    assert found[2] == torch.inf
    assert fit(SIMPLE, samples, axes_of(("S",))).likelihood(torch.tensor([[0.3]])) == 0


def test_values_beyond_the_range_fall_into_the_last_bins() -> None:
    low, scale = torch.tensor([-1.0]), torch.tensor([4.0])

    found = bin_of(torch.tensor([[-9.0, -1.0, -0.76, -0.75, 0.99, 1.0, 9.0]]), low, scale, 8)

    assert found.tolist() == [[0, 0, 0, 1, 7, 7, 7]]


def test_the_product_over_planes_adds_the_squares_of_their_distances() -> None:
    axes, samples = axes_of(("R", "G")), samples_of(2)
    pixels = samples_of(2, 50)

    joint = fit(SIMPLE, samples, axes, HistogramSettings(planes="product")).distance(pixels)

    single = [
        fit(SIMPLE, samples[:, [place]], axes_of((name,))).distance(pixels[:, [place]])
        for place, name in enumerate("RG")
    ]
    torch.testing.assert_close(joint, torch.hypot(*single))


def test_the_noisy_copy_has_the_deviation_of_p3_in_ranges_of_the_plane() -> None:
    axes, samples = axes_of(("S", "O2")), torch.zeros(50_000, 2, dtype=torch.float64) + 0.5
    samples[:, 1] = 0

    both = with_noisy_copy(samples, axes, 30 / 256, "clip", seeded())

    assert both.shape == (100_000, 2)
    assert torch.equal(both[:50_000], samples)
    deviation = both[50_000:].std(0) / axes.span
    assert deviation.tolist() == pytest.approx([30 / 256, 30 / 256], rel=0.02)


def test_noisy_samples_beyond_the_range_are_dropped_clipped_or_wrapped() -> None:
    samples = torch.full((1000, 1), 0.99, dtype=torch.float64)

    dropped = with_noisy_copy(samples, axes_of(("S",)), 0.1, "drop", seeded())
    wrapped = with_noisy_copy(samples, axes_of(("H",)), 0.1, "drop", seeded())

    assert 1400 < len(dropped) < 1600
    assert dropped.max() <= 1
    assert len(wrapped) == 2000
    assert 0 <= wrapped.min() < 0.2


def test_noise_widens_and_the_settings_reach_it() -> None:
    axes, samples = axes_of(("S",)), samples_of(1)
    beyond = torch.linspace(0.52, 0.7, 50)[:, None]

    plain, noisy = fit(SIMPLE, samples, axes), fit(NOISY, samples, axes)
    wider = fit(NOISY, samples, axes, NOISY.settings.model_validate({"noise": 0.5}))

    assert plain.distance(beyond).isinf().all()
    assert noisy.distance(beyond).isfinite().float().mean() > 0.9
    assert wider.distance(beyond).isfinite().all()


def test_too_many_bins_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^bins: 400 bins in 3 dimensions are too many .use"):
        fit(SIMPLE, samples_of(3), axes_of(("R", "G", "B")), HistogramSettings(bins=400))
