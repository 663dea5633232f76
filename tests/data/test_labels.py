"""Label pictures and maps made elsewhere: finding them, reading them, and what they mean."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from roadtorch.data.dataset import LabelledItem
from roadtorch.data.labels import ColourLabels, NumberLabels, pairs
from roadtorch.data.maps import map_likelihood, parse_maps

NUMBERS = NumberLabels(road=(1, 5), void=(9,), values=(0, 1, 5, 7, 9), layout=(1, 2, 2, 0, 255))
COLOURS = ColourLabels(
    colours=((0, 0, 0), (255, 0, 255), (1, 2, 3)),
    numbers=NumberLabels(road=(1,), void=(2,), values=(0, 1, 2)),
)
GREY = np.array([[0, 255], [255, 0]], np.uint8)
MASKS = NumberLabels(road=(1, 255), void=(), values=(0, 1, 255))


def saved(path: Path, picture: np.ndarray | Image.Image) -> LabelledItem:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    image.save(path)
    return LabelledItem(path.stem, path, path)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_what_the_numbers_mean(tmp_path, kind):
    truth = NUMBERS.truth(saved(tmp_path / "a.png", np.array([[0, 1, 5, 7, 9]], kind)))

    assert truth.road[0].tolist() == [False, True, True, False, False]
    assert truth.valid[0].tolist() == [True, True, True, True, False]
    assert truth.layout is not None
    assert truth.layout[0].tolist() == [1, 2, 2, 0, 255]


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "1"])
def test_grey_in_other_clothes(tmp_path, mode):
    truth = MASKS.truth(saved(tmp_path / "a.png", Image.fromarray(GREY).convert(mode)))

    assert truth.road.tolist() == [[False, True], [True, False]]
    assert truth.layout is None


def test_palette_files_keep_their_numbers(tmp_path):
    picture = Image.fromarray(np.array([[0, 1, 9]], np.uint8), mode="L").convert("P")
    picture.putpalette([200, 30, 10] * 256)

    assert NUMBERS.truth(saved(tmp_path / "a.png", picture)).road[0].tolist() == [0, 1, 0]


def test_what_the_colours_mean(tmp_path):
    pixels = np.array([[[255, 0, 255], [1, 2, 3], [0, 0, 0]]], np.uint8)
    for picture in (Image.fromarray(pixels), Image.fromarray(pixels).quantize(3)):
        truth = COLOURS.truth(saved(tmp_path / "a.png", picture))

        assert truth.road[0].tolist() == [True, False, False]
        assert truth.valid[0].tolist() == [True, False, True]


def test_places_of_random_colours(tmp_path):
    generator = np.random.default_rng(1)
    known = np.unique(generator.integers(0, 256, (40, 3)), axis=0)
    generator.shuffle(known)
    places = generator.integers(0, len(known), (9, 7))
    colours = tuple((int(r), int(g), int(b)) for r, g, b in known)

    found = ColourLabels(colours, NUMBERS).places(known[places].astype(np.uint8), tmp_path)

    assert (found == places).all()


def test_pairs_in_the_order_of_their_names(tmp_path):
    for name in ("images/b.jpg", "images/a.png", "labels/a_L.png", "labels/b_L.png"):
        saved(tmp_path / name, GREY)
    for name in ("images/._a.png", "images/notes.txt"):
        (tmp_path / name).write_bytes(b"")

    found = [(a.name, b.name) for a, b in pairs(tmp_path / "images", tmp_path / "labels", "_L.png")]

    assert found == [("a.png", "a_L.png"), ("b.jpg", "b_L.png")]


# --- maps ----------------------------------------------------------------------------------------

RAMP = np.linspace(0, 1, 24).reshape(4, 6)


def test_8_and_16_bit_pictures_and_numpy_files_are_read_alike(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.round(RAMP * 255).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "b.likelihood.png"), np.round(RAMP * 65535).astype(np.uint16))
    np.save(tmp_path / "c.npy", RAMP)
    np.save(tmp_path / "a.npy", RAMP)  # the same as beside it

    for name, step in (("a", 1 / 255), ("b", 1 / 65535), ("c", 1e-7)):
        likelihood = map_likelihood(tmp_path, ["none", name], [(4, 6)])
        assert likelihood.dtype == torch.float32
        assert np.abs(likelihood.numpy() - RAMP).max() <= step / 2 + 1e-7


def test_a_folder_may_have_a_name_of_its_own(tmp_path):
    for name in ("theirs", "other/theirs"):
        (tmp_path / name).mkdir(parents=True)
    first, second = str(tmp_path / "theirs"), str(tmp_path / "other/theirs")

    assert parse_maps([first, f"net={second}"]) == {"theirs": Path(first), "net": Path(second)}
