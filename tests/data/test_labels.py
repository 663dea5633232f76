"""Label pictures: finding them, reading them, and what is said about broken ones."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.data.dataset import Item
from roadtorch.data.labels import ColourLabels, NumberLabels, colour_indices, pairs
from roadtorch.errors import ConfigError, DatasetError

NUMBERS = NumberLabels(road=(1, 5), void=(9,), values=(0, 1, 5, 7, 9), layout=(1, 2, 2, 0, 255))
COLOURS = ColourLabels(
    colours=((0, 0, 0), (255, 0, 255), (1, 2, 3)),
    numbers=NumberLabels(road=(1,), void=(2,), values=(0, 1, 2)),
)
GREY = np.array([[0, 255], [255, 0]], np.uint8)
MASKS = NumberLabels(road=(1, 255), void=(), values=(0, 1, 255))


def saved(path: Path, picture: np.ndarray | Image.Image) -> Item:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = picture if isinstance(picture, Image.Image) else Image.fromarray(picture)
    image.save(path)
    return Item(path.stem, path, path)


# --- numbers -------------------------------------------------------------------------------------


def test_what_the_numbers_mean(tmp_path):
    truth = NUMBERS.truth(saved(tmp_path / "a.png", np.array([[0, 1, 5, 7, 9]], np.uint8)))

    assert truth.road[0].tolist() == [False, True, True, False, False]
    assert truth.valid[0].tolist() == [True, True, True, True, False]
    assert truth.layout is not None
    assert truth.layout[0].tolist() == [1, 2, 2, 0, 255]


def test_sixteen_bits(tmp_path):
    deep = np.array([[0, 1, 5, 9]], np.uint16)

    assert NUMBERS.truth(saved(tmp_path / "a.png", deep)).road[0].tolist() == [0, 1, 1, 0]
    with pytest.raises(DatasetError, match=r"unknown values 257 \(1 pixels\)"):
        NUMBERS.truth(saved(tmp_path / "a.png", deep + np.uint16(256) * (deep == 1)))


@pytest.mark.parametrize(
    "picture",
    [
        Image.fromarray(GREY).convert("RGB"),
        Image.fromarray(GREY).convert("RGBA"),
        Image.fromarray(GREY).convert("LA"),
        Image.fromarray(GREY).convert("1"),
    ],
    ids=["RGB", "RGBA", "LA", "one bit"],
)
def test_grey_in_other_clothes(tmp_path, picture):
    truth = MASKS.truth(saved(tmp_path / "a.png", picture))

    assert truth.road.tolist() == [[False, True], [True, False]]
    assert truth.layout is None


def test_palette_files_keep_their_numbers(tmp_path):
    picture = Image.fromarray(np.array([[0, 1, 9]], np.uint8), mode="L").convert("P")
    picture.putpalette([200, 30, 10] * 256)

    assert NUMBERS.truth(saved(tmp_path / "a.png", picture)).road[0].tolist() == [0, 1, 0]


@pytest.mark.parametrize("pixel", [(255, 0, 255), (255, 255, 255, 0)], ids=["RGB", "see-through"])
def test_colour_is_refused(tmp_path, pixel):
    with pytest.raises(DatasetError, match=r"a\.png: is a colour picture"):
        MASKS.truth(saved(tmp_path / "a.png", np.array([[pixel]], np.uint8)))


def test_unknown_numbers_are_named_and_counted_the_most_frequent_first(tmp_path):
    item = saved(tmp_path / "a.png", np.array([[0, 3, 77, 77, 255]], np.uint8))

    with pytest.raises(
        DatasetError, match=r"a\.png: has unknown values 77 \(2 pixels\), 3 \(1 pixels\), 255 "
    ):
        NUMBERS.truth(item)
    many = saved(tmp_path / "b.png", np.arange(20, 30, dtype=np.uint8)[None])
    with pytest.raises(DatasetError, match=r"24 \(1 pixels\) and 5 others \(known: 0, 1, 5, 7, 9"):
        NUMBERS.truth(many)


def test_damaged_and_missing_files(tmp_path):
    item = saved(tmp_path / "a.png", np.arange(1600, dtype=np.uint8).reshape(40, 40))
    item.label.write_bytes(item.label.read_bytes()[:60])

    with pytest.raises(DatasetError, match=r"a\.png: cannot be decoded"):
        NUMBERS.truth(item)
    item.label.unlink()
    for reader in (NUMBERS, COLOURS):
        with pytest.raises(DatasetError, match=r"a\.png: is missing"):
            reader.truth(item)


@pytest.mark.parametrize(
    "wrong",
    [
        {"road": (2,)},
        {"void": (2,)},
        {"values": (0, 1, 300)},
        {"void": (1,)},
        {"layout": (0, 1, 2)},
    ],
)
def test_numbers_that_do_not_fit_each_other(wrong):
    with pytest.raises(ConfigError, match="NumberLabels"):
        NumberLabels(**({"road": (1,), "void": (), "values": (0, 1)} | wrong))


# --- colours -------------------------------------------------------------------------------------


def test_what_the_colours_mean(tmp_path):
    pixels = np.array([[[255, 0, 255], [1, 2, 3], [0, 0, 0]]], np.uint8)
    for picture in (Image.fromarray(pixels), Image.fromarray(pixels).quantize(3)):
        truth = COLOURS.truth(saved(tmp_path / "a.png", picture))

        assert truth.road[0].tolist() == [True, False, False]
        assert truth.valid[0].tolist() == [True, False, True]


def test_unknown_colours_are_named_and_counted(tmp_path):
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[0, :2], pixels[1] = (255, 0, 254), (3, 2, 1)

    with pytest.raises(
        DatasetError, match=r"unknown colours 3 2 1 \(4 pixels\), 255 0 254 \(2 pixels\)"
    ):
        COLOURS.truth(saved(tmp_path / "a.png", pixels))


def test_places_of_random_colours(tmp_path):
    generator = np.random.default_rng(1)
    known = np.unique(generator.integers(0, 256, (40, 3)), axis=0)
    generator.shuffle(known)
    places = generator.integers(0, len(known), (9, 7))

    colours = tuple((int(r), int(g), int(b)) for r, g, b in known)
    found = colour_indices(known[places].astype(np.uint8), colours, tmp_path)

    assert (found == places).all()


# --- finding -------------------------------------------------------------------------------------


@pytest.fixture
def two(tmp_path) -> Path:
    for name in ("images/b.jpg", "images/a.png", "labels/a_L.png", "labels/b_L.png"):
        saved(tmp_path / name, GREY)
    for name in ("images/._a.png", "images/notes.txt"):
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def test_pairs_in_the_order_of_their_names(two):
    found = [(a.name, b.name) for a, b in pairs(two / "images", two / "labels", "_L.png")]

    assert found == [("a.png", "a_L.png"), ("b.jpg", "b_L.png")]


def test_the_first_missing_label_is_named(two):
    for label in (two / "labels").iterdir():
        label.unlink()

    with pytest.raises(DatasetError, match=r"labels/a_L\.png: is missing, 2 of 2"):
        list(pairs(two / "images", two / "labels", "_L.png"))


def test_missing_folders_and_pictures(two):
    with pytest.raises(DatasetError, match="nowhere: does not exist"):
        list(pairs(two / "images", two / "nowhere"))
    (two / "empty").mkdir()
    with pytest.raises(DatasetError, match="empty: holds no pictures"):
        list(pairs(two / "empty", two / "labels"))


def test_two_pictures_with_one_label(two):
    saved(two / "images/a.bmp", GREY)

    with pytest.raises(DatasetError, match=r"a\.png: has the name of a\.bmp"):
        list(pairs(two / "images", two / "labels", "_L.png"))
