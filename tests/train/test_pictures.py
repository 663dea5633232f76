"""Whole pictures: teacher, goals, variation, error, batches."""

from pathlib import Path

import pytest
import torch

from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.scenes import render_scene
from roadtorch.train.config import Light, PictureTraining, Rounds, Shift, Teacher, build_training
from roadtorch.train.pictures import (
    Goals,
    PictureError,
    PictureSamples,
    both_ways,
    centred,
    draw_frames,
    goal_error,
    goals_of,
    load_teachers,
    prepare_picture,
    reframed,
    relit,
    teacher_maps,
)
from roadtorch.train.prepared import write_arrays
from roadtorch.train.samples import Batch
from roadtorch.train.team import Team

STILL = Shift(scale=0, stretch=0, rotation=0, move=0)


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def maps_of(*pixels: tuple[float, float, float, float]) -> torch.Tensor:
    """Maps (1,4,1,n): sky, vertical, horizontal, road of n pixels."""
    return torch.tensor(pixels).T[None, :, None]


# --- teacher ---------------------------------------------------------------------------------


def test_the_teacher_gives_layout_and_road() -> None:
    image = render_scene(1, 60, 80).image
    teacher = load_detector("labeller")

    maps = teacher_maps(image, [teacher])

    torch.testing.assert_close(maps[:3], teacher.detect(image).cues["layout"])
    torch.testing.assert_close(maps[3], teacher.detect(image).likelihood)


def test_two_views_are_the_same_for_the_mirrored_picture() -> None:
    image = render_scene(1, 60, 80).image
    teachers = load_teachers(Teacher(detector="labeller", views="scaled"))

    maps = teacher_maps(image, teachers, "scaled")
    mirrored = teacher_maps(image.flip(-1), teachers, "scaled")

    torch.testing.assert_close(maps, mirrored.flip(-1))
    assert len(teachers) == 2


def test_a_teacher_without_a_layout_is_told() -> None:
    with pytest.raises(ConfigError, match="prior:rows has no layout among its cues"):
        teacher_maps(render_scene(1, 60, 80).image, [load_detector("prior:rows")])


def test_a_prepared_picture_has_the_networks_size() -> None:
    training = build_training({"kind": "pictures", "network": {"height": 32, "width": 48}})
    assert isinstance(training, PictureTraining)

    arrays = prepare_picture(render_scene(1, 60, 80).image, [load_detector("labeller")], training)

    assert {name: tuple(value.shape) for name, value in arrays.items()} == {
        "image": (3, 32, 48),
        "maps": (4, 32, 48),
    }
    assert {value.dtype for value in arrays.values()} == {torch.uint8}


# --- goals -----------------------------------------------------------------------------------


def test_the_threshold_becomes_one_half_and_the_ends_stay() -> None:
    likelihood = torch.tensor([0.0, 0.2, 0.39, 0.8, 1.0])

    moved = centred(likelihood, 0.39)

    assert moved[2] == pytest.approx(0.5)
    assert moved[0] == 0
    assert moved[4] == 1
    assert (moved.diff() > 0).all()
    odds = moved[1] / (1 - moved[1])
    assert float(odds) == pytest.approx((0.2 / 0.8) / (0.39 / 0.61), rel=1e-5)


def test_only_certain_pixels_count() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9), (0.5, 0.4, 0.1, 0.52), (0.2, 0.0, 0.8, 0.1))

    goals = goals_of(
        teacher, None, Teacher(margin=0.5, road_margin=0.5, road_threshold=0.5), Rounds()
    )

    assert goals.layout_weight.flatten().tolist() == [1, 0, 1]
    assert goals.road_weight.flatten().tolist() == [1, 0, 1]
    torch.testing.assert_close(goals.layout, teacher[:, :3])


def test_in_later_rounds_only_agreement_counts() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9), (0.9, 0.1, 0.0, 0.9), (0.1, 0.1, 0.8, 0.1))
    network = maps_of((0.8, 0.2, 0.0, 0.8), (0.0, 1.0, 0.0, 0.1), (0.0, 0.0, 1.0, 0.9))

    goals = goals_of(
        teacher, network, Teacher(margin=0.5, road_threshold=0.5), Rounds(combine="agreement")
    )

    assert goals.layout_weight.flatten().tolist() == [1, 0, 1]
    assert goals.road_weight.flatten().tolist() == [1, 0, 0]
    torch.testing.assert_close(goals.layout, (teacher + network)[:, :3] / 2)


def test_the_last_network_alone_can_be_the_teacher() -> None:
    teacher = maps_of((0.9, 0.1, 0.0, 0.9))
    network = maps_of((0.0, 1.0, 0.0, 0.1))

    goals = goals_of(teacher, network, Teacher(), Rounds(combine="network"))

    torch.testing.assert_close(goals.layout, network[:, :3])
    torch.testing.assert_close(goals.road, network[:, 3:])
    assert goals.layout_weight.item() == 1


def test_the_error_is_small_for_right_scores_and_ignores_what_does_not_count() -> None:
    layout = torch.tensor([1.0, 0, 0]).reshape(1, 3, 1, 1).expand(2, 3, 4, 4)
    road, ones = torch.ones(2, 1, 4, 4), torch.ones(2, 1, 4, 4)
    right = torch.tensor([20.0, -20, -20, 20]).reshape(1, 4, 1, 1).expand(2, 4, 4, 4)
    goals = Goals(layout, ones, road, ones)

    assert float(goal_error(right, goals, 1.0)) < 1e-6
    assert float(goal_error(-right, goals, 1.0)) == pytest.approx(2 * (40 + 20), rel=0.02)
    assert float(goal_error(-right, goals, 0.0)) == pytest.approx(2 * 40, rel=0.02)
    nothing = goals._replace(layout_weight=0 * ones, road_weight=0 * ones)
    assert float(goal_error(-right, nothing, 1.0)) == 0


@pytest.mark.parametrize("targets", ["hard", "soft"])
def test_targets_are_the_best_class_or_the_potentials(targets: str) -> None:
    training = build_training({"kind": "pictures", "teacher": {"targets": targets}})
    assert isinstance(training, PictureTraining)
    goals = torch.tensor([0.6, 0.3, 0.1, 1.0, 0.7, 1.0]).reshape(1, 6, 1, 1)
    scores = torch.zeros(1, 4, 1, 1, requires_grad=True)

    PictureError(training)(torch.nn.Identity(), Batch(scores, goals, torch.ones(1), 1)).backward()

    assert scores.grad is not None
    wanted = [1.0, 0, 0, 1.0] if targets == "hard" else [0.6, 0.3, 0.1, 0.7]
    start = torch.tensor([1 / 3, 1 / 3, 1 / 3, 0.5])
    torch.testing.assert_close(scores.grad.flatten(), start - torch.tensor(wanted))


# --- variation -------------------------------------------------------------------------------


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
    images = torch.stack([render_scene(seed, 60, 80).image for seed in range(4)])

    relit_images = relit(images, Light(), seeded(3))

    assert relit_images.min() >= 0
    assert relit_images.max() <= 1
    change = (relit_images - images).abs().mean((1, 2, 3))
    assert (change > 0.01).all()
    none = Light(gamma=0, gain=0, tint=0, saturation=0, noise=0)
    torch.testing.assert_close(relit(images, none, seeded(3)), images, atol=1e-4, rtol=0)


# --- samples ---------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    paths = []
    for number in range(5):
        path = tmp_path / f"{number}.npz"
        maps = torch.randint(256, (4, 32, 40), generator=seeded(number)).to(torch.uint8)
        image = torch.full((3, 32, 40), 40 * number, dtype=torch.uint8)
        write_arrays(path, {"image": image, "maps": maps})
        paths.append(path)
    return paths


def training_of(**values: object) -> PictureTraining:
    network = {"height": 32, "width": 40, "narrow": 8, "wide": 8}
    found = build_training(
        {"kind": "pictures", "network": network, "descent": {"batch": 2}, **values}
    )
    assert isinstance(found, PictureTraining)
    return found


def test_an_epoch_has_every_picture_once(files: list[Path]) -> None:
    light = {"gamma": 0.0, "gain": 0.0, "tint": 0.0, "saturation": 0.0, "noise": 0.0}
    samples = PictureSamples(files, [], 0, training_of(light=light), Team())

    batches = [batch for chunk in range(samples.chunks) for batch in samples.batches(0, chunk)]

    levels = torch.cat([batch.inputs for batch in batches]).mean((1, 2, 3))
    wanted = (torch.arange(5) * 40 / 255 - 0.5) * 4
    torch.testing.assert_close(levels.sort().values, wanted, atol=1e-3, rtol=0)
    assert all(batch.targets.shape[1:] == (6, 32, 40) for batch in batches)


@pytest.mark.parametrize("size", [2, 4])
def test_the_shares_of_a_team_are_the_batches_of_one(files: list[Path], size: int) -> None:
    training = training_of()
    (alone,) = PictureSamples(files, files, 1, training, Team()).batches(3, 0)

    for rank in range(size):
        samples = PictureSamples(files, files, 1, training, Team(rank, size))
        (part,) = samples.batches(3, 0)
        assert part.count == alone.count
        torch.testing.assert_close(part.inputs, alone.inputs[rank::size])
        torch.testing.assert_close(part.targets, alone.targets[rank::size])


def test_rounds_and_epochs_draw_differently(files: list[Path]) -> None:
    training = training_of()

    def first(number: int, epoch: int) -> torch.Tensor:
        return next(PictureSamples(files, [], number, training, Team()).batches(epoch, 0)).inputs

    assert torch.equal(first(0, 0), first(0, 0))
    assert not torch.equal(first(0, 0), first(1, 0))
    assert not torch.equal(first(0, 0), first(0, 1))


def test_a_vote_with_the_mirror_image_has_no_side() -> None:
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8)).eval()
    image = torch.rand(3, 32, 40, generator=seeded(6))

    vote = both_ways(network, image)

    torch.testing.assert_close(vote, both_ways(network, image.flip(-1)).flip(-1))
    torch.testing.assert_close(vote[:3].sum(0), torch.ones(32, 40))
