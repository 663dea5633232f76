"""Finding and reading labelled sets, and what is said about broken ones."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from roadtorch.errors import ConfigError, DatasetError
from roadtorch.evaluation.datasets import open_dataset
from tests.scenes import render_scene, write_camvid


def write_png(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


@pytest.fixture
def camvid(tmp_path) -> Path:
    scenes = {
        f"{drive}_{i}": render_scene(i, 24, 32) for i, drive in enumerate(("0001TP", "0006R0"))
    }
    write_camvid(tmp_path, "train", scenes)
    write_camvid(tmp_path, "val", {"0016E5_7": render_scene(7, 24, 32)})
    return tmp_path


def folder_set(root: Path, mask: np.ndarray) -> Path:
    write_png(root / "images/a.png", np.zeros((*mask.shape[:2], 3), np.uint8))
    write_png(root / "masks/a.png", mask)
    return root


# --- camvid ----------------------------------------------------------------------------------


def test_camvid_dev_is_train_and_val_by_drive(camvid):
    found = open_dataset("camvid", camvid)

    assert found.split == "dev"
    assert [item.name for item in found.items] == ["0001TP_0", "0006R0_1", "0016E5_7"]
    assert found.groups() == ["0001TP", "0006R0", "0016E5"]
    assert len(open_dataset("camvid", camvid, "val").items) == 1


def test_camvid_truth_is_the_scenes_truth(camvid):
    found, scene = open_dataset("camvid", camvid), render_scene(0, 24, 32)

    image, truth = found.read(found.items[0])

    assert torch.allclose(image, scene.image, atol=1e-6)
    assert torch.equal(truth.road, scene.road)
    assert torch.equal(truth.valid, ~scene.void)
    assert truth.layout is not None
    assert torch.equal(truth.layout, torch.where(scene.void, 255, scene.layout))


def test_all_twelve_camvid_classes(tmp_path):
    write_png(tmp_path / "train/0001TP_1.png", np.zeros((1, 12, 3), np.uint8))
    write_png(tmp_path / "trainannot/0001TP_1.png", np.arange(12, dtype=np.uint8)[None])

    found = open_dataset("camvid", tmp_path, "train")
    truth = found.truth(found.items[0])

    assert truth.road[0].nonzero().flatten().tolist() == [3]
    assert (~truth.valid[0]).nonzero().flatten().tolist() == [11]
    assert truth.layout is not None
    assert truth.layout[0].tolist() == [0, 1, 1, 2, 2, 1, 1, 1, 1, 1, 1, 255]


# --- idd-lite and folder -----------------------------------------------------------------------


def test_idd_lite_classes(tmp_path):
    labels = np.array([[0, 1, 2, 3, 4, 5, 6, 255]], np.uint8)
    write_png(tmp_path / "images/a.png", np.zeros((1, 8, 3), np.uint8))
    write_png(tmp_path / "labels/a.png", labels)

    found = open_dataset("idd-lite", tmp_path)
    truth = found.truth(found.items[0])

    assert found.groups() == []
    assert truth.road[0].tolist() == [True] + [False] * 7
    assert truth.valid[0].tolist() == [True] * 7 + [False]
    assert truth.layout is not None
    assert truth.layout[0].tolist() == [2, 2, 1, 1, 1, 1, 0, 255]


@pytest.mark.parametrize(("road", "void"), [(255, 127), (255, 128), (1, 128)])
def test_folder_masks_in_either_coding(tmp_path, road, void):
    root = folder_set(tmp_path, np.array([[0, road, void]], np.uint8))

    found = open_dataset("folder", root)
    truth = found.truth(found.items[0])

    assert truth.road[0].tolist() == [False, True, False]
    assert truth.valid[0].tolist() == [True, True, False]
    assert truth.layout is None


def test_folder_masks_saved_as_grey_rgb_or_one_bit(tmp_path):
    grey = np.array([[0, 255], [255, 0]], np.uint8)
    root = folder_set(tmp_path, np.repeat(grey[..., None], 3, 2))
    found = open_dataset("folder", root)

    from_rgb = found.truth(found.items[0]).road
    Image.fromarray(grey).convert("1").save(root / "masks/a.png")
    from_bits = found.truth(found.items[0]).road

    assert from_rgb.tolist() == from_bits.tolist() == [[False, True], [True, False]]


# --- mistakes ------------------------------------------------------------------------------------


def test_unknown_values_are_named_and_counted(tmp_path):
    root = folder_set(tmp_path, np.array([[0, 3, 3, 77, 255]], np.uint8))
    found = open_dataset("folder", root)

    with pytest.raises(DatasetError, match=r"a\.png: .*3 \(2 pixels\), 77 \(1 pixels\)"):
        found.truth(found.items[0])


def test_one_and_255_in_one_mask_are_ambiguous(tmp_path):
    root = folder_set(tmp_path, np.array([[0, 1, 255]], np.uint8))
    found = open_dataset("folder", root)

    with pytest.raises(DatasetError, match="both 1 and 255"):
        found.truth(found.items[0])


def test_colour_labels_are_refused(tmp_path):
    root = folder_set(tmp_path, np.array([[[255, 0, 255]]], np.uint8))
    found = open_dataset("folder", root)

    with pytest.raises(DatasetError, match="colour"):
        found.truth(found.items[0])


def test_a_label_of_another_size(camvid):
    label = camvid / "trainannot/0001TP_0.png"
    write_png(label, np.zeros((12, 16), np.uint8))
    found = open_dataset("camvid", camvid)

    with pytest.raises(DatasetError, match=r"0001TP_0\.png: is 16 by 12 .* 32 by 24"):
        found.read(found.items[0])


def test_a_damaged_label(camvid):
    label = camvid / "trainannot/0001TP_0.png"
    label.write_bytes(label.read_bytes()[:60])
    found = open_dataset("camvid", camvid)

    with pytest.raises(DatasetError, match=r"0001TP_0\.png: cannot be decoded"):
        found.truth(found.items[0])


def test_the_first_missing_label_is_named(camvid):
    (camvid / "trainannot/0006R0_1.png").unlink()

    with pytest.raises(DatasetError, match=r"trainannot/0006R0_1\.png: is missing, 1 of 2"):
        open_dataset("camvid", camvid)


def test_the_first_missing_folder_is_named(camvid):
    (camvid / "valannot").rename(camvid / "elsewhere")

    with pytest.raises(DatasetError, match="valannot: does not exist"):
        open_dataset("camvid", camvid)


def test_an_empty_split(tmp_path):
    for part in ("images", "masks"):
        (tmp_path / part).mkdir()

    with pytest.raises(DatasetError, match="images: holds no pictures"):
        open_dataset("folder", tmp_path)


def test_misspelt_set_and_split_get_the_nearest_names(camvid):
    with pytest.raises(ConfigError, match=r"unknown data set .*camvid"):
        open_dataset("camvit", camvid)
    with pytest.raises(ConfigError, match=r"unknown split of camvid .*train"):
        open_dataset("camvid", camvid, "trian")
    with pytest.raises(DatasetError, match="nowhere: is not a folder"):
        open_dataset("camvid", camvid / "nowhere")
