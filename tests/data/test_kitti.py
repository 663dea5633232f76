"""KITTI's files and names, its truth, and the whole way to a score in bird's-eye view."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item
from roadtorch.data.kitti import BirdsEye, birds_eye, open_kitti_road, result_name
from roadtorch.errors import ConfigError, DatasetError
from roadtorch.evaluation.metrics import average_precision, count_levels, max_f
from tests.data.conftest import write_png
from tests.reference import bev as reference

MAGENTA, RED, BLACK, BLUE = (255, 0, 255), (255, 0, 0), (0, 0, 0), (0, 0, 255)
HEIGHT, WIDTH = 120, 160


def street() -> np.ndarray:
    """Truth in KITTI's colours: road widening from the horizon, void at the left rim."""
    row, column = np.indices((HEIGHT, WIDTH))
    truth = np.full((HEIGHT, WIDTH, 3), RED, np.uint8)
    truth[np.abs(column - 80) < row - 52] = MAGENTA
    truth[:, :5] = BLACK
    truth[90:, 3:5] = BLUE
    return truth


def add_frame(folder: Path, name: str, truth: np.ndarray, kind: str = "road") -> None:
    grey = np.full((*truth.shape[:2], 3), 99, np.uint8)
    write_png(folder / "image_2" / f"{name}.png", grey)
    write_png(folder / "gt_image_2" / f"{result_name(name, kind)}.png", truth)
    text = reference.calibration_text(reference.made_up_rows())
    (folder / "calib").mkdir(exist_ok=True)
    (folder / "calib" / f"{name}.txt").write_text(text)


@pytest.fixture
def kitti(tmp_path) -> Path:
    for name in ("um_000001", "umm_000000", "uu_000000", "um_000000"):
        add_frame(tmp_path, name, street())
    add_frame(tmp_path, "um_000000", street(), "lane")
    add_frame(tmp_path, "um_000001", street()[::-1].copy(), "lane")
    return tmp_path


# --- files -------------------------------------------------------------------------------


def test_pictures_are_grouped_by_category(kitti):
    found = open_kitti_road(kitti, "road")

    names = [item.name for item in found.items]
    assert names == ["um_000000", "um_000001", "umm_000000", "uu_000000"]
    assert found.groups() == ["um", "umm", "uu"]
    assert found.items[2].label == kitti / "gt_image_2/umm_road_000000.png"
    assert found.levels == 256
    assert found.view is None
    assert open_dataset("kitti-road", kitti) == found


def test_the_archives_own_folder_is_found(kitti, tmp_path_factory):
    root = tmp_path_factory.mktemp("archive")
    (root / "training").symlink_to(kitti)

    assert len(open_kitti_road(root, "road").items) == 4
    assert birds_eye(open_kitti_road(root, "road")).view == BirdsEye(root / "training/calib")


def test_lanes_are_those_of_um(kitti):
    found = open_kitti_road(kitti, "lane")

    assert [item.label.name for item in found.items] == [
        "um_lane_000000.png",
        "um_lane_000001.png",
    ]
    assert found.truth(found.items[1]).road[0].any()


def test_missing_and_misnamed_files_are_named(kitti):
    (kitti / "gt_image_2/uu_road_000000.png").unlink()
    with pytest.raises(DatasetError, match=r"uu_road_000000\.png: is missing"):
        open_kitti_road(kitti, "road")

    write_png(kitti / "image_2/thumb.png", np.zeros((9, 9, 3), np.uint8))
    with pytest.raises(DatasetError, match="thumb: is not the name of a KITTI road picture"):
        open_kitti_road(kitti, "road")

    with pytest.raises(DatasetError, match=r"calib/image_2: does not exist"):
        open_kitti_road(kitti / "calib", "road")


# --- bird's-eye view ---------------------------------------------------------------------


def scores(dataset: Dataset, item: Item, likelihood: torch.Tensor) -> tuple[float, float]:
    """MaxF and AP of a likelihood, scored where the set is scored."""
    truth, view = dataset.truth(item), dataset.view
    assert view is not None
    road, valid = view(item, truth.road), view(item, truth.valid)
    counts = count_levels(view(item, likelihood), road, valid, dataset.levels)
    return float(max_f(counts)[0]), float(average_precision(counts))


def test_the_view_shows_each_cell_its_pixel(kitti):
    found = birds_eye(open_kitti_road(kitti, "road"))
    item = found.items[0]
    road = found.truth(item).road

    assert found.view is not None
    cells = found.view(item, road)

    rows = reference.made_up_rows()
    places = [(r, c) for r in range(0, 800, 37) for c in range(0, 400, 23)]
    expected = [reference.cell_value(road.numpy(), rows, r, c) for r, c in places]
    assert cells.dtype == torch.bool
    assert [bool(cells[place]) for place in places] == expected
    assert 0 < sum(expected) < len(expected)
    assert pickle.loads(pickle.dumps(found.view)) == found.view  # it travels to other processes


def test_cells_without_a_pixel_are_void(kitti):
    found = birds_eye(open_kitti_road(kitti, "road"))
    item = found.items[0]
    assert found.view is not None

    unseen = ~found.view(item, torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    valid = found.view(item, found.truth(item).valid)

    assert unseen.any()
    assert not (valid & unseen).any()
    road = found.truth(item).road.float()
    assert scores(found, item, road) == pytest.approx((1, 1), abs=1e-9)
    assert scores(found, item, 1 - road)[0] < 0.9


def test_a_missing_calibration_costs_its_picture_only(kitti):
    found = birds_eye(open_kitti_road(kitti, "road"))
    (kitti / "calib/um_000001.txt").unlink()
    values = torch.zeros(HEIGHT, WIDTH)
    assert found.view is not None

    assert found.view(found.items[0], values).shape == (800, 400)
    with pytest.raises(DatasetError, match=r"calib/um_000001\.txt: is missing"):
        found.view(found.items[1], values)


def test_no_view_without_calibrations_or_for_other_sets(kitti, tmp_path_factory):
    bare = tmp_path_factory.mktemp("bare")
    for part in ("image_2", "gt_image_2"):
        (bare / part).symlink_to(kitti / part)
    with pytest.raises(DatasetError, match="calib: does not exist"):
        birds_eye(open_kitti_road(bare, "road"))

    other = Dataset("camvid", kitti, "dev", (), open_kitti_road(kitti, "road").reader)
    with pytest.raises(ConfigError, match="camvid: has no bird's-eye view"):
        birds_eye(other)


# --- KITTI's own frames ------------------------------------------------------------------


def frame_counts(road: torch.Tensor, valid: torch.Tensor) -> list[int]:
    return [int(part.sum()) for part in (road & valid, valid & ~road, ~valid)]


@pytest.mark.data
def test_kittis_frames_have_the_kits_counts_and_scores(data_root):
    vectors = data_root.parent / "reference/kitti_vectors.json"
    if not vectors.is_file():
        pytest.skip("the benchmark's vectors are not beside the repository (../shared/reference)")
    known = json.loads(vectors.read_text())["optional_real_ground_truth_counts"]
    found = birds_eye(open_kitti_road(data_root / "kitti_road", "road"))
    items = {item.name: item for item in found.items}
    assert found.view is not None

    for frame in known:
        item = items[frame["frame"]]
        image, truth = found.read(item)
        assert list(image.shape[1:]) == frame["size"]
        assert frame_counts(truth.road, truth.valid) == list(frame["image"].values())
        cells = found.view(item, truth.road), found.view(item, truth.valid)
        assert frame_counts(*cells) == list(frame["bev"].values())
        assert scores(found, item, truth.road.float()) == pytest.approx((1, 1), abs=1e-9)
        upside_down = scores(found, item, 1 - truth.road.float())
        share = frame["bev"]["valid_road"] / sum(list(frame["bev"].values())[:2])
        assert upside_down[0] == pytest.approx(2 * share / (1 + share), abs=1e-9)
        assert upside_down[1] == pytest.approx(share, abs=1e-9)
