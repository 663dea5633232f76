"""KITTI's files, names and ground truth, and scores in bird's-eye view."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.base.errors import DatasetError
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.data.kitti_road import BirdsEyeView, open_kitti_road, result_name, use_birds_eye_view
from roadtorch.evaluation.metrics import average_precision, count_levels, max_f
from tests.data.conftest import write
from tests.reference import bev as reference

MAGENTA, RED, BLACK, BLUE = (255, 0, 255), (255, 0, 0), (0, 0, 0), (0, 0, 255)
HEIGHT, WIDTH = 120, 160


def street() -> np.ndarray:
    """Draw ground truth in KITTI's colours: road below the horizon, void at the left edge."""
    row, column = np.indices((HEIGHT, WIDTH))
    truth = np.full((HEIGHT, WIDTH, 3), RED, np.uint8)
    truth[np.abs(column - 80) < row - 52] = MAGENTA
    truth[:, :5] = BLACK
    truth[90:, 3:5] = BLUE
    return truth


def add_frame(folder: Path, name: str, truth: np.ndarray) -> None:
    grey = np.full((*truth.shape[:2], 3), 99, np.uint8)
    write(folder / "image_2" / f"{name}.png", grey)
    write(folder / "gt_image_2" / f"{result_name(name)}.png", truth)
    text = reference.calibration_text(reference.made_up_rows())
    (folder / "calib").mkdir(exist_ok=True)
    (folder / "calib" / f"{name}.txt").write_text(text)


@pytest.fixture(scope="module")
def kitti(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("kitti")
    for name in ("um_000001", "um_000000"):
        add_frame(root, name, street())
    return root


# --- bird's-eye view ---------------------------------------------------------------------


def scores(dataset: Dataset, item: LabelledItem, likelihood: torch.Tensor) -> tuple[float, float]:
    """Return MaxF and AP of a likelihood in the space in which the set is scored."""
    truth, view = dataset.truth(item), dataset.scoring_space
    assert view is not None
    road, valid = view(item, truth.road), view(item, truth.valid)
    counts = count_levels(view(item, likelihood), road, valid, dataset.levels)
    return float(max_f(counts)[0]), float(average_precision(counts))


def test_cells_without_a_pixel_are_void(kitti):
    dataset = use_birds_eye_view(open_kitti_road(kitti, "road"))
    item = dataset.items[0]
    assert (dataset.levels, dataset.space_name) == (256, "bird's-eye view")
    assert dataset.scoring_space is not None

    unseen = ~dataset.scoring_space(item, torch.ones(HEIGHT, WIDTH, dtype=torch.bool))
    valid = dataset.scoring_space(item, dataset.truth(item).valid)

    assert unseen.any()
    assert not (valid & unseen).any()
    road = dataset.truth(item).road.float()
    assert scores(dataset, item, road) == pytest.approx((1, 1), abs=1e-9)
    assert scores(dataset, item, 1 - road)[0] < 0.9
    assert (
        pickle.loads(pickle.dumps(dataset.scoring_space)) == dataset.scoring_space
    )  # it travels to other processes


def test_a_missing_calibration_costs_its_image_only(kitti, tmp_path):
    first, second, *_ = open_kitti_road(kitti, "road").items
    view, values = BirdsEyeView(tmp_path), torch.zeros(HEIGHT, WIDTH)
    write(tmp_path / "um_000000.txt", (kitti / "calib/um_000000.txt").read_bytes())

    assert view(first, values).shape == (800, 400)
    with pytest.raises(DatasetError, match=r"um_000001\.txt: cannot be read: No such file"):
        view(second, values)


# --- KITTI's own frames ------------------------------------------------------------------


def frame_counts(road: torch.Tensor, valid: torch.Tensor) -> list[int]:
    return [int(part.sum()) for part in (road & valid, valid & ~road, ~valid)]


@pytest.mark.data
def test_kittis_frames_have_the_kits_counts_and_scores(data_root):
    vectors = data_root.parent / "reference/kitti_vectors.json"
    if not vectors.is_file():
        pytest.skip("the benchmark's vectors are not beside the repository (../shared/reference)")
    frames = json.loads(vectors.read_text())["optional_real_ground_truth_counts"]
    dataset = use_birds_eye_view(open_kitti_road(data_root / "kitti_road", "road"))
    items = {item.name: item for item in dataset.items}
    assert dataset.scoring_space is not None

    for frame in frames:
        item = items[frame["frame"]]
        image, truth = dataset.read(item)
        assert list(image.shape[1:]) == frame["size"]
        assert frame_counts(truth.road, truth.valid) == list(frame["image"].values())
        cells = dataset.scoring_space(item, truth.road), dataset.scoring_space(item, truth.valid)
        assert frame_counts(*cells) == list(frame["bev"].values())
        assert scores(dataset, item, truth.road.float()) == pytest.approx((1, 1), abs=1e-9)
        inverted = scores(dataset, item, 1 - truth.road.float())
        fraction = frame["bev"]["valid_road"] / sum(list(frame["bev"].values())[:2])
        assert inverted[0] == pytest.approx(2 * fraction / (1 + fraction), abs=1e-9)
        assert inverted[1] == pytest.approx(fraction, abs=1e-9)
