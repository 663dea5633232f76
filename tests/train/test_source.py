"""Source images: what folders hold, truth as targets, held-out worlds."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from roadtorch.base.errors import InputError
from roadtorch.base.image import read_image
from roadtorch.train.prepared import from_uint8
from roadtorch.train.source import (
    EGO_CODE,
    NOT_ROAD_CODE,
    ROAD_CODE,
    VOID_CODE,
    find_source_images,
    prepare_source,
    reduce_truth,
    truth_targets,
)
from roadtorch.train.targets import Targets
from tests.train.runs import write_worlds

SIZE = (36, 48)


def write_simulated(folder: Path, road: np.ndarray, layout: np.ndarray | None = None) -> Path:
    """Write one grey image of a simulator with its road, and its layout."""
    parts = {"images": np.full((*road.shape, 3), 90, np.uint8), "road": road, "layout": layout}
    for name, pixels in parts.items():
        if pixels is not None:
            (folder / name).mkdir(parents=True)
            suffix = "jpg" if name == "images" else "png"
            cv2.imwrite(str(folder / name / f"0123_a.{suffix}"), pixels)
    return folder


def targets_of(folder: Path) -> Targets:
    """Return the targets of the only image of a folder."""
    (source,) = find_source_images([folder])
    arrays = prepare_source(read_image(source.item.path), source, SIZE)
    return truth_targets(arrays["codes"][None, None], from_uint8(arrays["ego"])[None, None])


# --- folders ----------------------------------------------------------------------------


def test_worlds_have_the_kinds_of_their_names_and_some_numbers_never_train(tmp_path: Path) -> None:
    names = ["30001_town_sun", "38999_fisheye_night", "39000_town_sun", "49999_people_sun"]
    first = write_worlds(tmp_path / "first", names)
    second = write_simulated(tmp_path / "many" / "carla", np.ones(SIZE, np.uint8))

    images = find_source_images([first, second.parent])

    assert [image.kind for image in images] == ["town", "fisheye", "carla"]
    assert [image.item.name for image in images][1:] == ["0/38999_fisheye_night", "1/0123_a"]


def test_a_folder_without_source_images_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no source images \(give folders with images/"):
        find_source_images([tmp_path])


def test_an_image_without_truth_is_told(tmp_path: Path) -> None:
    folder = write_simulated(tmp_path, np.ones(SIZE, np.uint8))
    (folder / "road" / "0123_a.png").unlink()

    with pytest.raises(InputError, match=r"0123_a\.png: is no truth of a source image"):
        targets_of(folder)
    cv2.imwrite(str(folder / "road" / "0123_a.png"), np.full(SIZE, 3, np.uint8))
    with pytest.raises(InputError, match=r"0123_a\.png: has the value 3 \(give 0 to 1"):
        targets_of(folder)


# --- truth ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "layout", "road", "weights"),
    [
        (0, 0, 0, (1, 1, 1)),
        (1, 1, 0, (1, 1, 1)),
        (2, 2, 0, (1, 1, 1)),
        (ROAD_CODE, 2, 1, (1, 1, 1)),
        (EGO_CODE, None, 0, (0, 1, 1)),
        (NOT_ROAD_CODE, None, 0, (0, 1, 1)),
        (VOID_CODE, None, 0, (0, 0, 0)),
    ],
)
def test_a_code_becomes_targets_and_what_it_does_not_know_has_no_weight(
    code: int, layout: int | None, road: int, weights: tuple[int, int, int]
) -> None:
    codes = torch.full((1, 1, 2, 2), code, dtype=torch.uint8)
    ego = torch.full((1, 1, 2, 2), {EGO_CODE: 1.0, VOID_CODE: 0.5}.get(code, 0.0))

    targets = truth_targets(codes, ego)

    expected = [float(number == layout) for number in range(3)]
    assert targets.layout[0, :, 0, 0].tolist() == expected
    assert targets.road.eq(road).all()
    assert targets.ego.eq(code == EGO_CODE).all()
    given = (targets.layout_weight, targets.road_weight, targets.ego_weight)
    assert tuple(int(weight.mean()) for weight in given) == weights


def test_a_simulator_knows_road_and_perhaps_layout_but_no_ego_car(tmp_path: Path) -> None:
    road = np.zeros(SIZE, np.uint8)
    road[18:], road[:, :4] = 1, VOID_CODE
    layout = np.full(SIZE, 1, np.uint8)
    layout[:9], layout[9:12] = 0, VOID_CODE

    alone = targets_of(write_simulated(tmp_path / "alone", road))
    both = targets_of(write_simulated(tmp_path / "both", road, layout))

    for targets in (alone, both):
        assert torch.equal(targets.road[0, 0, :, 4:], torch.from_numpy(road[:, 4:]).float())
        assert not targets.road_weight[0, 0, :, :4].any()
        assert targets.road_weight[0, 0, :, 4:].all()
        assert not targets.ego_weight.any()
    assert not alone.layout_weight[0, 0, :18].any()  # unknown where it is not road
    rows = both.layout_weight[0, 0, :, 10].tolist()
    assert rows == [1.0] * 9 + [0.0] * 3 + [1.0] * 24
    assert both.layout[0, :, [0, 15, 20], 10].tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def test_a_thin_vertical_thing_stays_in_a_smaller_truth() -> None:
    codes = torch.full((72, 96), ROAD_CODE, dtype=torch.uint8)
    codes[:, 40] = 1  # half of a pixel
    codes[:, 10:12] = VOID_CODE

    small = reduce_truth(codes, SIZE)

    assert (small[:, 20] == 1).all()
    assert (small[:, 5] == VOID_CODE).all()
    assert (small == ROAD_CODE).float().mean() > 0.9
