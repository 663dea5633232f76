"""Whole pictures in other frames and another light."""

import pytest
import torch

from roadtorch.train.augmentation import at_night, draw_frames, reframed, relit, resurfaced, shaded
from roadtorch.train.config import Light, Nights, Shadows, Shift, Surfaces
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


def test_of_a_lower_part_the_bottom_stays_and_the_top_goes() -> None:
    rows = torch.linspace(0, 1, 80)[None, None, :, None].expand(8, 1, 80, 60)

    frames = draw_frames(8, (80, 60), Shift(lower=1.0, cut=0.5), seeded(5))
    seen = reframed(rows, frames, "border")

    assert torch.allclose(seen[:, 0, -1], torch.ones(8, 60), atol=0.02)
    assert ((seen[:, 0, 0] >= -0.01) & (seen[:, 0, 0] <= 0.51)).all()
    assert seen[:, 0, 0].max() > 0.2
    assert frames[:, 0, 0].abs().max() <= 1  # nothing beside the picture is seen


def test_at_night_the_road_ahead_is_lit_and_what_has_no_light_is_dark() -> None:
    image = torch.full((1, 3, 80, 60), 0.8)
    unlit = torch.zeros(1, 1, 80, 60)
    unlit[..., 70:, :] = 1
    nights = Nights(darkest=0.05, lamps=0)

    found = [at_night(image, unlit, nights, seeded(seed)) for seed in range(12)]

    for one in found:
        ahead, above = one[..., 44:66, 24:36].amax(), one[..., :20, :].amax()
        assert ahead > 2 * above
        assert one[..., 70:, :].amax() <= 0.8 * 0.3 * 1.3 + 1e-6
    assert len({float(one.mean()) for one in found}) == len(found)


def test_lamps_shine_at_night_and_not_below_the_horizon() -> None:
    black = torch.zeros(1, 3, 80, 60)
    unlit = torch.ones(1, 1, 80, 60)

    found = [at_night(black, unlit, Nights(lamps=20), seeded(seed)) for seed in range(6)]

    for one in found:
        assert one[..., :48, :].amax() > 0.3
        assert one[..., 60:, :].amax() < 0.05


def test_other_surfaces_change_the_ground_and_leave_the_rest() -> None:
    image = torch.full((1, 3, 40, 60), 0.5)
    road, ground = torch.zeros(1, 1, 40, 60), torch.zeros(1, 1, 40, 60)
    road[..., 30:, :], ground[..., 20:30, :] = 1, 1

    changed = resurfaced(image, road, ground, Surfaces(), seeded(6))

    assert torch.equal(changed[..., :20, :], image[..., :20, :])
    on_road, beside = (changed[0, :, rows].mean((1, 2)) for rows in (slice(30, 40), slice(20, 30)))
    assert (on_road - 0.5).abs().max() > 0.01
    assert (on_road - beside).abs().max() > 0.01
    assert changed.min() >= 0
    assert changed.max() <= 1


def test_a_shadow_darkens_a_band_of_the_lower_part_and_nothing_else() -> None:
    image = torch.full((1, 3, 80, 60), 0.8)

    found = [shaded(image, Shadows(darkest=0.25), seeded(seed)) for seed in range(20)]

    for one in found:
        assert torch.allclose(one[..., :12, :], image[..., :12, :], atol=1e-3)
        assert 0.8 * 0.25 - 1e-3 <= one.min() <= one.max() <= 0.8 + 1e-6
    assert sum(float(one.min()) < 0.8 * 0.72 for one in found) >= 15  # a band may miss the picture
