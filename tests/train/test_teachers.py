"""Who labels whole pictures: detectors, and the last network."""

import pytest
import torch

from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError
from roadtorch.layout.classes import CLASSES
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.train.config import PictureTraining, Teacher, build_training
from roadtorch.train.teachers import load_teachers, network_maps, prepare_picture, teacher_maps
from tests.streets import scene


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_teacher_gives_layout_and_road() -> None:
    image = scene(1, 60, 80).image
    teacher = load_detector("labeller")

    maps = teacher_maps(image, [teacher])

    torch.testing.assert_close(maps[:CLASSES], teacher.detect(image).cues["layout"])
    torch.testing.assert_close(maps[CLASSES], teacher.detect(image).likelihood)


def test_two_views_are_the_same_for_the_mirrored_picture() -> None:
    image = scene(1, 60, 80).image
    teachers = load_teachers(Teacher(detector="labeller", views="scaled"))

    maps = teacher_maps(image, teachers, "scaled")
    mirrored = teacher_maps(image.flip(-1), teachers, "scaled")

    torch.testing.assert_close(maps, mirrored.flip(-1))
    assert len(teachers) == 2


def test_a_teacher_without_a_layout_is_told() -> None:
    with pytest.raises(ConfigError, match="prior:rows has no layout among its cues"):
        teacher_maps(scene(1, 60, 80).image, [load_detector("prior:rows")])


def test_a_prepared_picture_has_the_networks_size() -> None:
    training = build_training({"kind": "pictures", "network": {"height": 32, "width": 48}})
    assert isinstance(training, PictureTraining)

    arrays = prepare_picture(scene(1, 60, 80).image, [load_detector("labeller")], training)

    assert {name: tuple(value.shape) for name, value in arrays.items()} == {
        "image": (3, 32, 48),
        "maps": (4, 32, 48),
    }
    assert {value.dtype for value in arrays.values()} == {torch.uint8}


def test_a_vote_with_the_mirror_image_has_no_side() -> None:
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8)).eval()
    image = torch.rand(3, 32, 40, generator=seeded(6))

    vote = network_maps(network, image)

    torch.testing.assert_close(vote, network_maps(network, image.flip(-1)).flip(-1))
    torch.testing.assert_close(vote[:CLASSES].sum(0), torch.ones(32, 40))
