"""Who labels whole pictures: detectors, and the last network."""

from pathlib import Path

import pytest
import torch
from torch import nn

from roadtorch.detector import Detector, DetectorSettings, Entry
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError
from roadtorch.layout.classes import CLASSES
from roadtorch.layout.picture_network import OUTPUTS, PictureNetwork, PictureNetworkSettings
from roadtorch.train.config import PictureTraining, Teacher, build_training
from roadtorch.train.prepared import write_arrays
from roadtorch.train.teachers import (
    lends_ego,
    load_teachers,
    network_maps,
    prepare_picture,
    teacher_maps,
)
from tests.streets import scene
from tests.train.runs import bonnet


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

    arrays = prepare_picture(scene(1, 60, 80).image, None, [load_detector("labeller")], training)

    assert {name: tuple(value.shape) for name, value in arrays.items()} == {
        "image": (3, 32, 48),
        "maps": (4, 32, 48),
        "ego": (32, 48),
    }
    assert {value.dtype for value in arrays.values()} == {torch.uint8}


class Watcher(nn.Module):
    """A teacher that remembers what it was shown."""

    def __init__(self, settings: DetectorSettings) -> None:
        super().__init__()
        self.seen: list[torch.Tensor] = []

    def forward(self, image: torch.Tensor) -> dict[str, torch.Tensor]:
        self.seen.append(image)
        return {"likelihood": image.mean(0), "layout": image}


@pytest.mark.parametrize("views", ["one", "mirrored"])
def test_the_teacher_never_sees_the_ego_car(views: str, tmp_path: Path) -> None:
    training = build_training(
        {"kind": "pictures", "network": {"height": 32, "width": 48}, "teacher": {"views": views}}
    )
    assert isinstance(training, PictureTraining)
    teacher = Detector(Entry("watcher", "remembers", DetectorSettings, Watcher), DetectorSettings())
    ego = bonnet(64, 96)
    image = torch.where(ego, torch.tensor(1.0), 0.5 * scene(1, 64, 96).image)

    arrays = prepare_picture(image, ego, [teacher], training)

    seen = teacher.analysis.seen
    assert isinstance(seen, list)
    assert len(seen) == (1 if views == "one" else 2)
    assert all(float(each.max()) <= 0.5 for each in seen)  # the bonnet is white
    assert torch.equal(seen[0][:, ~ego], image[:, ~ego])
    assert int(arrays["maps"].max()) <= 128
    write_arrays(tmp_path / "a.npz", arrays)
    assert lends_ego(tmp_path / "a.npz")


def test_the_network_sees_the_ego_car_and_is_told_where_it_is() -> None:
    training = build_training({"kind": "pictures", "network": {"height": 32, "width": 48}})
    assert isinstance(training, PictureTraining)
    ego = bonnet(64, 96)
    image = ego.float().expand(3, 64, 96)

    arrays = prepare_picture(image, ego, [load_detector("labeller")], training)

    assert torch.equal(arrays["ego"], arrays["image"][0])
    assert (arrays["ego"][-1] == 255).all()
    assert not arrays["ego"][:24].any()


def test_where_nothing_is_known_of_the_ego_car_that_is_what_is_kept(tmp_path: Path) -> None:
    training = build_training({"kind": "pictures", "network": {"height": 32, "width": 48}})
    assert isinstance(training, PictureTraining)

    arrays = prepare_picture(scene(1, 60, 80).image, None, [load_detector("labeller")], training)

    assert (arrays["ego"] == 128).all()
    write_arrays(tmp_path / "a.npz", arrays)
    assert not lends_ego(tmp_path / "a.npz")


@pytest.mark.parametrize(
    ("rows", "columns", "lends"), [(8, 96, True), (8, 88, False), (1, 96, False)]
)
def test_only_an_ego_car_from_one_side_to_the_other_is_lent(
    rows: int, columns: int, lends: bool, tmp_path: Path
) -> None:
    ego = torch.zeros(64, 96, dtype=torch.uint8)
    ego[64 - rows :, :columns] = 255
    write_arrays(tmp_path / "a.npz", {"ego": ego})

    assert lends_ego(tmp_path / "a.npz") == lends


def test_a_vote_with_the_mirror_image_has_no_side() -> None:
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8)).eval()
    image = torch.rand(3, 32, 40, generator=seeded(6))

    vote = network_maps(network, image)

    torch.testing.assert_close(vote, network_maps(network, image.flip(-1)).flip(-1))
    assert vote.shape == (OUTPUTS, 32, 40)
    torch.testing.assert_close(vote[:CLASSES].sum(0), torch.ones(32, 40))
