"""roadtorch annotate on the command line: everything but the page."""

import json
from pathlib import Path

import pytest

from roadtorch.annotate.serving import PageServer, bound_socket, opened_session
from roadtorch.data.corrections import read_corrections
from roadtorch.data.events import Confirm
from roadtorch.detectors.catalogue import load_detector
from tests.command import Call

QUICK = ("--detector", "prior:triangle")


@pytest.fixture
def corrected(footage: Path) -> Path:
    """The footage with one picture said to be right."""
    out = footage / "corrections"
    out.mkdir()
    session = opened_session(footage, out, load_detector("prior:triangle"))
    session.add("sub/c.png", "ann", Confirm(kind="right", id="a", seconds=12.0))
    return footage


@pytest.fixture
def not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(self: PageServer) -> None:
        self._listening.close()

    monkeypatch.setattr(PageServer, "run", run)


@pytest.mark.usefixtures("not_run")
def test_the_address_is_printed(call: Call, footage: Path) -> None:
    result = call("annotate", footage, *QUICK)
    assert result.exit_code == 0, result.stderr
    first, second = result.stdout.splitlines()
    assert first == f"3 pictures; corrections are kept in {footage / 'corrections'}"
    assert second.startswith("Open http://127.0.0.1:")
    assert call("annotate", footage, *QUICK).stdout.splitlines()[1] == second


def test_a_port_that_is_taken(call: Call, footage: Path) -> None:
    taken = bound_socket(None, None)
    port = taken.getsockname()[1]
    result = call("annotate", footage, *QUICK, "--port", port)
    taken.close()
    assert result.exit_code == 2
    expected = f"roadtorch: error: --port: {port} is taken (give another one, or leave it out)\n"
    assert result.stderr == expected


def test_no_pictures(call: Call, tmp_path: Path) -> None:
    result = call("annotate", tmp_path, *QUICK)
    assert result.exit_code == 2
    assert "holds no pictures" in result.stderr
    result = call("annotate", tmp_path / "missing", *QUICK)
    assert "does not exist" in result.stderr


def test_a_folder_that_cannot_be_written(call: Call, footage: Path) -> None:
    (footage / "corrections").write_text("a file")
    result = call("annotate", footage, *QUICK)
    assert result.exit_code == 2
    assert "corrections: cannot be made a folder" in result.stderr
    assert "give another --out" in result.stderr


def test_the_packages_are_missing(
    call: Call, footage: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "uvicorn", None)
    result = call("annotate", footage, *QUICK)
    assert "pip install 'roadtorch[annotate]'" in result.stderr


def test_two_at_once_are_refused(call: Call, footage: Path) -> None:
    from roadtorch.io.atomic import locked

    (footage / "corrections").mkdir()
    with locked(footage / "corrections"):
        result = call("annotate", footage, *QUICK)
    assert "another run is writing here" in result.stderr


def test_report_export_and_import(call: Call, corrected: Path, tmp_path: Path) -> None:
    result = call("annotate", corrected, "--report")
    assert result.exit_code == 0, result.stderr
    assert "1 pictures, 1 confirmed; 1 clicks, 0.2 minutes" in result.stdout
    result = call("annotate", corrected, "--export", "cvat", "--to", tmp_path / "cvat")
    assert result.stdout == f"1 pictures written to {tmp_path / 'cvat'}\n"
    second = tmp_path / "second"
    result = call(
        *("annotate", corrected, "--out", second, "--import", "cvat"),
        *("--from", tmp_path / "cvat", "--user", "bob"),
    )
    assert result.stdout == "1 pictures brought in as bob\n", result.stderr
    (before,), (after,) = read_corrections(corrected / "corrections"), read_corrections(second)
    assert (before.labels == after.labels).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--export", "cvat"), "Missing option '--to'"),
        (("--import", "cvat"), "Missing option '--from'"),
        (("--export", "coco", "--to", "x"), "coco"),
        (("--import", "xml", "--from", "x", "--user", "a b"), "is no name for a user"),
        (("--import", "xml", "--from", "x"), "has no file for any of the pictures"),
        (("--report", "--out", "nowhere"), "nowhere: is no folder"),
    ],
)
def test_what_is_wrong_is_told(
    call: Call, footage: Path, arguments: tuple[str, ...], words: str
) -> None:
    result = call("annotate", footage, *arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1


def test_formats_are_those_that_there_are() -> None:
    from roadtorch.cli.annotate import FORMATS
    from roadtorch.data import correction_formats

    assert tuple(correction_formats.FORMATS) == FORMATS


def test_the_journal_can_be_read_by_eye(corrected: Path) -> None:
    path = corrected / "corrections/sub/c.png.ann.strokes.jsonl"
    head, event = (json.loads(line) for line in path.read_text().splitlines())
    assert (head["picture"], head["user"]) == ("../sub/c.png", "ann")
    assert (event["kind"], event["seconds"]) == ("right", 12.0)
