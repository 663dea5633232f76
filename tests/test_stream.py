import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch import Selection, Source, detect_stream, load_detector
from roadtorch.detector import Detection
from roadtorch.errors import InputError, RoadtorchError
from roadtorch.sources.frame import Frame
from roadtorch.stream import Behind, ahead
from tests.streets import scene
from tests.videos import write_video

ROWS = load_detector("prior:rows")
GREY = load_detector("grey-uniformity")


def of_scenes(count: int, closed: list[bool] | None = None, bad: int | None = None) -> Source:
    """A source of rendered streets; it notes when it is closed, and one frame may be bad."""

    def read(number: int) -> Callable[[], Tensor]:
        def image() -> Tensor:
            if number == bad:
                raise InputError(f"frame {number}", "is broken", "replace it")
            return scene(number % 4, 48, 64).image

        return image

    def frames() -> Iterator[Frame]:
        try:
            for number in range(count):
                yield Frame(number, f"x/{number}", f"x {number}", number / 10, read(number))
        finally:
            if closed is not None:
                closed.append(True)

    return Source("x", "x", True, frames)


def test_detections_have_names_time_stamps_and_images(tmp_path: Path) -> None:
    path = write_video(tmp_path / "drive.mp4")

    found = list(detect_stream(path, GREY, Selection(every=3)))

    assert [one.name for one in found] == [f"drive/{n:06d}" for n in (0, 3, 6, 9)]
    assert [one.seconds for one in found] == pytest.approx([0, 0.3, 0.6, 0.9])
    for one in found:
        assert one.image is not None
        assert torch.equal(one.likelihood, GREY.detect(one.image).likelihood)
        assert torch.equal(one.mask, GREY.detect(one.image).mask)


def test_the_number_of_jobs_changes_nothing() -> None:
    one = list(detect_stream(of_scenes(7), GREY))
    three = list(detect_stream(of_scenes(7), GREY, jobs=3))

    assert [each.name for each in one] == [each.name for each in three]
    for first, second in zip(one, three, strict=True):
        assert torch.equal(first.likelihood, second.likelihood)


@pytest.mark.parametrize("jobs", [1, 2])
def test_leaving_the_loop_closes_the_source_and_its_threads(jobs: int) -> None:
    before, closed = threading.active_count(), []
    detections = detect_stream(of_scenes(10**6, closed), ROWS, jobs=jobs)
    for _ in range(3):
        next(detections)

    detections.close()

    assert closed == [True]
    assert threading.active_count() == before


def test_an_error_in_the_loop_closes_the_source() -> None:
    closed = []

    def fail(done: int, _: float | None) -> None:
        if done == 2:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        list(detect_stream(of_scenes(10**6, closed), ROWS, progress=fail))

    assert closed == [True]


def test_progress_is_told() -> None:
    told: list[tuple[int, float | None]] = []

    list(detect_stream(of_scenes(3), ROWS, progress=lambda *what: told.append(what)))

    assert told == [(1, 0.0), (2, 0.1), (3, 0.2)]


def test_a_bad_frame_is_raised_or_told() -> None:
    missed: list[str] = []

    def note(frame: Frame, problem: RoadtorchError) -> None:
        missed.append(f"{frame.name} {problem.what}")

    found = list(detect_stream(of_scenes(4, bad=1), ROWS, failed=note))

    assert [one.name for one in found] == ["x/0", "x/2", "x/3"]
    assert missed == ["x/1 is broken"]
    with pytest.raises(InputError, match="frame 1: is broken"):
        list(detect_stream(of_scenes(4, bad=1), ROWS))


def test_what_steadies_sees_the_frames_in_order_and_decides() -> None:
    class Never:
        """There is no road, says it, and a car on the left."""

        def __init__(self) -> None:
            self.seen: list[Tensor] = []
            self.hidden = torch.zeros(48, 64, dtype=torch.bool)
            self.hidden[:, :8] = True

        def __call__(
            self, image: Tensor, likelihood: Tensor, hidden: Tensor | None = None
        ) -> Tensor:
            self.seen.append(image)
            return torch.zeros_like(likelihood)

    never = Never()

    found: list[Detection] = list(detect_stream(of_scenes(5), GREY, jobs=3, steady=never))

    assert not any(one.mask.any() for one in found)
    assert not any(one.likelihood.any() for one in found)
    assert all(torch.equal(one.cues["ego"], never.hidden) for one in found)
    for number, image in enumerate(never.seen):
        assert torch.equal(image, scene(number % 4, 48, 64).image)


def test_pictures_are_a_source_that_does_not_move(tmp_path: Path) -> None:
    from tests.command import save_picture

    save_picture(tmp_path / "b.png")
    save_picture(tmp_path / "sub" / "a.jpg")

    found = list(detect_stream(tmp_path, ROWS))

    assert [(one.name, one.seconds) for one in found] == [("b", None), ("sub/a", None)]


def test_reading_ahead_is_bounded() -> None:
    fetched: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(100):
            fetched.append(number)
            yield number

    with ahead(numbers(), 2) as items:
        assert [next(items), next(items)] == [0, 1]

    assert len(fetched) <= 2 + 2 + 2  # taken, in the queue, and in hand


def test_what_a_thread_behind_raises_is_raised_at_last() -> None:
    done: list[int] = []
    behind = Behind(2)
    for number in range(5):
        behind.do(lambda number=number: done.append(number))
    behind.do(lambda: 1 // 0)  # pyright: ignore[reportArgumentType]

    with pytest.raises(ZeroDivisionError):
        behind.finish()

    assert done == [0, 1, 2, 3, 4]
