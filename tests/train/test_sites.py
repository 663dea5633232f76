"""Where patches are taken, and the labels there."""

import torch

from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL
from roadtorch.train.config import PatchTraining, Sites, build_training
from roadtorch.train.patches import find_sites, prepare_patches
from tests.streets import scene


def training_of(**values: object) -> PatchTraining:
    found = build_training({"mix": 2, "passes": 2, **values})
    assert isinstance(found, PatchTraining)
    return found


def test_sites_are_centroids_and_places_around_them() -> None:
    segments = torch.zeros(9, 20, dtype=torch.int64)
    segments[:, 11:] = 1  # centroids (4, 5) and (4, 15)

    sites = find_sites(segments, Sites(around=4, distance=2))

    wanted = [[4, 5], [6, 5], [4, 7], [2, 5], [4, 3], [4, 15], [6, 15], [4, 17], [2, 15], [4, 13]]
    assert sites.tolist() == wanted


def test_sites_stay_inside_the_picture() -> None:
    sites = find_sites(torch.zeros(4, 6, dtype=torch.int64), Sites(around=8, distance=50))

    assert sites.amin(0).tolist() == [0, 0]
    assert sites.amax(0).tolist() == [3, 5]


def test_a_street_gives_sites_with_the_labels_of_what_is_there() -> None:
    street = scene(4)

    arrays = prepare_patches(street.image, training_of())

    rows, columns = arrays["sites"].long().T
    truth = street.layout[rows, columns]
    assert arrays["image"].shape == (3, 240, 320)
    assert arrays["image"].dtype == torch.uint8
    assert len(rows) > 600
    assert set(arrays["classes"].tolist()) == {SKY, VERTICAL, HORIZONTAL}
    assert (truth == arrays["classes"]).float().mean() > 0.85


def test_certain_labels_are_fewer_than_those_of_largest_support() -> None:
    image = scene(4, 60, 80).image

    def count(support: str) -> int:
        return len(prepare_patches(image, training_of(labeller={"support": support}))["classes"])

    assert 0 < count("margin") < count("maximum")
