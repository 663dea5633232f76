"""Label images, foreign likelihood maps, and filled polygons."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from roadtorch.data.correction_formats import fill_area
from roadtorch.data.dataset import LabelledItem
from roadtorch.data.label_images import ColourLabels, NumberLabels, pair_files
from roadtorch.data.likelihood_maps import find_maps, open_maps
from roadtorch.data.polygons import fill_polygon
from roadtorch.detectors.entry import DetectorSettings
from tests.data.conftest import write
from tests.reference.polygons import contains, edges, is_on, is_on_drawn_border

NUMBERS = NumberLabels(road=(1, 5), void=(9,), values=(0, 1, 5, 7, 9), layout=(1, 2, 2, 0, 255))
PIXELS = ((0, 0, 0), (255, 0, 255), (1, 2, 3), (0, 0, 9), (4, 4, 4))
COLOURS = ColourLabels(PIXELS, NUMBERS)
ROW = np.array([NUMBERS.values], np.uint8)
GREY = np.zeros((1, 1), np.uint8)


def saved(path: Path, image: np.ndarray | Image.Image) -> LabelledItem:
    return LabelledItem(path.stem, write(path, image), path)


def in_palette(values: np.ndarray, colours: list[int]) -> Image.Image:
    image = Image.fromarray(values).convert("P")
    image.putpalette(colours)
    return image


@pytest.mark.parametrize(
    ("reader", "image"),
    [
        *((NUMBERS, Image.fromarray(ROW).convert(mode)) for mode in ("L", "RGB", "RGBA", "LA")),
        (NUMBERS, ROW.astype(np.uint16)),
        (NUMBERS, in_palette(ROW, [200, 30, 10] * 256)),
        (COLOURS, Image.fromarray(np.array([PIXELS], np.uint8))),
        (COLOURS, Image.fromarray(np.array([PIXELS], np.uint8)).quantize(5)),
    ],
)
def test_what_numbers_and_colours_mean(tmp_path, reader, image):
    truth = reader.truth(saved(tmp_path / "a.png", image))

    assert truth.road[0].tolist() == [False, True, True, False, False]
    assert truth.valid[0].tolist() == [True, True, True, True, False]
    assert truth.layout is not None
    assert truth.layout[0].tolist() == [1, 2, 2, 0, 255]


def test_pairs_in_the_order_of_their_names(tmp_path):
    for name in ("images/b.jpg", "images/a.png", "labels/a_L.png", "labels/b_L.png"):
        saved(tmp_path / name, GREY)
    saved(tmp_path / "images/b.mask.png", GREY)  # a result of roadtorch
    for name in ("images/._a.png", "images/notes.txt"):
        (tmp_path / name).write_bytes(b"")

    files = pair_files(tmp_path / "images", tmp_path / "labels", "_L.png")

    names = [(image.name, label.name) for image, label in files]
    assert names == [("a.png", "a_L.png"), ("b.jpg", "b_L.png")]


def test_a_name_is_one_in_either_unicode_form(tmp_path: Path) -> None:
    saved(tmp_path / "images/\u00fc.png", GREY)
    saved(tmp_path / "labels/u\u0308.png", GREY)

    ((_, label),) = pair_files(tmp_path / "images", tmp_path / "labels")

    assert label.name == "u\u0308.png"
    map_of_it = find_maps(tmp_path / "images", ["u\u0308"])
    assert [path.name for path in map_of_it] == ["\u00fc.png"]


def test_images_of_a_set_that_are_not_read_are_named(tmp_path: Path) -> None:
    for name in ("images/a.png", "labels/a.png"):
        saved(tmp_path / name, GREY)
    (tmp_path / "images/b.HEIC").touch()

    with pytest.warns(UserWarning, match=r"images: 1 left out: b.HEIC \(give"):
        assert len(list(pair_files(tmp_path / "images", tmp_path / "labels"))) == 1


# --- maps ----------------------------------------------------------------------------------------

RAMP = np.linspace(0, 1, 60).reshape(6, 10)
BYTES, WORDS = np.round(RAMP * 255).astype(np.uint8), np.round(RAMP * 65535).astype(np.uint16)
MASK = RAMP > 0.6
ONES = MASK.astype(np.uint8)


@pytest.mark.filterwarnings("ignore:.*has only 2")
@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"a.png": BYTES, "a.npy": RAMP}, BYTES / 255),  # the same twice
        ({"a.likelihood.png": WORDS}, WORDS / 65535),
        ({"a.npy": RAMP}, RAMP),
        *(({"a.png": image}, MASK)
          for image in (ONES, ONES * 255, Image.fromarray(ONES.astype(np.uint16)),
                        Image.fromarray(MASK), np.stack([ONES] * 3, -1),
                        in_palette(ONES, [0, 0, 0, 128, 0, 0]))),
        *(({"a.npy": values}, MASK)
          for values in (MASK, MASK.astype(np.int64), ONES * 255, ONES * np.uint16(65535))),
        ({"a.png": ONES, "b.png": BYTES}, ONES / 255),  # all of a kind decide the level of 1
        ({"a.npy": ONES.astype(np.int32), "b.npy": WORDS.astype(np.int32)}, ONES / 65535),
        ({"a.png": Image.fromarray(MASK), "b.png": BYTES}, MASK),
        ({"a.likelihood.png": ONES, "config.toml": ""}, ONES / 255),  # of infer, almost 0
    ],
)  # fmt: skip
def test_maps_and_masks_in_any_coding_are_likelihoods(tmp_path, files, expected):
    paths = [write(tmp_path / name, content) for name, content in files.items()]

    maps = open_maps(tmp_path, DetectorSettings(), paths)
    likelihood = maps.read_likelihood(["none", "a"], [RAMP.shape])

    assert likelihood.dtype == torch.float32
    assert np.abs(likelihood.numpy() - expected).max() < 1e-6


def test_a_map_of_few_values_is_told(tmp_path: Path) -> None:
    for name, values in {"mask": MASK, "smooth": np.linspace(0, 1, 99)[None]}.items():
        np.save(tmp_path / f"{name}.npy", values)
    np.save(tmp_path / "classes.npy", np.arange(24).reshape(4, 6) % 3)

    paths = [tmp_path / f"{name}.npy" for name in ("mask", "smooth", "classes")]
    with pytest.warns(UserWarning, match=r"only 3 values in maps of int64 in NumPy files; if"):
        open_maps(tmp_path, DetectorSettings(), paths)


# --- drawn shapes -----------------------------------------------------------------------


SIZE = (12, 16)
corners = st.lists(
    st.tuples(st.integers(-8, 24), st.integers(-8, 20)), min_size=3, max_size=6
)  # beyond the image too


Fill = Callable[[np.ndarray, tuple[int, int]], np.ndarray]


def draw_mask(points: list[tuple[float, float]], fill: Fill = fill_polygon) -> np.ndarray:
    return fill(np.array(points, np.float64), SIZE)


def box(x1: float, y1: float, x2: float, y2: float) -> list[tuple[float, float]]:
    return [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]


def grid(size: tuple[int, int], predicate: Callable[[int, int], bool]) -> np.ndarray:
    return np.array([[predicate(x, y) for x in range(size[1])] for y in range(size[0])])


@settings(max_examples=25)
@given(corners)
def test_a_polygon_is_its_inside_and_its_border(points):
    mask = draw_mask(points)

    inside = grid(SIZE, lambda x, y: contains(x, y, points))
    border = grid(SIZE, lambda x, y: bool(mask[y, x]) and is_on_drawn_border(x, y, points))
    assert mask[inside].all()
    assert (mask == inside | border).all()


@settings(max_examples=25)
@given(corners)
def test_an_area_has_the_pixels_whose_centres_are_inside(points):
    mask = draw_mask(points, fill_area)

    doubled = [(2 * x, 2 * y) for x, y in points]  # so that centres are at odd numbers
    border = grid(SIZE, lambda x, y: any(is_on(2 * x + 1, 2 * y + 1, e) for e in edges(doubled)))
    inside = grid(SIZE, lambda x, y: contains(2 * x + 1, 2 * y + 1, doubled))
    assert (mask == inside)[~border].all()


@pytest.mark.parametrize(
    ("points", "pixels"),
    [
        (box(2, 3, 9, 8), 8 * 6),  # both borders belong to it
        (box(9, 8, 2, 3), 8 * 6),
        (box(2.4, 2.6, 9.4, 8.4), 8 * 6),  # corners go to the nearest pixel
        (box(-20, -20, 40, 40), 12 * 16),
        (box(20, 20, 30, 30), 0),
        (box(-4, -4, 0, 0), 1),
        ([(5, 5), (5, 5), (5, 5)], 1),
        ([(0, 0), (15, 0), (15, 0)], 16),
    ],
)
def test_pixels_of_a_polygon(points, pixels):
    assert draw_mask(points).sum() == pixels
