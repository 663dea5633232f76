"""Runs that are cut short, meet each other, or are started again in another way."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest
import torch

from roadtorch.detectors import catalogue
from roadtorch.errors import InputError
from roadtorch.io.atomic import reserved
from roadtorch.io.image import write_mask
from roadtorch.runs import index, pictures, results
from tests.command import ROWS, Call, bytes_in, files_in, rows_of, save_picture

BeforeEach = Callable[[Callable[[pictures.Job], None]], AbstractContextManager[None]]


@pytest.fixture
def before_each(monkeypatch: pytest.MonkeyPatch) -> BeforeEach:
    """``with before_each(act):`` within the block, ``infer`` acts before each picture."""
    real = results.Inference.__call__

    @contextmanager
    def acting(act: Callable[[pictures.Job], None]) -> Iterator[None]:
        def acted(self: results.Inference, job: pictures.Job) -> index.Row:
            act(job)
            return real(self, job)

        with monkeypatch.context() as inner:
            inner.setattr(results.Inference, "__call__", acted)
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
    assert again.stderr == f"roadtorch: 3 done (3 anew); results in {out}\n"
    assert bytes_in(tmp_path / "alone").items() <= bytes_in(out).items()
    for nothing_new in (third, fewer):
        assert nothing_new.stderr.startswith("roadtorch: 0 done, 3 skipped")


@pytest.mark.parametrize("what", ["settings", "version", "old rows"])
def test_results_made_otherwise_are_done_anew_even_without_their_config(
    run: Call, out: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    run()
    if what == "settings":
        (out / "config.toml").unlink()
    elif what == "version":
        monkeypatch.setattr(pictures, "__version__", "99.0")
    else:  # of a version that did not note the method
        lines = (out / "index.csv").read_text().splitlines()
        (out / "index.csv").write_text("".join(line.rsplit(",", 4)[0] + "\n" for line in lines))

    again = run(*(("--threshold", "0.9") if what == "settings" else ()))

    assert again.stderr.startswith("roadtorch: 3 done (3 anew);")


@pytest.mark.parametrize("what", ["picture", "file of the settings"])
def test_other_bytes_are_done_anew_even_with_the_same_date_and_size(
    call: Call, tmp_path: Path, out: Path, what: str
) -> None:
    picture, ego = save_picture(tmp_path / "x.bmp", 0), tmp_path / "ego.png"
    write_mask(ego, torch.arange(48)[:, None].expand(48, 64) > 40)
    run = ("infer", picture, *ROWS, "--set", f"ego.mask={ego}", "--out", out)
    call(*run)
    before = picture.stat()
    if what == "picture":
        save_picture(picture, 1)
        os.utime(picture, ns=(before.st_atime_ns, before.st_mtime_ns))
    else:
        write_mask(ego, torch.arange(48)[:, None].expand(48, 64) > 30)

    again = call(*run)

    assert picture.stat().st_size == before.st_size
    assert again.stderr.startswith("roadtorch: 1 done (1 anew);")


@pytest.mark.parametrize(
    ("kind", "gone"), [("cues", "b.cue.uniformity.png"), ("npy", "b.uniformity.npy")]
)
def test_files_of_cues_that_were_removed_are_made_again(
    call: Call, footage: Path, out: Path, kind: str, gone: str
) -> None:
    words = ("infer", footage, "--detector", "grey-uniformity", "--out", out, "--save")
    call(*words, f"mask,{kind}")
    before = bytes_in(out)
    (out / gone).unlink()

    fewer, again = call(*words, "mask"), call(*words, f"mask,{kind}")

    assert fewer.stderr.startswith("roadtorch: 0 done, 3 skipped")
    assert again.stderr.startswith("roadtorch: 1 done (1 anew), 2 skipped")
    assert bytes_in(out) == before


# --- one folder -------------------------------------------------------------------------


def test_a_second_run_into_the_same_folder_is_refused(run: Call, out: Path) -> None:
    out.mkdir()
    handle = os.open(out, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)

    refused = run()
    os.close(handle)

    assert refused.exit_code == 2
    assert refused.stderr.startswith(f"roadtorch: error: {out}: another run is writing here (")
    assert run().exit_code == 0


@pytest.mark.parametrize(("place", "gone"), [("a", 0), ("sub/c", 2)], ids=["early", "last"])
def test_a_folder_that_is_removed_meanwhile_is_told(
    call: Call,
    run: Call,
    footage: Path,
    tmp_path: Path,
    out: Path,
    before_each: BeforeEach,
    place: str,
    gone: int,
) -> None:
    call("infer", footage, *ROWS, "--out", tmp_path / "quiet")

    def remove(job: pictures.Job) -> None:
        if job.picture.name == place:
            shutil.rmtree(out)

    with before_each(remove):
        result = run()

    assert result.exit_code == (1 if gone else 0)
    assert result.stderr.count("results were removed while the run went on") == gone
    assert f"{3 - gone} done" in result.stderr
    assert run().exit_code == 0
    assert bytes_in(out) == bytes_in(tmp_path / "quiet")


def test_names_with_line_ends_and_long_ones_are_done_once(
    run: Call, footage: Path, out: Path
) -> None:
    for name in ("a\rb.png", "a\r\nb.png", "\r.png", "n" * 230 + ".png"):
        save_picture(footage / name)

    first, again = run(), run()

    assert first.exit_code == again.exit_code == 0
    assert again.stderr.startswith("roadtorch: 0 done, 7 skipped")
    assert len(rows_of(out)) == 7


# --- killed -----------------------------------------------------------------------------


def test_what_a_killed_run_left_is_removed_by_the_next(run: Call, out: Path) -> None:
    run()
    clean = files_in(out)
    for name in (".roadtorch.0123abcd.part", "sub/.roadtorch.89ef0123.part"):
        (out / name).write_bytes(b"half")

    run()

    assert files_in(out) == clean


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)], ids=["TERM", "INT"]
)
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_signal_ends_the_run_with_index_and_message(
    run: Call, out: Path, before_each: BeforeEach, number: signal.Signals, code: int, jobs: str
) -> None:
    this = os.getpid()

    def send(job: pictures.Job) -> None:
        if job.picture.name == "a":  # in a worker, if there are several
            os.kill(this, number)

    with before_each(send):
        stopped = run("--jobs", jobs)
    record = json.loads((out / "run.json").read_text())

    assert stopped.exit_code == record["exit_status"] == code
    assert record["pictures"]["not_tried"] == 2
    assert "roadtorch: interrupted; what was finished is kept" in stopped.stderr
    assert run().stderr.startswith("roadtorch: 2 done, 1 skipped")


def test_a_kill_costs_little_more_than_the_picture_in_hand(footage: Path, out: Path) -> None:
    code = (
        "import os, signal\n"
        "from roadtorch.cli import main\n"
        "from roadtorch.runs import results\n"
        "real = results.Inference.__call__\n"
        "def act(self, job):\n"
        "    if job.picture.name == 'b': os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return real(self, job)\n"
        "results.Inference.__call__ = act\n"
        "main()"
    )
    words = [sys.executable, "-c", code, "infer", footage, *ROWS, "--out", out]

    subprocess.run(words, timeout=120, check=False)

    assert list(rows_of(out)) == ["a.jpg"]


def test_a_signal_before_the_work_is_told(run: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        os.kill(os.getpid(), signal.SIGTERM)

    monkeypatch.setattr(catalogue, "load_detector", stop)

    ended = run()

    assert ended.exit_code == 143
    assert ended.stderr.strip() == "roadtorch: interrupted; what was finished is kept"


# --- nowhere to write -------------------------------------------------------------------


@pytest.mark.parametrize("closed", ["2>&-", "0<&- 1>&- 2>&-"])
def test_closed_streams_cost_nothing(footage: Path, tmp_path: Path, closed: str) -> None:
    command = [sys.executable, "-m", "roadtorch", "infer", footage.name, *ROWS, "--out", "out"]
    words = ["sh", "-c", f"{' '.join(command)} {closed}"]

    ended = subprocess.run(words, cwd=tmp_path, timeout=120, check=False)

    assert ended.returncode == 0
    assert [row["status"] for row in rows_of(tmp_path / "out").values()] == ["done"] * 3


def test_a_full_disk_does_not_cost_the_index(
    run: Call, out: Path, before_each: BeforeEach, monkeypatch: pytest.MonkeyPatch
) -> None:
    full: list[int] = []
    real = index.write_index

    def write(path: Path, rows: object) -> None:
        if full:
            raise InputError(path, "cannot be written: No space left on device", "make room")
        real(path, rows)  # type: ignore[arg-type]

    @contextmanager
    def held(folder: Path, size: int) -> Iterator[Callable[[], None]]:
        with reserved(folder, size) as let_go:
            yield lambda: (full.clear(), let_go())[0]

    monkeypatch.setattr(index, "write_index", write)
    monkeypatch.setattr(pictures, "reserved", held)
    with before_each(lambda _: full.append(1)):
        result = run()

    assert result.exit_code == 0
    assert len(rows_of(out)) == 3
