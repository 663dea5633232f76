"""Temporal smoothing of likelihoods."""

from collections.abc import Iterable

import pytest
import torch
from torch import Tensor

from roadtorch.imaging.motion import flow_image
from roadtorch.road.bayes import log_odds
from roadtorch.road.temporal_filter import (
    TemporalFilter,
    TemporalFilterSettings,
    estimate_motion,
    flow_confidence,
    smooth_log_odds,
)
from roadtorch.testing.scenes import render_scene

STREET = render_scene(1, 120, 160, noise=0.0).image
OTHER = render_scene(2, 120, 160, noise=0.0).image
EGO = torch.zeros(120, 160, dtype=torch.bool)
EGO[-40:] = True
ROAD = torch.full((120, 160), 0.9)


def make_filter(memory: float = 6.0) -> TemporalFilter:
    return TemporalFilter(TemporalFilterSettings(memory=memory))


def noisy(frames: int) -> Tensor:
    """Likelihoods (n,120,160) of even odds with noise in their log odds."""
    return torch.randn(frames, 120, 160, generator=torch.Generator().manual_seed(0)).sigmoid()


def smooth_all(
    likelihoods: Iterable[Tensor],
    temporal_filter: TemporalFilter | None = None,
    image: Tensor = STREET,
) -> list[Tensor]:
    """Return the smoothed likelihoods of a still image."""
    temporal_filter = make_filter() if temporal_filter is None else temporal_filter
    return [temporal_filter(image, likelihood) for likelihood in likelihoods]


def test_the_first_frame_and_a_constant_stay_as_they_are_and_so_does_what_is_given() -> None:
    likelihood, image = noisy(1)[0], STREET.clone()
    kept = likelihood.clone()

    first, *later = smooth_all([likelihood] * 12, image=image)

    assert torch.allclose(first, likelihood, atol=1e-5)
    assert torch.allclose(later[-1], likelihood, atol=1e-4)
    assert torch.equal(image, STREET)
    assert torch.equal(likelihood, kept)


def test_a_still_image_averages_its_first_frames_evenly() -> None:
    *_, last = smooth_all(noisy(4))

    assert torch.allclose(log_odds(last), log_odds(noisy(4)).mean(0), atol=1e-3)
    assert torch.equal(last, smooth_all(noisy(4))[-1])  # the same frames, the same bytes


def test_the_variance_of_noise_falls_to_that_of_a_fading_memory() -> None:
    memory = 6.0
    *_, last = smooth_all(noisy(40), make_filter(memory))

    # Weight a = m/(m+1) of the past: variance (1-a)/(1+a) = 1/(2m+1) of that of one frame.
    assert float(log_odds(last).var()) == pytest.approx(1 / (2 * memory + 1), rel=0.05)


def test_what_moves_with_the_image_stays_where_it_belongs() -> None:
    wide = render_scene(1, 120, 240, noise=0.0)
    temporal_filter, shift, generator = make_filter(), 4, torch.Generator().manual_seed(0)
    columns, smooth, likelihood = slice(0), wide.image, wide.image
    for number in range(12):
        columns = slice(number * shift, number * shift + 160)
        odds = 4.0 * wide.road[:, columns] - 2 + 2 * torch.randn(120, 160, generator=generator)
        likelihood = odds.sigmoid()
        smooth = temporal_filter(wide.image[..., columns].contiguous(), likelihood)

    truth = wide.road[:, columns]
    wrong, wrong_alone = ((each >= 0.5) != truth for each in (smooth, likelihood))
    assert wrong_alone.float().mean() > 0.1
    assert wrong[:, :150].float().mean() < 0.03  # the last columns came into view just now


@pytest.mark.parametrize("image", [OTHER, STREET[:, :60, :80].contiguous()])
def test_a_cut_and_another_size_begin_anew(image: Tensor) -> None:
    temporal_filter, none = make_filter(), torch.full(image.shape[1:], 0.1)
    smooth_all([ROAD] * 8, temporal_filter)

    assert torch.allclose(temporal_filter(image, none), none, atol=1e-4)


def test_what_looks_different_is_not_believed_and_a_change_of_light_is_no_difference() -> None:
    grey = flow_image(STREET * 0.8, 240)
    covered, still = grey.clone(), torch.zeros(*grey.shape, 2)
    covered[60:100, 60:100] = 255 - covered[60:100, 60:100]

    belief = flow_confidence(grey, covered, still, TemporalFilterSettings())

    assert belief[66:94, 66:94].mean() < 0.2
    assert belief[:40].mean() > 0.8
    assert flow_confidence(grey, grey + 20, still, TemporalFilterSettings()).mean() > 0.95


@pytest.mark.parametrize("previous", [0, 1])
def test_a_motion_estimated_elsewhere_changes_nothing(previous: int) -> None:
    """A filter that missed the frame before (``previous`` 1) does not follow its motion."""
    wide = render_scene(1, 120, 240, noise=0.0).image
    frames = [wide[..., 6 * n : 6 * n + 160].contiguous() for n in (0, 1, 2)]
    greys = [flow_image(frame, TemporalFilterSettings().width) for frame in frames]
    motion = estimate_motion(greys[previous], greys[2], TemporalFilterSettings())
    alone, given = make_filter(), make_filter()

    first, last = noisy(2)
    alone(frames[0], first)
    given(frames[0], first)

    assert torch.equal(alone(frames[2], last), given(frames[2], last, motion=motion))


# --- the ego car ------------------------------------------------------------------------------


def test_what_one_frame_hides_is_remembered() -> None:
    temporal_filter = make_filter()
    smooth_all([ROAD] * 4, temporal_filter)

    for _ in range(3):  # a shadow that is taken for an ego car
        smooth = temporal_filter(STREET, ROAD.masked_fill(EGO, 0.0), EGO)
        assert torch.allclose(smooth, ROAD, atol=1e-2)
        assert temporal_filter.hidden is not None
        assert not temporal_filter.hidden.any()

    assert torch.allclose(temporal_filter(STREET, ROAD), ROAD, atol=1e-2)


def test_an_ego_car_is_never_road_not_even_where_a_frame_misses_it() -> None:
    temporal_filter, smooth = make_filter(), ROAD
    assert temporal_filter.hidden is None  # before the first frame nothing is known
    for number in range(12):
        hidden = EGO & (number % 3 != 2)
        smooth = temporal_filter(STREET, ROAD.masked_fill(hidden, 0.0), hidden)
        assert temporal_filter.hidden is not None
        assert torch.equal(temporal_filter.hidden, EGO)
        assert (smooth[EGO] == 0).all()

    assert torch.allclose(smooth[~EGO], ROAD[~EGO], atol=1e-3)


# --- by the frames before and after -----------------------------------------------------------


@pytest.mark.parametrize(
    ("images", "of"),
    [([STREET] * 4, [range(4)] * 4), ([STREET, STREET, OTHER, OTHER], [range(2), range(2, 4)])],
)
def test_smoothed_frames_are_means_up_to_a_cut(images: list[Tensor], of: list[range]) -> None:
    odds = [log_odds(likelihood) for likelihood in noisy(4)]
    greys = [flow_image(image, 160) for image in images]

    smooth = smooth_log_odds(greys, odds, TemporalFilterSettings(memory=20.0))

    for frame, alike in {0: of[0], 3: of[-1]}.items():
        mean = torch.stack([odds[number] for number in alike]).mean(0)
        assert torch.allclose(smooth[frame], mean, atol=1e-3)
