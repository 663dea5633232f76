"""Whole pictures in other frames and another light."""

import pytest
import torch

from roadtorch.train.config import Light, Shift
from roadtorch.train.variation import draw_frames, reframed, relit
from tests.streets import scene

STILL = Shift(scale=0, stretch=0, rotation=0, move=0)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_without_shift_a_frame_is_the_picture_or_its_mirror_image() -> None:
    maps = torch.rand(6, 2, 9, 12, generator=seeded(1))

    seen = reframed(maps, draw_frames(6, (9, 12), STILL, seeded(2)), "border")

    mirrored = [torch.allclose(a, b.flip(-1), atol=1e-5) for a, b in zip(seen, maps, strict=True)]
    same = [torch.allclose(a, b, atol=1e-5) for a, b in zip(seen, maps, strict=True)]
    assert all(a != b for a, b in zip(mirrored, same, strict=True))
    assert any(mirrored)
    assert any(same)


def test_a_turned_frame_keeps_its_shape() -> None:
    square = torch.zeros(1, 1, 60, 120)
    square[..., 20:40, 50:70] = 1

    frames = draw_frames(1, (60, 120), Shift(scale=0, stretch=0, rotation=45, move=0), seeded(4))
    turned = reframed(square, frames, "zeros")

    assert float(turned.sum()) == pytest.approx(400, rel=0.02)


def test_what_is_outside_the_picture_does_not_count() -> None:
    frames = torch.tensor([[[1.0, 0, 1.0], [0, 1.0, 0]]])  # half a picture to the right

    seen = reframed(torch.ones(1, 1, 8, 8), frames, "zeros")

    assert seen[0, 0, 0].tolist() == [1, 1, 1, 1, 0, 0, 0, 0]


def test_light_changes_the_picture_and_stays_in_range() -> None:
    images = torch.stack([scene(seed, 60, 80).image for seed in range(4)])

    relit_images = relit(images, Light(), seeded(3))

    assert relit_images.min() >= 0
    assert relit_images.max() <= 1
    change = (relit_images - images).abs().mean((1, 2, 3))
    assert (change > 0.01).all()
    none = Light(gamma=0, gain=0, tint=0, saturation=0, noise=0)
    torch.testing.assert_close(relit(images, none, seeded(3)), images, atol=1e-4, rtol=0)
