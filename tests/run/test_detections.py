"""Detection in the frames of a source: order, temporal smoothing, and closing of the source."""

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from roadtorch import detect_stream, load_detector
from roadtorch.base.errors import ConfigError, InputError, RoadtorchError
from roadtorch.base.image import read_image
from roadtorch.base.signals import StopRequest
from roadtorch.camera.camera import Camera
from roadtorch.detectors.stream import FrameResult, detect_frames
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.road.temporal_filter import TemporalFilterSettings
from roadtorch.run.loop import Inference, crashed_evidence, run_behind
from roadtorch.run.workers import Workers
from tests.command import Call, save_image
from tests.streets import scene
from tests.videos import write_video

ROWS = load_detector("prior:rows")
GREY = load_detector("grey-uniformity")


def scene_source(count: int, closed: list[bool] | None = None, bad: int | None = None) -> Source:
    """Return a source of rendered streets that notes when it is closed; one frame may be bad."""

    def read(number: int) -> Tensor:
        if number == bad:
            raise InputError(f"frame {number}", "is broken", "replace it")
        return scene(number % 4, 48, 64).image

    def items() -> Iterator[Item]:
        try:
            for number in range(count):
                yield Item(
                    f"x/{number}",
                    f"frame {number}",
                    partial(read, number),
                    number=number,
                    seconds=number / 10,
                )
        finally:
            if closed is not None:
                closed.append(True)

    return Source("x", "x", items)


@pytest.mark.parametrize(
    ("input_name", "names", "seconds"),
    [
        ("drive.mp4", [f"drive/{n:06d}" for n in (0, 3, 6, 9)], [0, 0.3, 0.6, 0.9]),
        ("images", ["b", "sub/a"], [None, None]),  # a source that does not move
    ],
)
def test_detections_have_names_time_stamps_and_images(
    input_name: str, names: list[str], seconds: list[float | None], tmp_path: Path
) -> None:
    write_video(tmp_path / "drive.mp4")
    for seed, name in enumerate(("b.png", "c.png", "d.png", "sub/a.jpg")):
        save_image(tmp_path / "images" / name, seed)

    selection = Selection(every=3)
    frames = list(detect_stream(tmp_path / input_name, GREY, selection, smoothing=False))

    assert [frame.name for frame in frames] == names
    assert [frame.seconds for frame in frames] == pytest.approx(seconds)
    for frame in frames:
        assert frame.image is not None
        assert torch.equal(frame.likelihood, GREY.detect(frame.image).likelihood)
        assert torch.equal(frame.mask, GREY.detect(frame.image).mask)


@pytest.mark.parametrize("smoothing", [True, False])
def test_footage_is_smoothed_as_by_infer(smoothing: bool, call: Call, tmp_path: Path) -> None:
    path, out = write_video(tmp_path / "drive.mp4"), tmp_path / "roads"
    flags = [] if smoothing else ["--no-smoothing"]
    call("infer", path, "--detector", GREY.name, "--save", "likelihood", *flags, "--out", out)
    written = [255 * read_image(file)[0] for file in sorted(out.glob("drive/*.likelihood.png"))]

    streams = GREY.stream, partial(detect_stream, detector=GREY)
    for frames in (stream(path, smoothing=smoothing) for stream in streams):
        likelihoods = [frame.likelihood.mul(255).round() for frame in frames]
        assert len(likelihoods) == len(written) == 12
        assert mean_change(likelihoods) == pytest.approx(mean_change(written), rel=1e-5)
        for streamed, stored in zip(likelihoods, written, strict=True):
            difference = (streamed - stored).abs()
            assert difference.max() < 1.5  # a level where float32 and float64 round apart
            assert difference.mean() < 1e-3
    unsmoothed = mean_change([frame.likelihood for frame in GREY.stream(path, smoothing=False)])
    assert (255 * unsmoothed > 1.2 * mean_change(written)) == smoothing


def mean_change(maps: Sequence[Tensor]) -> float:
    return float(torch.stack([*maps]).diff(dim=0).abs().mean())


def test_a_method_selects_frames_and_swapped_arguments_are_named(tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mp4")

    assert [frame.name for frame in ROWS.stream(path, every=5, start=0.2, end=0.9, limit=2)] == [
        "drive/000002",
        "drive/000007",
    ]
    swapped: Any = (ROWS, path)
    with pytest.raises(ConfigError, match=r"detector: is .*Path \(write detect_stream\(source, d"):
        list(detect_stream(*swapped))


def test_leaving_the_loop_and_a_bad_frame_close_the_source() -> None:
    closed: list[bool] = []
    frames = detect_stream(scene_source(10**6, closed), ROWS)
    for _ in range(3):
        next(frames)
    frames.close()

    with pytest.raises(InputError, match="frame 1: is broken"):
        list(detect_stream(scene_source(10**6, closed, bad=1), ROWS))

    assert closed == [True, True]


def mapping(workers: Workers) -> Callable[..., Any]:
    return partial(workers.map, on_crash=crashed_evidence)


def is_failed(frame: FrameResult) -> bool:
    return isinstance(frame.outcome, RoadtorchError)


# --- whoever works ----------------------------------------------------------------------


@pytest.mark.parametrize(("workers", "cues"), [(Workers(), True), (Workers(3), False)])
def test_what_steadies_sees_the_frames_in_order_and_decides(workers: Workers, cues: bool) -> None:
    class Never:
        """A temporal filter that removes all road, and hides an ego car on the left."""

        def __init__(self) -> None:
            self.settings = TemporalFilterSettings()
            self.images: list[Tensor] = []
            self.hidden = torch.zeros(48, 64, dtype=torch.bool)
            self.hidden[:, :8] = True

        def __call__(self, image: Tensor, likelihood: Tensor, *_: object) -> Tensor:
            self.images.append(image)
            return torch.zeros_like(likelihood)

    never: Any = Never()

    frames = list(
        detect_frames(scene_source(5), Inference(GREY), never, cues, map_task=mapping(workers))
    )

    for frame in frames:
        detection = frame.detection()
        assert not detection.mask.any()
        assert not detection.likelihood.any()
        assert torch.equal(detection.cues["ego"], never.hidden)
        assert ("uniformity" in detection.cues) == cues
    for number, image in enumerate(never.images):
        assert torch.equal(image, scene(number % 4, 48, 64).image)


@pytest.mark.parametrize("workers", [Workers(), Workers(2)])
def test_a_frame_that_cannot_be_read_or_looked_at_is_missed(workers: Workers) -> None:
    source = scene_source(4, bad=1)
    frames = list(detect_frames(source, Inference(ROWS), map_task=mapping(workers)))
    assert [frame.item.number for frame in frames if is_failed(frame)] == [1]

    second = Inference(ROWS, Camera(width=200, height=50, frames=10, horizon=0.4, seed_row=1.0))
    for number, frame in enumerate(detect_frames(source, second, map_task=mapping(workers))):
        assert str(frame.outcome).startswith(f"frame {number}: is ")


def test_a_step_behind_keeps_order_and_ends_before_an_error() -> None:
    seen: list[tuple[int, int]] = []

    def values() -> Iterator[int]:
        yield from range(3)
        raise InputError("drive.mp4", "ends early", "copy it again")

    with pytest.raises(InputError, match="ends early"):
        run_behind(lambda number: seen.append((number, threading.get_ident())), values())

    assert [number for number, _ in seen] == [0, 1, 2]
    assert threading.get_ident() not in dict(seen).values()
    with pytest.raises(ZeroDivisionError):
        run_behind(lambda number: 1 / number, iter([1, 0, 2]))


def test_a_live_frame_is_recorded_before_the_next_one_comes() -> None:
    recorded = threading.Event()

    def values() -> Iterator[threading.Event]:
        yield recorded
        assert recorded.wait(10)

    run_behind(threading.Event.set, values())


def test_stopping_ends_the_frames() -> None:
    closed: list[bool] = []
    stop = StopRequest()
    frames = detect_frames(scene_source(10**6, closed), Inference(ROWS), stop=stop)
    next(frames)
    stop.request(signal.SIGINT)
    assert len(list(frames)) <= 1
    assert closed == [True]
