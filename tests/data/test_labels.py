"""Label images, foreign likelihood maps, and filled polygons."""

from collections.abc import Callable
from pathlib import Path

import cv2
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
from tests.data.conftest import read_likelihood_map, write
from tests.reference.polygons import contains, edges, is_on, is_on_drawn_border

NUMBERS = NumberLabels(road=(1, 5), void=(9,), values=(0, 1, 5, 7, 9), layout=(1, 2, 2, 0, 255))
COLOURS = ColourLabels(
    colours=((0, 0, 0), (255, 0, 255), (1, 2, 3)),
    numbers=NumberLabels(road=(1,), void=(2,), values=(0, 1, 2)),
)
GREY = np.array([[0, 255], [255, 0]], np.uint8)
MASKS = NumberLabels(road=(1, 255), void=(), values=(0, 1, 255))


def saved(path: Path, image: np.ndarray | Image.Image) -> LabelledItem:
    return LabelledItem(path.stem, write(path, image), path)


ROW = np.array([[0, 1, 5, 7, 9]], np.uint8)
PALETTE = Image.fromarray(ROW).convert("P")
PALETTE.putpalette([200, 30, 10] * 256)


@pytest.mark.parametrize("image", [ROW, ROW.astype(np.uint16), PALETTE], ids=["8", "16", "P"])
def test_what_the_numbers_mean(tmp_path, image):
    truth = NUMBERS.truth(saved(tmp_path / "a.png", image))

    assert truth.road[0].tolist() == [False, True, True, False, False]
    assert truth.valid[0].tolist() == [True, True, True, True, False]
    assert truth.layout is not None
    assert truth.layout[0].tolist() == [1, 2, 2, 0, 255]


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "LA", "1"])
def test_grey_images_of_several_modes(tmp_path, mode):
    truth = MASKS.truth(saved(tmp_path / "a.png", Image.fromarray(GREY).convert(mode)))

    assert truth.road.tolist() == [[False, True], [True, False]]
    assert truth.layout is None


def test_what_the_colours_mean(tmp_path):
    pixels = np.array([[[255, 0, 255], [1, 2, 3], [0, 0, 0]]], np.uint8)
    for image in (Image.fromarray(pixels), Image.fromarray(pixels).quantize(3)):
        truth = COLOURS.truth(saved(tmp_path / "a.png", image))

        assert truth.road[0].tolist() == [True, False, False]
        assert truth.valid[0].tolist() == [True, False, True]


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

RAMP = np.linspace(0, 1, 24).reshape(4, 6)


def test_8_and_16_bit_images_and_numpy_files_are_read_alike(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.round(RAMP * 255).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "b.likelihood.png"), np.round(RAMP * 65535).astype(np.uint16))
    np.save(tmp_path / "c.npy", RAMP)
    np.save(tmp_path / "a.npy", RAMP)  # the same as beside it

    for name, step in (("a", 1 / 255), ("b", 1 / 65535), ("c", 1e-7)):
        likelihood = read_likelihood_map(tmp_path, ["none", name], [(4, 6)])
        assert likelihood.dtype == torch.float32
        assert np.abs(likelihood.numpy() - RAMP).max() <= step / 2 + 1e-7


MASK = np.arange(24).reshape(4, 6) > 13


def in_palette(colours: list[int]) -> Image.Image:
    image = Image.fromarray(MASK.astype(np.uint8)).convert("P")
    image.putpalette(colours)
    return image


@pytest.mark.parametrize(
    "values",
    [
        Image.fromarray(MASK.astype(np.uint8)),
        Image.fromarray(MASK.astype(np.uint8) * 255),
        Image.fromarray(MASK.astype(np.uint16)),
        Image.fromarray(MASK),
        Image.fromarray(np.stack([MASK.astype(np.uint8)] * 3, -1)),
        in_palette([0, 0, 0, 128, 0, 0]),
        MASK,
        MASK.astype(np.int64),
        MASK.astype(np.uint8) * 255,
        MASK.astype(np.uint16) * 65535,
    ],
    ids=["0/1", "0/255", "16 bits", "1 bit", "rgb", "palette", "bool", "int", "bytes", "words"],
)
def test_a_mask_in_any_coding_is_a_mask(values: Image.Image | np.ndarray, tmp_path: Path) -> None:
    if isinstance(values, Image.Image):
        values.save(tmp_path / "a.png")
    else:
        np.save(tmp_path / "a.npy", values)

    assert torch.equal(
        read_likelihood_map(tmp_path, ["a"], [(4, 6)]), torch.from_numpy(MASK).float()
    )


def test_a_map_of_few_values_is_told(tmp_path: Path) -> None:
    for name, values in {"mask": MASK, "smooth": np.linspace(0, 1, 99)[None]}.items():
        np.save(tmp_path / f"{name}.npy", values)
    np.save(tmp_path / "classes.npy", np.arange(24).reshape(4, 6) % 3)

    paths = [tmp_path / f"{name}.npy" for name in ("mask", "smooth", "classes")]
    with pytest.warns(UserWarning, match=r"only 3 values in maps of int64 in NumPy files; if"):
        open_maps(tmp_path, DetectorSettings(), paths)


@pytest.mark.filterwarnings("ignore:.*has only 2")
def test_all_maps_of_a_kind_decide_the_level_of_1(tmp_path: Path) -> None:
    levels = {"a": np.round(RAMP * 255).astype(np.uint8), "b": MASK.astype(np.uint8)}
    for name, values in levels.items():
        Image.fromarray(values).save(tmp_path / f"{name}.png")
        np.save(tmp_path / f"{name}16.npy", values.astype(np.int32) * 257)
    Image.fromarray(MASK).save(tmp_path / "bits.png")

    maps = open_maps(tmp_path, DetectorSettings(), sorted(tmp_path.iterdir()))

    for name, brightest in {"b": 1 / 255, "b16": 1 / 255, "bits": 1.0}.items():
        likelihood = maps.read_likelihood([name], [(4, 6)])
        assert float(likelihood.max()) == pytest.approx(brightest)


def test_likelihoods_of_infer_that_are_almost_0_are_no_mask(tmp_path: Path) -> None:
    (tmp_path / "config.toml").touch()
    Image.fromarray(MASK.astype(np.uint8)).save(tmp_path / "a.likelihood.png")

    assert float(read_likelihood_map(tmp_path, ["a"], [(4, 6)]).max()) == pytest.approx(1 / 255)


# --- drawn shapes -----------------------------------------------------------------------


SIZE = (12, 16)
corners = st.lists(
    st.tuples(st.integers(-8, 24), st.integers(-8, 20)), min_size=3, max_size=6
)  # beyond the image too


Fill = Callable[[np.ndarray, np.ndarray, int], None]


def draw_mask(points: list[tuple[float, float]], fill: Fill = fill_polygon) -> np.ndarray:
    canvas = np.zeros(SIZE, np.uint8)
    fill(np.array(points, np.float64), canvas, 1)
    return canvas > 0


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
