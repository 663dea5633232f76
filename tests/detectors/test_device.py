"""Detectors work where their tensors are: on a pretended device, as on a GPU, nothing is mixed."""

import numpy as np
import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import render_scene
from tests.pretended_device import Pretended, PretendedDevice, moved
from tests.representatives import quick, ways_of_working

IMAGE = render_scene(5, 48, 64).image


@pytest.mark.parametrize("name", ways_of_working())
def test_a_detector_works_on_another_device(name: str) -> None:
    here = load_detector(name, **quick(name)).detect(IMAGE)
    detector = moved(load_detector(name, **quick(name)))

    with PretendedDevice():
        there = detector.detect(Pretended(IMAGE))  # type: ignore[attr-defined]

    assert isinstance(there.likelihood, Pretended)
    assert isinstance(there.mask, Pretended)
    # On the CPU it is OpenCV that resizes: equal but for rounding, which deep networks magnify.
    rounding = 5e-5 if name.startswith("fusion") else 1e-6
    np.testing.assert_allclose(there.likelihood.inner, here.likelihood, atol=rounding, rtol=0)
    assert torch.equal(there.mask.inner, here.mask)
    assert there.trust == (None if here.trust is None else pytest.approx(here.trust, abs=1e-4))
    assert there.doubt == here.doubt
    assert set(there.cues) == set(here.cues)


def test_images_are_moved_to_the_device_that_a_detector_was_made_for() -> None:
    detector = moved(load_detector("fusion"))
    detector.device = "meta"  # type: ignore[assignment]

    with PretendedDevice():
        there = detector([IMAGE.numpy().transpose(1, 2, 0)], order="rgb")[0]  # type: ignore[operator]

    assert isinstance(there.likelihood, Pretended)


@pytest.mark.parametrize(
    ("device", "what"), [("gpu", "is no device of torch"), ("meta", "cannot be used")]
)
def test_a_missing_device_is_refused_when_the_detector_is_made(device: str, what: str) -> None:
    with pytest.raises(ConfigError, match=rf"^device: {what}"):
        load_detector("fusion", device=device)
