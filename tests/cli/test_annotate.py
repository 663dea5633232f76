"""roadtorch annotate on the command line: everything but the page."""

import sys
from pathlib import Path

import pytest

from roadtorch.annotate.server import PageServer
from roadtorch.annotate.session import open_session
from roadtorch.base.atomic import lock_folder
from roadtorch.cli.annotate import LABEL_FORMAT
from roadtorch.data import correction_formats
from roadtorch.data.corrections import read_corrections, read_logs
from roadtorch.data.events import Confirm
from roadtorch.detectors.catalogue import load_detector
from tests.command import Call, files_in

QUICK = ("--detector", "prior:triangle")


@pytest.fixture
def corrected(footage: Path) -> Path:
    """Confirm the labels of one image of the footage."""
    out = footage / "corrections"
    out.mkdir()
    session = open_session(footage, out, load_detector("prior:triangle"))
    session.add("sub/c.png", Confirm(kind="confirm", id="a", seconds=12.0))
    return footage


@pytest.fixture
def not_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def run(self: PageServer) -> None:
        self._listening.close()

    monkeypatch.setattr(PageServer, "run", run)


@pytest.mark.parametrize(
    ("kind", "name"),
    [("png", "road/sub/c.png"), ("coco", "coco.json"), ("png", "labels/sub/c.png")],
)
def test_an_export_replaces_no_file_of_others(
    call: Call, corrected: Path, tmp_path: Path, kind: str, name: str
) -> None:
    words = ("annotate", corrected, "--export", kind, "--to")
    (tmp_path / "out" / name).parent.mkdir(parents=True)
    (tmp_path / "out" / name).touch()

    refused = call(*words, tmp_path / "out")

    assert (refused.exit_code, files_in(tmp_path / "out")) == (2, {name})
    assert f"{name}: exists and was not written by roadtorch" in refused.stderr
    for _ in range(2):
        assert call(*words, tmp_path / "new").exit_code == 0


@pytest.mark.usefixtures("not_run")
def test_the_address_is_printed(call: Call, footage: Path) -> None:
    result = call("annotate", footage, *QUICK)
    assert result.exit_code == 0, result.stderr
    first, second = result.stdout.splitlines()
    assert first == f"3 images; corrections are saved in {footage / 'corrections'}"
    assert second.startswith("Open http://127.0.0.1:")
    assert call("annotate", footage, *QUICK).stdout.splitlines()[1] == second


def test_packages_are_missing(call: Call, footage: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "roadtorch.annotate.server")
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    result = call("annotate", footage, *QUICK)
    assert "pip install 'roadtorch[annotate]'" in result.stderr


def test_two_at_once_are_refused(call: Call, footage: Path) -> None:
    (footage / "corrections").mkdir()
    with lock_folder(footage / "corrections"):
        result = call("annotate", footage, *QUICK)
    assert "another run is writing here" in result.stderr


def test_report_export_and_import(call: Call, corrected: Path, tmp_path: Path) -> None:
    result = call("annotate", corrected, "--report")
    assert result.exit_code == 0, result.stderr
    assert "1 image, 1 confirmed; 0 clicks, 0.2 minutes" in result.stdout
    result = call("annotate", corrected, "--export", "coco", "--to", tmp_path / "coco")
    assert result.stdout == f"1 image written to {tmp_path / 'coco'}\n"
    second = tmp_path / "second"
    words = ("--out", second, "--import", "coco", "--from", tmp_path / "coco")
    for _ in range(2):  # the same labels a second time are no event
        result = call("annotate", corrected, *words)
        assert result.stdout == "1 image imported\n", result.stderr
    (exported,), (imported,) = read_corrections(corrected / "corrections"), read_corrections(second)
    assert (exported.labels == imported.labels).all()
    assert imported.image == exported.image
    assert [len(log.events) for log in read_logs(second)] == [1]


def test_formats_are_those_that_there_are() -> None:
    assert tuple(correction_formats.CORRECTION_FORMATS) == tuple(LABEL_FORMAT.choices)
