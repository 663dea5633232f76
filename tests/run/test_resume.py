"""Runs that are interrupted, killed, or resumed with other options."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from roadtorch.detectors.detector import Detector
from roadtorch.inputs.item import Item
from roadtorch.run.ledger import IndexRow
from roadtorch.run.loop import Task
from tests.command import ROWS, Call, bytes_in, read_index_rows
from tests.videos import write_video

BeforeEach = Callable[[Callable[[Item], None]], AbstractContextManager[None]]


@pytest.fixture
def before_each(monkeypatch: pytest.MonkeyPatch) -> BeforeEach:
    """Return ``before_each(act)``: within its block, ``infer`` calls ``act`` before each image."""
    real = Task.__call__

    @contextmanager
    def acting(act: Callable[[Item], None]) -> Iterator[None]:
        def acted(self: Task, item: Item) -> IndexRow:
            act(item)
            return real(self, item)

        with monkeypatch.context() as inner:
            inner.setattr(Task, "__call__", acted)
            yield

    return acting


# --- what is done -----------------------------------------------------------------------


@pytest.mark.parametrize("options", [("--depth", "16"), ("--save", "likelihood,cues")])
def test_other_options_are_not_done_before(
    call: Call, run: Call, footage: Path, tmp_path: Path, out: Path, options: tuple[str, str]
) -> None:
    run()

    again, third, fewer = run(*options), run(*options), run(*options, "--save", "likelihood")

    call("infer", footage, *ROWS, "--out", tmp_path / "alone", *options)
    assert again.stderr == f"roadtorch: 3 done; results in {out}\n"
    assert bytes_in(tmp_path / "alone").items() <= bytes_in(out).items()
    for nothing_new in (third, fewer):
        assert nothing_new.stderr.startswith("roadtorch: 0 done, 3 skipped")


# --- killed -----------------------------------------------------------------------------


def die_of_b(item: Item) -> None:
    if item.name == "b":
        os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)], ids=["TERM", "INT"]
)
@pytest.mark.parametrize("jobs", [1, 2])
def test_what_is_in_hand_is_finished_when_a_signal_ends_the_run(
    run: Call,
    tmp_path: Path,
    out: Path,
    before_each: BeforeEach,
    number: signal.Signals,
    code: int,
    jobs: int,
) -> None:
    process, started, sent = os.getpid(), tmp_path / "both", tmp_path / "sent"

    def send(item: Item) -> None:  # in a worker, if there are several
        if item.name == "b":
            started.touch()
            while not sent.exists():
                time.sleep(0.01)
        if item.name == "a":
            while jobs == 2 and not started.exists():
                time.sleep(0.01)
            os.kill(process, number)
            sent.touch()
        time.sleep(0.2)  # until the other process has handled it

    with before_each(send):
        stopped = run("--jobs", jobs)
    record = json.loads((out / "run.json").read_text())

    assert stopped.exit_code == record["exit_status"] == code
    assert {name: row["status"] for name, row in read_index_rows(out).items()} == dict.fromkeys(
        ["a.jpg", "b.png"][:jobs], "done"
    )
    assert record["images"]["not_tried"] == 3 - jobs
    assert "roadtorch: interrupted; finished results are kept" in stopped.stderr
    assert run().stderr.startswith(f"roadtorch: {3 - jobs} done, {jobs} skipped")


def test_a_death_costs_its_image_alone_and_is_told(
    call: Call, footage: Path, tmp_path: Path, out: Path, before_each: BeforeEach
) -> None:
    run = ("infer", footage, *ROWS, "--jobs", 2, "--out")
    call(*run, tmp_path / "quiet")

    def die(item: Item) -> None:
        (out / ".roadtorch.0123abcd.part").touch()
        die_of_b(item)

    with before_each(die):
        result = call(*run, out)

    assert result.exit_code == 1
    why = (
        f"{footage}/b.png: its worker process died (run it again, with --jobs 1 if memory is short)"
    )
    assert f"roadtorch: failed: {why}\n" in result.stderr
    statuses = {name: row["status"] for name, row in read_index_rows(out).items()}
    assert statuses == {"a.jpg": "done", "b.png": f"failed: {why}", "sub/c.png": "done"}
    assert not list(out.glob(".*.part"))
    assert call(*run, out).exit_code == 0
    assert bytes_in(out) == bytes_in(tmp_path / "quiet")


def test_a_kill_costs_the_image_in_hand_and_leaves_nothing(
    run: Call, out: Path, before_each: BeforeEach
) -> None:
    with before_each(die_of_b):
        process = multiprocessing.get_context("fork").Process(target=run, args=("--jobs", 1))
        process.start()
        process.join()

    assert process.exitcode == -signal.SIGKILL
    assert list(read_index_rows(out)) == ["a.jpg"]
    (out / "sub").mkdir()
    for name in (".roadtorch.0123abcd.part", "sub/.roadtorch.89ef0123.part"):  # of its last writes
        (out / name).write_bytes(b"half")
    assert run().stderr.startswith("roadtorch: 2 done, 1 skipped")
    assert not list(out.rglob("*.part"))


# --- nowhere to write -------------------------------------------------------------------


@pytest.mark.parametrize("is_replaced", [False, True])
def test_an_output_folder_that_was_moved_ends_the_run(
    run: Call, out: Path, before_each: BeforeEach, is_replaced: bool
) -> None:
    def move(item: Item) -> None:
        if item.name == "b":
            out.rename(out.with_name("moved"))
            if is_replaced:
                out.mkdir()

    with before_each(move):
        result = run("--jobs", 1)

    assert result.exit_code == 1
    assert f"error: {out}: was moved during the run" in result.stderr
    assert out.exists() == is_replaced
    assert list(read_index_rows(out.with_name("moved"))) == ["a.jpg"]


def test_a_video_that_changes_while_it_is_read_is_partial(
    call: Call, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    video = write_video(tmp_path / "drive.avi", codec="mjpeg")
    conclude = Detector.conclude

    def grow(*parts: Any) -> Any:
        with video.open("ab") as file:
            file.write(b"more")
        return conclude(*parts)

    monkeypatch.setattr(Detector, "conclude", grow)

    result = call("infer", video, *ROWS, "--out", out, "--save", "mask")

    assert result.exit_code == 1
    assert "drive.avi: changed while it was read" in read_index_rows(out)["drive.avi"]["status"]


def test_closed_streams_cost_nothing(footage: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "roadtorch", "infer", footage.name, *ROWS, "--out", "out"]
    words = ["sh", "-c", f"{' '.join(command)} 0<&- 1>&- 2>&-"]

    ended = subprocess.run(words, cwd=tmp_path, timeout=600, check=False)

    assert ended.returncode == 0
    assert [row["status"] for row in read_index_rows(tmp_path / "out").values()] == ["done"] * 3
