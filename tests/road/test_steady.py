"""Likelihoods steadied over time."""

import pytest
import torch

from roadtorch.imaging.motion import flow_picture
from roadtorch.road.fusion import log_odds
from roadtorch.road.steady import (
    Steady,
    SteadySettings,
    flow_confidence,
    smoothed,
)
from roadtorch.scenes.street import render_scene

STREET = render_scene(1, 120, 160, noise=0.0).image
OTHER = render_scene(2, 120, 160, noise=0.0).image


def settings(**chosen: float) -> SteadySettings:
    return SteadySettings(**{"memory": 6.0, **chosen})  # type: ignore[arg-type]


def noisy(frames: int, seed: int = 0, deviation: float = 1.0) -> torch.Tensor:
    """Likelihoods (n,120,160) of even odds with noise in their log odds."""
    generator = torch.Generator().manual_seed(seed)
    return (deviation * torch.randn(frames, 120, 160, generator=generator)).sigmoid()


def test_the_first_frame_and_a_constant_stay_as_they_are() -> None:
    steady, likelihood = Steady(settings()), noisy(1)[0]

    first, *found = (steady(STREET, likelihood) for _ in range(12))

    assert torch.allclose(first, likelihood, atol=1e-5)
    assert torch.allclose(found[-1], likelihood, atol=1e-4)


def test_a_still_picture_averages_its_first_frames_evenly() -> None:
    steady, likelihoods = Steady(settings()), noisy(4)

    for likelihood in likelihoods:
        found = steady(STREET, likelihood)

    assert torch.allclose(log_odds(found), log_odds(likelihoods).mean(0), atol=1e-3)


def test_the_variance_of_noise_falls_to_that_of_a_fading_memory() -> None:
    memory = 6.0
    steady = Steady(settings(memory=memory))

    for likelihood in noisy(60):
        found = steady(STREET, likelihood)

    # Weight a = m/(m+1) of the past: variance (1-a)/(1+a) = 1/(2m+1) of that of one frame.
    assert float(log_odds(found).var()) == pytest.approx(1 / (2 * memory + 1), rel=0.05)


def test_without_memory_every_frame_is_by_itself() -> None:
    steady = Steady(settings(memory=0.0))

    for likelihood in noisy(3):
        assert torch.allclose(steady(STREET, likelihood), likelihood, atol=1e-5)


def test_what_moves_with_the_picture_stays_where_it_belongs() -> None:
    wide = render_scene(1, 120, 240, noise=0.0)
    steady, shift = Steady(settings()), 4
    generator = torch.Generator().manual_seed(0)

    for number in range(12):
        seen = slice(number * shift, number * shift + 160)
        odds = 4.0 * wide.road[:, seen] - 2 + 2 * torch.randn(120, 160, generator=generator)
        likelihood = odds.sigmoid()
        found = steady(wide.image[..., seen].contiguous(), likelihood)

    truth = wide.road[:, seen]
    wrong, wrong_alone = ((each >= 0.5) != truth for each in (found, likelihood))
    assert wrong_alone.float().mean() > 0.1
    assert wrong[:, :150].float().mean() < 0.03  # the last columns came into view just now


def test_a_cut_forgets() -> None:
    steady, road, none = Steady(settings()), *(torch.full((120, 160), p) for p in (0.9, 0.1))

    for _ in range(8):
        steady(STREET, road)

    assert torch.allclose(steady(OTHER, none), none, atol=1e-4)


def test_another_size_begins_anew() -> None:
    steady, likelihood = Steady(settings()), torch.full((60, 80), 0.2)
    steady(STREET, torch.full((120, 160), 0.9))

    found = steady(STREET[:, :60, :80].contiguous(), likelihood)

    assert torch.allclose(found, likelihood, atol=1e-5)


def test_what_looks_different_now_is_not_believed() -> None:
    grey = flow_picture(STREET, 240)
    covered = grey.clone()
    covered[60:100, 60:100] = 255 - covered[60:100, 60:100]
    still = torch.zeros(*grey.shape, 2)

    belief = flow_confidence(grey, covered, still, settings())

    assert belief[66:94, 66:94].mean() < 0.2
    assert belief[:40].mean() > 0.8


def test_a_change_of_light_is_no_difference() -> None:
    grey = flow_picture(STREET * 0.8, 240)

    belief = flow_confidence(grey, grey + 20, torch.zeros(*grey.shape, 2), settings())

    assert belief.mean() > 0.95


def test_likelihoods_of_zero_and_one_stay_finite() -> None:
    steady = Steady(settings())
    likelihood = torch.zeros(120, 160)
    likelihood[60:] = 1

    for each in (likelihood, 1 - likelihood, likelihood):
        found = steady(STREET, each)

    assert found.isfinite().all()
    assert 0 <= found.min() <= found.max() <= 1


@pytest.mark.parametrize("size", [(16, 16), (17, 300), (97, 131)])
def test_any_size_will_do_and_flat_pictures_too(size) -> None:
    steady, likelihood = Steady(settings()), torch.full(size, 0.7)

    for _ in range(3):
        found = steady(torch.full((3, *size), 0.5), likelihood)

    assert torch.allclose(found, likelihood, atol=1e-4)


def test_the_same_frames_give_the_same_bytes() -> None:
    runs = []
    for _ in range(2):
        steady = Steady(settings())
        runs.append([steady(STREET, each) for each in noisy(4)])

    assert all(torch.equal(*pair) for pair in zip(*runs, strict=True))


def test_what_is_given_is_not_changed() -> None:
    steady, likelihood = Steady(settings()), noisy(1)[0]
    image, kept = STREET.clone(), likelihood.clone()

    for _ in range(3):
        steady(image, likelihood)

    assert torch.equal(image, STREET)
    assert torch.equal(likelihood, kept)


def lower(rows: int) -> torch.Tensor:
    hidden = torch.zeros(120, 160, dtype=torch.bool)
    hidden[-rows:] = True
    return hidden


def test_what_one_frame_hides_is_remembered() -> None:
    steady, seen, ego = Steady(settings()), torch.full((120, 160), 0.9), lower(40)
    for _ in range(4):
        steady(STREET, seen)

    for _ in range(3):  # a shadow that is taken for an ego car
        found = steady(STREET, seen.masked_fill(ego, 0.0), ego)
        assert torch.allclose(found, seen, atol=1e-2)
        assert steady.hidden is not None
        assert not steady.hidden.any()

    assert torch.allclose(steady(STREET, seen), seen, atol=1e-2)


def test_an_ego_car_is_never_road_not_even_where_a_frame_misses_it() -> None:
    steady, seen, ego = Steady(settings()), torch.full((120, 160), 0.9), lower(40)

    assert steady.hidden is None  # before the first frame nothing is known
    for number in range(12):
        missed = number % 3 == 2
        hidden = torch.zeros_like(ego) if missed else ego
        found = steady(STREET, seen.masked_fill(hidden, 0.0), hidden)
        assert steady.hidden is not None
        assert torch.equal(steady.hidden, ego)
        assert (found[ego] == 0).all()

    assert torch.allclose(found[~ego], seen[~ego], atol=1e-3)


def test_what_was_hidden_from_the_beginning_is_learned_at_once() -> None:
    steady, seen, ego = Steady(settings()), torch.full((120, 160), 0.9), lower(40)
    steady(STREET, seen.masked_fill(ego, 0.0), ego)

    for _ in range(2):  # then the car is in less than half of the frames
        found = steady(STREET, seen)

    assert torch.allclose(found, seen, atol=1e-3)


def test_smoothed_frames_of_a_still_picture_say_their_mean() -> None:
    odds = [log_odds(one) for one in noisy(5)]
    greys = [flow_picture(STREET, 160)] * 5

    found = smoothed(greys, odds, settings(memory=20.0))

    for one in found:
        assert torch.allclose(one, torch.stack(odds).mean(0), atol=1e-3)


def test_smoothing_ends_at_a_cut_on_either_side() -> None:
    odds = [log_odds(one) for one in noisy(4)]
    greys = [flow_picture(image, 160) for image in (STREET, STREET, OTHER, OTHER)]

    found = smoothed(greys, odds, settings())

    assert torch.allclose(found[0], (odds[0] + odds[1]) / 2, atol=1e-3)
    assert torch.allclose(found[3], (odds[2] + odds[3]) / 2, atol=1e-3)
