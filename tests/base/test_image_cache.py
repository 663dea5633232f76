"""Results are cached inside a block only, and for one image and settings only."""

import time

import pytest
import torch
from torch import Tensor

from roadtorch.base.image_cache import cached_per_image, image_cache
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import render_scene

calls: list[tuple[int, int]] = []


@cached_per_image
def doubled(image: Tensor, times: int = 1) -> Tensor:
    """Multiply an image by a power of two."""
    calls.append((id(image), times))
    time.sleep(0.002)
    return image * 2**times


@cached_per_image
def summed(image: Tensor) -> Tensor:
    """Sum the doubled image, which is cached itself."""
    time.sleep(0.002)
    return doubled(image, 1).sum()


@pytest.fixture(autouse=True)
def _no_calls_yet() -> None:
    calls.clear()


def test_inside_a_block_the_same_question_is_answered_once():
    image, equal = torch.ones(3, 4, 4), torch.ones(3, 4, 4)

    with image_cache():
        first = doubled(image, 1)
        assert doubled(image, 1) is first
        assert doubled(image, 2)[0, 0, 0] == 4
        assert doubled(equal, 1) is not first  # equal, but not the same image

    assert calls == [(id(image), 1), (id(image), 2), (id(equal), 1)]
    assert doubled(image, 1) is not doubled(image, 1)  # outside a block every call computes


def test_a_block_forgets_and_images_that_are_gone_leave_nothing_behind():
    with image_cache():
        results = [doubled(torch.full((1,), float(value)), 1) for value in range(30)]

    assert [int(result) for result in results] == list(range(0, 60, 2))
    image = torch.ones(1)
    with image_cache():
        first = doubled(image, 1)
    with image_cache():
        assert doubled(image, 1) is not first


def test_saved_time_is_that_of_the_work_with_all_its_parts():
    image = torch.ones(3, 4, 4)

    with image_cache() as shared:
        doubled(image, 1)
        assert shared.saved_seconds == 0
        summed(image)  # takes 2 ms of its own and saves 2 ms
        once = shared.saved_seconds
        summed(image)

    assert once >= 0.002
    assert shared.saved_seconds - once >= 0.004


def test_shared_work_changes_no_result():
    image = render_scene(3, 96, 128).image
    names = ("fusion", "cpf:v2", "labeller", "cpf", "grey-uniformity", "lbp", "fusion")
    alone = [load_detector(name).detect(image) for name in names[:-1]]

    with image_cache():
        cached = [load_detector(name).detect(image) for name in names]

    for expected, detection in zip([*alone, alone[0]], cached, strict=True):
        assert torch.equal(expected.likelihood, detection.likelihood)
        assert expected.cues.keys() == detection.cues.keys()
        assert all(torch.equal(expected.cues[cue], detection.cues[cue]) for cue in expected.cues)
