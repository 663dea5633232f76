"""The model-based classifiers: histograms from the samples, and with a noisy copy."""

import numpy as np
import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.histogram import HistogramSettings, with_noisy_copy
from tests.draws import random, seeded

SIMPLE = CLASSIFIERS["hist64_s"]


def test_distance_zero_is_the_fullest_bin_and_an_empty_one_is_infinitely_far() -> None:
    samples = torch.tensor([[0.1], [0.5], [0.5], [0.5], [0.9]])
    fitted = fit(SIMPLE, samples, axes_of(("S",)))

    found = fitted.distance(torch.tensor([[0.5], [0.1], [0.3]]))

    assert found.tolist() == pytest.approx([0, (2 * np.log(3)) ** 0.5, np.inf])
    assert fitted.likelihood(torch.tensor([[0.3]])) == 0


def test_the_noisy_copy_has_the_deviation_of_p3_in_ranges_of_the_plane() -> None:
    axes, samples = axes_of(("S", "O2")), torch.tensor([[0.5, 0.0]]).double().repeat(50_000, 1)

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


def test_too_many_bins_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^bins: 400 bins in 3 dimensions are too many .use"):
        fit(SIMPLE, random(90, 3), axes_of(("R", "G", "B")), HistogramSettings(bins=400))
