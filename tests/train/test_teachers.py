"""Targets of whole-image networks: their values, and where they have weight."""

from pathlib import Path

import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.base.signals import StopRequest
from roadtorch.detectors.catalogue import load_detector
from roadtorch.layout.backbone_network import NUM_OUTPUTS, BackboneNetwork
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.run.memo import read_arrays, write_arrays
from roadtorch.train.config import ImageTraining, Teacher, build_training
from roadtorch.train.targets import make_targets
from roadtorch.train.teachers import (
    label_with_network,
    network_maps,
    prepare_image,
    teacher_maps,
)
from roadtorch.train.whole_images import shows_ego_car
from tests.draws import seeded_generator
from tests.networks import SMALL_BACKBONE
from tests.streets import scene

AGREEMENT = Teacher(margin=0.5)


def maps_of(*pixels: tuple[float, ...]) -> torch.Tensor:
    """Return maps (1, C, 1, n) of n pixels: sky, vertical, horizontal, road, for networks ego."""
    return torch.tensor(pixels).T[None, :, None]


# --- where it counts -----------------------------------------------------------------------


SURE = maps_of((0.9, 0.1, 0.0, 0.9), (0.9, 0.1, 0.0, 0.9), (0.1, 0.1, 0.8, 0.1))
UNSURE = maps_of((0.9, 0.1, 0.0, 0.9), (0.5, 0.4, 0.1, 0.52), (0.2, 0.0, 0.8, 0.1))
NETWORK = maps_of((0.8, 0.2, 0.0, 0.8, 0.0), (0.0, 1.0, 0.0, 0.1, 0.0), (0.0, 0.0, 1.0, 0.9, 0.0))
ALONE = AGREEMENT.model_copy(update={"combine": "teacher"})


@pytest.mark.parametrize(
    ("teacher", "network", "settings", "expected", "counted"),
    [
        (UNSURE, None, AGREEMENT, UNSURE, ([1, 0, 1], [1, 1, 1])),  # only certain pixels count
        (SURE, NETWORK, AGREEMENT, (SURE + NETWORK[:, :4]) / 2, ([1, 0, 1], [1, 0, 0])),
        (SURE, NETWORK, ALONE, SURE, ([1, 1, 1], [1, 1, 1])),
    ],
)
def test_targets_count_where_teachers_are_certain_and_agree(
    teacher: torch.Tensor, network: torch.Tensor | None, settings: Teacher,
    expected: torch.Tensor, counted: tuple[list[float], list[float]],
) -> None:  # fmt: skip
    targets = make_targets(teacher, network, settings)

    torch.testing.assert_close(targets.layout, expected[:, :NUM_CLASSES])
    torch.testing.assert_close(targets.road, expected[:, NUM_CLASSES:])
    layout, road = targets.layout_weight.flatten(), targets.road_weight.flatten()
    assert (layout.tolist(), road.tolist()) == counted


# --- the ego car ---------------------------------------------------------------------------

GROUND = (0.0, 0.1, 0.9, 0.9)
"""Maps of the teacher on ground, which it also takes an ego car for."""


@pytest.mark.parametrize(
    ("network", "ego", "road", "layout_weight"),
    [
        (None, 0, 0.9, 1),  # where nothing is known of it there is none
        ((0.9, 0.95), 1, 0.0, 0),
        ((0.1, 0.95), 1, 0.0, 0),  # the teacher cannot agree with a network that knows better
        ((0.9, 0.05), 0, 0.9, 1),
        ((0.9, 0.7), 0, 0.9, 1),  # what it half believes is none
    ],
)
def test_the_ego_car_is_where_the_network_is_certain_of_it(
    network: tuple[float, float] | None, ego: float, road: float, layout_weight: float
) -> None:
    maps = None if network is None else maps_of((*GROUND[:3], *network))

    targets = make_targets(maps_of(GROUND), maps, AGREEMENT)

    assert (targets.ego.item(), targets.ego_weight.item()) == (ego, 1)
    assert targets.road.item() == pytest.approx(road)
    assert (targets.layout_weight.item(), targets.road_weight.item()) == (layout_weight, 1)


# --- teachers -----------------------------------------------------------------------------


def test_the_teacher_gives_layout_and_road() -> None:
    image, teacher = scene(1, 60, 80).image, load_detector("labeller")

    maps = teacher_maps(image, teacher)

    torch.testing.assert_close(maps[:NUM_CLASSES], teacher.detect(image).cues["layout"])
    torch.testing.assert_close(maps[NUM_CLASSES], teacher.detect(image).likelihood)
    with pytest.raises(ConfigError, match="prior:rows has no layout among its cues"):
        teacher_maps(image, load_detector("prior:rows"))


def test_a_vote_with_the_mirror_image_has_no_side() -> None:
    network = BackboneNetwork(SMALL_BACKBONE).eval()
    image = torch.rand(3, 32, 64, generator=seeded_generator(6))

    vote = network_maps(network, image)

    torch.testing.assert_close(vote, network_maps(network, image.flip(-1)).flip(-1))
    assert vote.shape == (NUM_OUTPUTS, 32, 64)
    torch.testing.assert_close(vote[:NUM_CLASSES].sum(0), torch.ones(32, 64))


# --- prepared images --------------------------------------------------------------------


def small_training(**teacher: object) -> ImageTraining:
    network = {"height": 32, "width": 64}
    values = {"kind": "images", "network": network, "teacher": teacher}
    training = build_training(values)
    assert isinstance(training, ImageTraining)
    return training


def test_a_prepared_image_has_the_networks_size() -> None:
    image, teacher = scene(1, 60, 80).image, load_detector("labeller")

    arrays = prepare_image(image, teacher, small_training())

    sizes = {"image": (3, 32, 64), "maps": (4, 32, 64)}
    assert {name: tuple(value.shape) for name, value in arrays.items()} == sizes
    assert {value.dtype for value in arrays.values()} == {torch.uint8}


@pytest.mark.parametrize(
    ("rows", "columns", "lends"), [(8, 96, True), (8, 88, False), (1, 96, False)]
)
def test_ego_cars_of_full_width_are_lent(
    rows: int, columns: int, lends: bool, tmp_path: Path
) -> None:
    ego = torch.zeros(64, 96, dtype=torch.uint8)
    ego[64 - rows :, :columns] = 255
    write_arrays(tmp_path / "a.npz", {"ego": ego})

    assert shows_ego_car(tmp_path / "a.npz") == lends


def test_a_network_labels_again_what_has_changed(tmp_path: Path) -> None:
    network = BackboneNetwork(SMALL_BACKBONE).eval()
    files = [tmp_path / f"{n}.npz" for n in range(2)]
    for file in files:
        write_arrays(file, {"image": torch.zeros(3, 32, 64, dtype=torch.uint8)})

    def labelled() -> list[torch.Tensor]:
        labels = label_with_network(files, tmp_path / "labels", network, StopRequest(), quiet=True)
        return [read_arrays(name, "maps")["maps"] for name in labels.values()]

    first, again = labelled()
    times = [file.stat().st_mtime_ns for file in (tmp_path / "labels").iterdir()]
    assert torch.equal(first, again)
    labelled()
    assert [file.stat().st_mtime_ns for file in (tmp_path / "labels").iterdir()] == times
    write_arrays(files[0], {"image": torch.full((3, 32, 64), 255, dtype=torch.uint8)})
    changed, unchanged = labelled()
    assert not torch.equal(changed, first)
    assert torch.equal(unchanged, again)
    with torch.no_grad():
        next(network.parameters()).add_(1)
    assert not torch.equal(labelled()[1], again)
