"""Commands, streams and the node with detectors on another device, as with ``--device cuda``."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch

from roadtorch import detect_stream, load_detector
from roadtorch.annotate.views import compute_view
from roadtorch.base.image import from_pixels, write_mask
from roadtorch.camera.ground_grid import GridSettings
from roadtorch.detectors.detector import Detector
from roadtorch.ros import camera_topics, messages, node
from roadtorch.ros.parameters import NodeParameters
from roadtorch.run.writers.maps import MAP_SUFFIXES
from roadtorch.run.writers.outputs import VIDEOS
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import Call, files_in, read_index_rows
from tests.inputs.bags import write_drive
from tests.pretended_device import Pretended, PretendedDevice, move_to_pretended
from tests.videos import street_pixels, write_video

MAPS = ",".join([*MAP_SUFFIXES, "cues"])
FOOTAGE = ",".join([MAPS, *VIDEOS, "overlay-frames", "bag"])
PIXELS = [street_pixels(seed) for seed in range(3)]

Enter = Callable[[], PretendedDevice]


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Enter:
    """Return a mode in which every detector is on the pretended device, wherever it is made."""
    make = Detector.__init__

    def make_on_device(self: Detector, entry: Any, settings: Any, *options: Any) -> None:
        make(self, entry, settings, *options[:1])
        move_to_pretended(self)
        self.device = "meta"

    def enter() -> PretendedDevice:
        monkeypatch.setattr(Detector, "__init__", make_on_device)
        return PretendedDevice()

    return enter


@pytest.fixture
def inputs(tmp_path: Path) -> dict[str, Path]:
    for seed in range(2):
        write_image(tmp_path / "images" / f"{seed}.png", render_scene(seed, 60, 80))
    return {
        "images": tmp_path / "images",
        "video": write_video(tmp_path / "drive.mp4", (0.0, 0.1, 0.2)),
        "bag": write_drive(tmp_path, "mcap", PIXELS, 60.0),
    }


@pytest.mark.parametrize(
    ("kind", "save", "options"),
    [
        ("images", MAPS, ()),
        ("images", "mask", ("--detector", "prior:rows")),
        ("video", FOOTAGE, ()),
        ("video", "mask,mask-video", ("--no-smoothing",)),
        ("bag", FOOTAGE, ()),
    ],
)
def test_infer_writes_the_same_files_from_another_device(
    kind: str,
    save: str,
    options: tuple[str, ...],
    device: Enter,
    inputs: dict[str, Path],
    call: Call,
    out: Path,
) -> None:
    words = ("infer", inputs[kind], "--save", save, "--quiet", "--jobs", "1", *options)
    expected = call(*words, "--out", out / "cpu")

    with device():
        result = call(*words, "--device", "meta", "--out", out / "meta")

    assert (result.exit_code, result.stderr) == (expected.exit_code, expected.stderr) == (0, "")
    assert files_in(out / "meta") == files_in(out / "cpu")
    rows = zip(*(read_index_rows(out / name).values() for name in ("cpu", "meta")), strict=True)
    assert all(expected["road_fraction"] == row["road_fraction"] for expected, row in rows)


@pytest.mark.parametrize("smoothing", [True, False])
def test_streams_stay_on_the_device_of_their_detector(
    smoothing: bool, device: Enter, inputs: dict[str, Path]
) -> None:
    expected = [detection.mask for detection in load_detector("fusion").stream(inputs["video"])]

    with device():
        detector = load_detector("fusion")
        stream = detect_stream(inputs["video"], detector, smoothing=smoothing)
        masks = [detection.mask for detection in stream]

    assert all(isinstance(weights, Pretended) for weights in detector.parameters())
    assert not any(isinstance(mask, Pretended) for mask in masks)
    assert not smoothing or all(map(torch.equal, masks, expected))


def test_a_detection_on_a_device_is_shown_saved_and_converted(
    device: Enter, tmp_path: Path
) -> None:
    with device():
        (detection,) = load_detector("fusion", order="rgb").detect_many(PIXELS[:1])
        for end in ("mask.png", "likelihood.png", "overlay.jpg", "npz"):
            detection.save(tmp_path / f"street.{end}")
        assert detection.polygons()
        assert detection._repr_jpeg_()
        assert repr(detection)

    assert isinstance(detection.likelihood, Pretended)
    assert set(detection.numpy()) == {"likelihood", "mask", *detection.cues}
    assert len(files_in(tmp_path)) == 4


def test_annotation_takes_a_detector_on_another_device(device: Enter) -> None:
    with device():
        view = compute_view(from_pixels(PIXELS[0]), load_detector("fusion"))

    assert not isinstance(view.odds, Pretended)


def test_the_node_publishes_the_masks_of_another_device(
    device: Enter, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[np.ndarray] = []
    for module in (camera_topics, messages, node):
        monkeypatch.setattr(module, "import_ros", MagicMock())
    monkeypatch.setattr(camera_topics, "image_message", lambda _, pixels: published.append(pixels))
    parameters = {"": NodeParameters(grid=GridSettings(height=1.2, pitch=0.0, fov=60.0))}

    def run() -> int:
        road = node.RoadNode(MagicMock(), parameters)
        for pixels in PIXELS:
            fields = {"encoding": "rgb8", "height": 48, "width": 64, "step": 192, "is_bigendian": 0}
            road.inbox.put("", MagicMock(data=pixels.reshape(-1), **fields))
        waiting = iter(PIXELS)
        stop: Any = type("Stop", (), {"requested": property(lambda _: next(waiting, None) is None)})
        road.run(stop())
        return road.cameras[""].failures

    assert run() == 0
    expected = published[:]
    published.clear()
    with device():
        assert run() == 0
    assert len(published) >= 2 * len(PIXELS)
    np.testing.assert_array_equal(published[0], expected[0])


EPOCH = ["--quiet", "--threads", "1", "--set", "stopping.epochs=1", "--set", "samples_per_epoch=4"]
COMMANDS = {
    "evaluate": ("evaluate", "folder", "{}", "--detector", "fusion"),
    "adapt": ("adapt", "{}/images", *EPOCH),
    "train": ("train", "--config", "adapt", "--images", "{}/images", *EPOCH),
}


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_commands_take_detectors_on_another_device(
    words: tuple[str, ...], device: Enter, call: Call, tmp_path: Path, out: Path
) -> None:
    (tmp_path / "set" / "masks").mkdir(parents=True)
    for seed in range(6):
        scene = render_scene(seed, 60, 80)
        write_image(tmp_path / "set" / "images" / f"{seed}.png", scene)
        write_mask(tmp_path / "set" / "masks" / f"{seed}.png", scene.road)

    with device():
        result = call(*(word.format(tmp_path / "set") for word in words), "--out", out)

    assert result.exit_code == 0, result.stderr
