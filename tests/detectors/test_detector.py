"""Contract of images, detections and detectors, and conversions for other packages."""

import io
import pickle
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image, ImageShow
from torch import Tensor, nn

from roadtorch import load_detector
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import overlay_pixels, read_image
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.entry import use_inference_mode
from roadtorch.imaging import slic as superpixels
from roadtorch.imaging.resize import resize_to_image
from roadtorch.oneclass import base
from roadtorch.oneclass.axes import make_axes
from roadtorch.oneclass.density import variance_floor
from roadtorch.testing.scenes import write_image
from tests.streets import scene


class Doubling(nn.Module):
    """Twice the first plane."""

    @use_inference_mode
    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        return {"doubled": 2 * image[0]}


def test_gradients_that_are_asked_for_flow() -> None:
    image = torch.ones(3, 4, 4, requires_grad=True)

    Doubling()(image)["doubled"].sum().backward()

    assert image.grad is not None
    assert image.grad.sum() == 2 * 16


def test_cues_are_enlarged_when_asked_for_and_cross_processes_small() -> None:
    evidence = load_detector("fusion:untrained", working={"pixels": 400}).find_evidence(
        scene(1, 48, 64).image
    )

    sent = pickle.loads(pickle.dumps(evidence))

    assert list(sent.cues) == list(evidence.cues)
    assert len(repr(sent.cues).splitlines()) == 1 + len(sent.cues)
    assert "layout (3, " in repr(sent.cues)
    for name, cue in sent.cues.items():
        assert cue.shape[-2:] == (48, 64)
        assert sent.cues.maps[name].shape[-2:] != (48, 64)
        assert torch.equal(cue, resize_to_image(evidence.outputs[name], (48, 64)))
    with pytest.raises(KeyError, match="missing"):
        sent.cues["missing"]


@pytest.mark.parametrize("name", ["fusion", "labeller", "cpf", "lbp", "prior:rows"])
def test_detections_hold_ordinary_tensors(name: str) -> None:
    image = scene(1, 48, 64).image  # below the working size: nothing is resized

    detection = load_detector(name).detect(image)

    for maps in (detection.likelihood, detection.mask, *detection.cues.values()):
        assert not maps.is_inference()
    weight = torch.ones((), requires_grad=True)
    (weight * detection.likelihood.mul_(0.5)).sum().backward()  # no such tensor allows either
    assert weight.grad == detection.likelihood.sum() <= 0.5 * 48 * 64


def test_what_is_kept_for_later_calls_is_no_tensor_of_inference_mode() -> None:
    grid, axes = superpixels._grid(17, 23, 6), make_axes(("R", "G"))  # nobody has asked for these
    with torch.inference_mode():
        kept = [
            superpixels._positions(grid, 1),
            *superpixels._distance_maps(grid, 0.0123),
            base._quantum_steps(axes),
            variance_floor(axes),
        ]

    assert [tensor.is_inference() for tensor in kept] == [False] * len(kept)


@pytest.mark.parametrize("name", ["fusion", "layout:cnn-7", "ufl", "oneclass:gaussian:RGB"])
def test_numbers_are_float32_whatever_autocast_is_around(name: str) -> None:
    image, detector = scene(1, 48, 64).image, load_detector(name)

    with torch.autocast("cpu", dtype=torch.bfloat16):
        detection = detector(image)

    assert same(detection, detector(image))


def test_a_network_can_be_compiled_and_a_detector_says_so() -> None:
    image, detector = scene(1, 48, 64).image, load_detector("fusion")
    with pytest.raises(ConfigError, match=r"torch\.compile: takes no detector"):
        torch.compile(detector, backend="eager")(image)
    uncompiled = detector(image)

    analysis: Any = detector.analysis
    analysis.network = torch.compile(analysis.network, backend="eager")

    assert same(detector(image), uncompiled)


# --- images in --------------------------------------------------------------------------

BGR = [
    (255 * scene(seed, 48, 64).image[:, :, 4 * seed :]).byte().numpy()[::-1].transpose(1, 2, 0)
    for seed in range(4)
]
"""Images of four sizes, as OpenCV has them."""


def same(first: Detection, second: Detection) -> bool:
    return first.trust == second.trust and all(
        map(np.array_equal, first.numpy().values(), second.numpy().values())
    )


def test_several_images_give_what_each_gives_by_itself() -> None:
    detector = load_detector("fusion:untrained", order="bgr")
    singles = [detector.detect(image) for image in BGR]
    square = [image[:, :50] for image in BGR[:2]]
    alike = detector(square)
    images = torch.stack([detection.image for detection in alike])  # type: ignore[misc]

    assert all(map(same, detector(BGR), singles))
    assert all(map(same, detector.detect_many(iter(BGR)), singles))
    for stack in (np.stack(square), images):
        assert isinstance(detector(stack), list)  # type: ignore[arg-type]
        assert all(map(same, detector(stack), alike))  # type: ignore[call-overload]
    assert same(detector(BGR[0]), load_detector("fusion:untrained").detect(BGR[0], "bgr"))
    likelihoods = torch.stack([detection.likelihood for detection in alike])
    assert torch.equal(detector.forward(images), likelihoods)
    assert detector([]) == []


def test_the_bytes_of_a_file_and_the_open_file_are_images(tmp_path: Path) -> None:
    path, detector = tmp_path / "street.png", load_detector("prior:triangle")
    write_image(path, scene(1, 48, 64))

    with path.open("rb") as file:
        detections = [
            detector(path.read_bytes()),
            detector(file),
            *detector([io.BytesIO(path.read_bytes())]),
        ]

    assert all(same(detection, detector(path)) for detection in detections)


def test_a_generator_is_asked_when_a_image_is_needed_and_left_where_one_is_wrong() -> None:
    requested = []

    def images() -> Iterator[Any]:
        for number, image in enumerate([*BGR[:2], None, BGR[3]]):
            requested.append(number)
            yield image

    detections = load_detector("prior:rows", order="bgr").detect_many(images())

    assert requested == []
    assert [next(detections).mask.shape[1], next(detections).mask.shape[1]] == [64, 60]
    assert requested == [0, 1]
    with pytest.raises(InputError, match=r"images\[2\]: is None"):
        next(detections)
    assert requested == [0, 1, 2]


@pytest.mark.parametrize(
    ("images", "options", "problem"),
    [
        ("x.jpg", {}, "x.jpg: does not exist"),
        (None, {}, "image: is None"),
        (3.5, {}, "image: is float"),
        (["x.jpg", "y.jpg"], {}, "x.jpg: does not exist"),
        ([torch.rand(3, 20, 20)], {"order": "bgr"}, "order: is for NumPy arrays"),
        ([np.full((20, 20, 3), 200.0)], {"order": "rgb"}, "images[0]: has values from 200 to 200"),
        ([BGR[0]], {"order": "gbr"}, "gbr: unknown colour order"),
        ("bgr", {}, 'image: is a colour order (write detect(image, "bgr")'),
        ("bgr", {"order": BGR[0]}, 'order: is ndarray (write detect(image, "rgb")'),
        (["bgr"], {"order": BGR}, "order: is list (write detect("),
    ],
)
def test_other_values_are_refused_as_given(
    images: Any, options: dict[str, Any], problem: str
) -> None:
    with pytest.raises((InputError, ConfigError), match=re.escape(problem)):
        load_detector("prior:rows")(images, **options)


@pytest.mark.parametrize("within", ["", "*.png"])
def test_a_folder_and_a_glob_are_read_when_an_image_is_needed(tmp_path: Path, within: str) -> None:
    for name in "abc":
        Image.new("RGB", (32, 32)).save(tmp_path / f"{name}.png")
    detections = load_detector("prior:rows").detect_many(tmp_path / within)

    first = next(detections)
    (tmp_path / "c.png").write_bytes(b"cut")

    assert (first.name, next(detections).name) == ("a", "b")
    with pytest.raises(InputError, match=r"c\.png: is not an image"):
        next(detections)


def test_one_image_is_no_list_and_an_order_is_checked_at_once() -> None:
    detector = load_detector("prior:rows")
    with pytest.raises(InputError, match=r"images: are bytes \(give a list"):
        detector.detect_many(b"\xff")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"images: have the shape \(3, 32, 32\)"):
        detector.forward(torch.zeros(3, 32, 32))
    with pytest.raises(ConfigError, match="BGR: unknown colour order"):
        load_detector("prior:rows", order="BGR")  # type: ignore[arg-type]


def test_the_line_of_a_detector_has_the_settings_that_differ_from_its_own() -> None:
    ego = {"outline": [0.9] * 64}
    detector = load_detector("fusion:large", order="bgr", working={"pixels": 4096}, ego=ego)

    assert repr(load_detector("fusion:large")) == "<Detector fusion:large>"
    assert repr(detector) == (
        "<Detector fusion:large, ego.outline=(0.9, 0.9, 0.9, 0.9, 0.9, 0.9, ...), "
        "working.pixels=4096, order='bgr'>"
    )


# --- detections out -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def trusted() -> Detection:
    detection = load_detector("prior:rows", ego={"bottom": 0.1}).detect(scene(1, 48, 64).image)
    return replace(detection, trust=0.75)


def test_a_detection_is_saved_as_its_name_says(trusted: Detection, tmp_path: Path) -> None:
    for end in ("mask.png", "likelihood.png", "overlay.jpg", "overlay.png", "npz"):
        trusted.save(tmp_path / f"street.{end}")

    assert trusted.image is not None
    overlaid = overlay_pixels(
        trusted.image, trusted.mask, trusted.cues["ego"], "trust 0.75"
    )  # as infer
    assert np.array_equal(trusted.overlay(), overlaid)
    assert torch.equal(read_image(tmp_path / "street.mask.png")[0] == 1, trusted.mask)
    levels = read_image(tmp_path / "street.likelihood.png")[0]
    np.testing.assert_allclose(levels, trusted.likelihood, rtol=0, atol=0.5001 / 255)
    with Image.open(tmp_path / "street.overlay.png") as overlay:
        assert np.array_equal(np.array(overlay), trusted.overlay())
    with Image.open(tmp_path / "street.overlay.jpg") as overlay:
        assert overlay.format == "JPEG"
    with np.load(tmp_path / "street.npz") as stored:
        assert set(stored) == {"likelihood", "mask", "trust", *trusted.cues}
        assert all(np.array_equal(stored[name], map) for name, map in trusted.numpy().items())
    with pytest.raises(ConfigError, match=r"street\.png: has no known ending \(end it with"):
        trusted.save(tmp_path / "street.png")


def test_a_detection_shows_itself(trusted: Detection, monkeypatch: pytest.MonkeyPatch) -> None:
    windows: list[object] = []

    class Window(ImageShow.Viewer):
        def show(self, image: Image.Image, **_: Any) -> int:
            windows.append(np.asarray(image))
            return 1

    monkeypatch.setattr(ImageShow, "_viewers", [Window()])
    trusted.show()
    assert np.array_equal(windows.pop(), trusted.overlay())  # type: ignore[arg-type]

    monkeypatch.setattr(ImageShow, "_viewers", [])
    with pytest.raises(InputError, match=r"show\(\): finds no display \(use save\(\)"):
        trusted.show()

    monkeypatch.setitem(sys.modules, "ipykernel", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=windows.append))
    trusted.show()
    assert windows == [trusted]


def test_a_detection_without_its_image_has_no_overlay() -> None:
    detection = Detection(torch.zeros(16, 16), torch.zeros(16, 16).bool(), {})

    assert detection._repr_jpeg_() is None
    with pytest.raises(InputError, match="is not part of this detection"):
        detection.overlay()


def test_notebooks_show_a_line_and_the_overlay() -> None:
    detection = load_detector("prior:rows").detect(torch.full((3, 40, 2000), 0.4))
    jpeg = detection._repr_jpeg_()

    assert re.fullmatch(r"<Detection 2000×40, road \d+%>", repr(detection))
    assert jpeg is not None
    assert Image.open(io.BytesIO(jpeg)).size == (960, 19)
    doubtful = replace(detection, trust=0.314, doubt="no road found")
    assert repr(doubtful).endswith(", trust 0.31 (no road found)>")


# --- other packages ---------------------------------------------------------------------


ROAD = ((0, 0, 0, 0, 0, 0, 0), (0, 1, 1, 1, 1, 0, 0), (0, 1, 0, 0, 1, 0, 1), (0, 1, 1, 1, 1, 0, 1))


def detection(road: object = ROAD, trust: float | None = 0.75) -> Detection:
    mask = torch.as_tensor(road, dtype=torch.bool)
    return Detection(mask.float(), mask, {}, trust, "is dark", name="a", seconds=1.5)


def test_polygons_are_borders_and_behind_them_those_of_their_holes() -> None:
    regions = sorted(detection().polygons(), key=len)

    assert [len(rings) for rings in regions] == [1, 2]
    ((line,), (outside, hole)) = regions
    assert {*map(tuple, line.tolist())} == {(6, 2), (6, 3)}
    assert {*map(tuple, outside.tolist())} == {(1, 1), (1, 3), (4, 3), (4, 1)}
    assert hole.min(0).tolist() == [1, 1]
    assert hole.max(0).tolist() == [4, 3]
    assert detection(torch.zeros(3, 4)).polygons() == []
