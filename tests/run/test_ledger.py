"""index.csv: rows are appended, sorted at the end, and a row that is cut counts for nothing."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest

from roadtorch.base.errors import InputError
from roadtorch.run import ledger as module
from roadtorch.run.ledger import (
    COLUMNS,
    Method,
    Row,
    failed_row,
    open_ledger,
    read_index,
    write_index,
)

HEAD = ",".join(COLUMNS) + "\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "index.csv"


def test_rows_are_appended_as_they_come_and_sorted_at_the_end(path: Path) -> None:
    with open_ledger(path) as ledger:
        for count, name in enumerate(("c", "a", "b"), 1):
            ledger.add(Row(name))
            assert len(path.read_text().splitlines()) == 1 + count
        ledger.add(Row("c", status="failed: x"))
        assert [line[0] for line in path.read_text().splitlines()[1:]] == [*"cabc"]

    assert [line[0] for line in path.read_text().splitlines()[1:]] == [*"abc"]
    assert read_index(path)["c"].status == "failed: x"  # the last one counts


def test_the_end_comes_after_an_error_too_and_a_cut_row_counts_for_nothing(path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), open_ledger(path) as ledger:  # noqa: PT012
        ledger.add(Row("b"))
        ledger.add(Row("a"))
        raise KeyboardInterrupt
    assert [*read_index(path)] == ["a", "b"]

    whole = path.read_bytes()
    for cut in range(1, len(whole) - len(HEAD)):
        path.write_bytes(whole[:-cut])
        assert [*read_index(path)] == ["a"] * (whole[:-cut].count(b"\n") > 1)
    with open_ledger(path):  # what is left of it is mended
        pass
    assert path.read_text() == HEAD


@pytest.mark.parametrize(
    "text", ["name,price\napple,3\n", "width,file\n1\n", HEAD + "a,b\n", "\xff"]
)
def test_what_is_no_index_of_ours_is_refused(path: Path, text: str) -> None:
    path.write_bytes(text.encode("latin-1"))

    with pytest.raises(InputError, match=r"index\.csv: is not an index of ours"):
        read_index(path)


@pytest.mark.parametrize("name", ["=1+1.png", "+a", "-a", "@a", "\t=a", "'=a", "''@", "'"])
def test_a_name_is_no_formula_for_spreadsheets_and_comes_back(name: str, path: Path) -> None:
    write_index(path, [Row(name, ms="-3")])

    cells = next(csv.DictReader(io.StringIO(path.read_text(), newline="")))

    assert (cells["file"], cells["ms"]) == (f"'{name}", "-3")
    assert read_index(path) == {name: Row(name, ms="-3")}
    names = ("a\rb", "a\r\nb", 'a,"b\r', "ö")
    rows = {name: Row(name, status=f"failed: {name}") for name in names}
    write_index(path, rows.values())
    assert read_index(path) == rows


def test_kinds_of_one_method_and_the_same_bytes_add_up(path: Path) -> None:
    first = Row("a", saved="likelihood mask", method="m", sha256="s")
    with open_ledger(path) as ledger:
        for change, saved in [
            ({"saved": "mask cues"}, "likelihood mask cues"),
            ({"saved": "npy", "sha256": "other"}, "npy"),
            ({"saved": "json", "method": "other"}, "json"),
        ]:
            ledger.add(replace(first, method="none"))
            ledger.add(first)
            ledger.add(replace(first, **change))
            assert ledger.rows["a"].saved == saved


def test_frames_of_a_source_are_forgotten_and_nothing_else(path: Path) -> None:
    names = ["drive/000001", "drive/1000000", "drive/x.png", "drive/01", "drive.mp4", "b/000001"]
    with open_ledger(path) as ledger:
        for name in names:
            ledger.add(Row(name))
        ledger.forget_frames("drive")
        assert [*ledger.rows] == names[2:]
        ledger.forget_frames("b")

    assert [*read_index(path)] == sorted(names[2:5])


def test_a_full_disk_is_one_error_and_rows_stay(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ledger = module.Ledger(path)
    ledger.add(Row("a"))
    ledger.path = Path("/dev/full")

    with pytest.raises(InputError, match=r"cannot be written: No space left .* \(make room"):
        ledger.add(Row("b"))

    assert [*read_index(path)] == ["a"]


def test_a_method_covers_what_it_made() -> None:
    method = Method("key", ("mask", "npy"))
    row = method.made(Row("a", sha256="s"))

    assert (row.saved, row.method) == ("mask npy", "key")
    assert method.covers(row)
    assert Method("key", ("npy",)).covers(row)
    assert not Method("key", ("npy", "cues")).covers(row)
    assert not Method("another", ("npy",)).covers(row)
    assert not method.covers(None)
    failed = failed_row("a", ValueError("oh\nno"))
    assert failed.status == "failed: oh no"
    assert method.made(failed) == failed
    assert not method.covers(replace(row, status="partial: x"))
