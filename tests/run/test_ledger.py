"""index.csv row by row; caches on disk, written whole or not at all."""

import codecs
import csv
import io
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from roadtorch.base.atomic import file_digest
from roadtorch.base.errors import InputError
from roadtorch.detectors.catalogue import load_detector
from roadtorch.inputs.item import Item
from roadtorch.run import ledger as module
from roadtorch.run import memo
from roadtorch.run.ledger import (
    INDEX_COLUMNS,
    IndexRow,
    failed_row,
    open_ledger,
    read_index,
    write_index,
)
from roadtorch.run.memo import (
    cache_key,
    file_digests,
    find_paths,
    make_cached_reader,
    read_arrays,
    read_cached,
    write_cached,
)

HEAD = ",".join(INDEX_COLUMNS) + "\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "index.csv"


def test_rows_are_appended_as_they_come_and_sorted_at_the_end(path: Path) -> None:
    with open_ledger(path.parent, "") as ledger:
        for count, name in enumerate(("c", "a", "b"), 1):
            ledger.add(IndexRow(name))
            assert len(path.read_text().splitlines()) == 1 + count
        ledger.add(IndexRow("c", status="failed: x"))
        assert [line[0] for line in path.read_text().splitlines()[1:]] == [*"cabc"]

    assert [line[0] for line in path.read_text().splitlines()[1:]] == [*"abc"]
    assert read_index(path)["c"].status == "failed: x"  # the last one counts


def test_the_end_comes_after_an_error_too_and_a_cut_row_counts_for_nothing(path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), open_ledger(path.parent, "") as ledger:  # noqa: PT012
        ledger.add(IndexRow("b"))
        ledger.add(IndexRow("a"))
        raise KeyboardInterrupt
    assert [*read_index(path)] == ["a", "b"]

    whole = path.read_bytes()
    for cut in range(1, len(whole) - len(HEAD)):
        path.write_bytes(whole[:-cut])
        assert [*read_index(path)] == ["a"] * (whole[:-cut].count(b"\n") > 1)
    path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())  # by a spreadsheet
    with open_ledger(path.parent, ""):  # a cut row is dropped
        pass
    assert path.read_text() == HEAD


@pytest.mark.parametrize(
    "text", ["name,price\napple,3\n", "width,file\n1\n", HEAD + "a,b\n", "\xff"]
)
def test_what_is_no_index_of_ours_is_refused(path: Path, text: str) -> None:
    path.write_bytes(text.encode("latin-1"))

    with pytest.raises(InputError, match=r"index\.csv: is not an index of roadtorch"):
        read_index(path)


FORMULAS = ["=1+1.png", "+a", "-a", "@a", "\t=a", "'=a", "''@", "'", "\r"]
LINE_ENDS = ["a\rb", "a\nb", "a\r\nb", 'a,"b\r', "x\ty", "ö"]


@pytest.mark.parametrize("name", [*FORMULAS, *LINE_ENDS])
def test_names_stay_and_are_no_formulas_for_spreadsheets(name: str, path: Path) -> None:
    row = IndexRow(name, ms="-3", status=f"failed: {name}")
    write_index(path, [row])

    cells = next(csv.DictReader(io.StringIO(path.read_bytes().decode(), newline="")))

    assert (cells["file"].removesuffix(name), cells["ms"]) == ("'" * (name in FORMULAS), "-3")
    assert read_index(path) == {name: row}


def test_kinds_of_one_method_and_the_same_bytes_add_up(path: Path) -> None:
    first = IndexRow("a", saved="likelihood mask", method="m", sha256="s")
    with open_ledger(path.parent, "") as ledger:
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
    with open_ledger(path.parent, "") as ledger:
        for name in names:
            ledger.add(IndexRow(name))
        ledger.drop_frames("drive")
        assert [*ledger.rows] == names[2:]
        ledger.drop_frames("b")

    assert [*read_index(path)] == sorted(names[2:5])


def test_a_full_disk_is_one_error_and_rows_stay(path: Path) -> None:
    ledger = module.Ledger(path.parent, {})
    ledger.add(IndexRow("a"))
    rows = path.rename(path.with_name("rows.csv"))
    path.symlink_to("/dev/full")

    with pytest.raises(InputError, match=r"cannot be written: No space left .* \(make room"):
        ledger.add(IndexRow("b"))

    assert [*read_index(rows)] == ["a"]


@pytest.mark.parametrize(
    ("change", "key", "kinds", "is_done"),
    [
        ({}, "key", ["mask", "npy"], True),
        ({}, "key", ["npy"], True),
        ({}, "key", ["npy", "cues"], False),
        ({}, "another", ["npy"], False),
        ({"status": "doubtful: x"}, "key", ["npy"], True),
        ({"status": "partial: x"}, "key", ["npy"], False),
        ({"status": failed_row("a", ValueError("oh\nno")).status}, "key", ["npy"], False),
        ({"sha256": "other"}, "key", ["npy"], False),
        ({"cues": "x/y"}, "key", ["npy"], False),  # a.y.npy is gone
        ({"cues": "x"}, "key", ["npy"], True),
        ({"file": "b.png"}, "key", ["npy"], False),
    ],
)
def test_done_is_what_has_its_files_under_the_key_from_the_same_bytes(
    tmp_path: Path, change: dict[str, str], key: str, kinds: list[str], is_done: bool
) -> None:
    item = Item("a", "a.png", lambda: ARRAYS["sums"], lambda: "s", ".png")
    for name in ("a.mask.png", "a.x.npy"):
        (tmp_path / name).touch()
    row = replace(IndexRow("a.png", saved="mask npy", method="key", sha256="s"), **change)
    ledger = module.Ledger(tmp_path, {row.file: row})

    assert ledger.is_done(item, key, kinds, [".mask.png", ".{}.npy"]) == is_done
    assert not ledger.is_done(item, key, kinds, [".mask.png", ".likelihood.npy"])
    assert not ledger.is_done(replace(item, digest=None), key, kinds, [".mask.png"])


# --- memory -----------------------------------------------------------------------------


ARRAYS = {"road": torch.rand(3, 4) > 0.5, "sums": torch.arange(6.0).view(2, 3)}


def test_arrays_come_back_under_their_key_alone(tmp_path: Path) -> None:
    path = tmp_path / "made" / "x.npz"

    write_cached(path, cache_key("a"), ARRAYS)

    for key in (cache_key("a"), None):
        arrays = read_cached(path, key)
        assert arrays is not None
        assert arrays.keys() == ARRAYS.keys()
        assert all(torch.equal(arrays[name], ARRAYS[name]) for name in ARRAYS)
    named = read_cached(path, cache_key("a"), "sums")
    assert named is not None
    assert [*named] == ["sums"]
    assert read_cached(path, cache_key("b")) is None
    assert read_cached(path, cache_key("a"), "none") is None
    assert [file.name for file in path.parent.iterdir()] == ["x.npz"]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"",
        lambda data: b"PK garbage",
        lambda data: data[:-30],
        lambda data: data[:60] + b"\xff" * 20 + data[80:],
        lambda data: b"PK\5\6" + bytes(18),  # the end of an archive without members
    ],
)
def test_a_damaged_file_holds_nothing(tmp_path: Path, change) -> None:
    path = tmp_path / "x.npz"
    write_cached(path, "k", ARRAYS)
    path.write_bytes(change(path.read_bytes()))

    assert read_cached(path, "k") is None
    assert read_cached(tmp_path / "none.npz", "k") is None
    with pytest.raises(InputError, match=r"x\.npz: is damaged \(remove it; it will be made again"):
        read_arrays(path)


def test_arrays_without_a_key_are_not_ours(tmp_path: Path) -> None:
    memo.write_arrays(tmp_path / "x.npz", ARRAYS)

    assert read_cached(tmp_path / "x.npz", None) is None
    read = make_cached_reader()
    assert read(tmp_path / "x.npz") is read(tmp_path / "x.npz")


def test_a_key_changes_with_every_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, folder = tmp_path / "file", tmp_path / "folder"
    (folder / "below").mkdir(parents=True)
    file.write_text("a")
    (folder / "below" / "x").write_text("a")
    keys = [cache_key("a", 1, file, folder)]
    repeated = cache_key("a", 1, file, folder)

    keys += [cache_key("b", 1, file, folder), cache_key("a", 1.0, file, folder)]
    keys += [cache_key("a", 1, folder), cache_key("a1", file, folder)]
    file.write_text("b")
    keys.append(cache_key("a", 1, file, folder))
    (folder / "below" / "x").write_text("b")
    keys.append(cache_key("a", 1, file, folder))
    (folder / "below" / "x").rename(folder / "y")
    keys.append(cache_key("a", 1, file, folder))
    settings = {"a": str(file), "b": {"c": [file, "none"], "d": 3, "e": ""}, "f": str(folder)}
    assert find_paths(settings) == [file, file, folder]
    assert file_digests(settings) == 2 * [file_digest(file)]
    assert [path.name for path in find_paths({"w": "cnn-7"})] == ["cnn-7.safetensors"]
    detector = load_detector("prior:rows")
    keys += [cache_key(detector), cache_key(load_detector("prior:rows", threshold=0.4))]
    changed = load_detector("layout:cnn-7")
    keys.append(cache_key(changed))
    with torch.no_grad():
        next(changed.parameters()).add_(1)
    keys.append(cache_key(changed))
    monkeypatch.setattr(memo, "__version__", "99")
    keys.append(cache_key("a", 1, file, folder))

    assert repeated == keys[0]
    assert len(set(keys)) == len(keys)
    assert {len(key) for key in keys} == {32}
