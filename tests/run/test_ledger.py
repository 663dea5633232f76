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
from roadtorch.run import memo
from roadtorch.run.ledger import (
    INDEX_COLUMNS,
    IndexRow,
    Ledger,
    failed_row,
    has_result,
    open_ledger,
    read_index,
    write_index,
)
from roadtorch.run.memo import (
    cache_key,
    file_digests,
    find_paths,
    make_cached_reader,
    read_cached,
    write_arrays,
    write_cached,
)

HEAD = ",".join(INDEX_COLUMNS) + "\n"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "index.csv"


def test_rows_are_appended_as_they_come_and_sorted_at_the_end(path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), open_ledger(path.parent, "") as ledger:  # noqa: PT012
        for count, name in enumerate(("c", "a", "b"), 1):
            ledger.add(IndexRow(name))
            assert len(path.read_text().splitlines()) == 1 + count
        ledger.add(IndexRow("c", status="failed: x"))
        assert [line[0] for line in path.read_text().splitlines()[1:]] == [*"cabc"]
        raise KeyboardInterrupt

    assert [line[0] for line in path.read_text().splitlines()[1:]] == [*"abc"]
    assert read_index(path)["c"].status == "failed: x"  # the last one counts


def test_a_cut_row_counts_for_nothing(path: Path) -> None:
    with open_ledger(path.parent, "") as ledger:
        ledger.add(IndexRow("a"))
        ledger.add(IndexRow("b"))
    whole = path.read_bytes()

    for cut in range(1, len(whole) - len(HEAD)):
        path.write_bytes(whole[:-cut])
        assert [*read_index(path)] == ["a"] * (whole[:-cut].count(b"\n") > 1)
    path.write_bytes(codecs.BOM_UTF8 + path.read_bytes())  # by a spreadsheet
    with open_ledger(path.parent, ""):  # a cut row is dropped
        pass
    assert path.read_text() == HEAD
    with open_ledger(path.parent, "a = 1"):  # nothing was done with other settings
        assert (path.parent / "config.toml").read_text() == "a = 1\n"


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
    ledger = Ledger(path.parent, {name: IndexRow(name) for name in names})

    ledger.drop_frames("drive")

    assert [*ledger.rows] == names[2:]


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
    for name in ("a.mask.png", "a.x.npy", "a.road/metadata.yaml"):  # the list of a bag
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    row = replace(IndexRow("a.png", saved="mask npy", method="key", sha256="s"), **change)
    ledger = Ledger(tmp_path, {row.file: row})

    assert ledger.is_done(item, key, kinds, [".mask.png", ".{}.npy", ".road"]) == is_done
    assert not ledger.is_done(item, key, kinds, [".mask.png", ".likelihood.npy"])
    assert not ledger.is_done(replace(item, digest=None), key, kinds, [".mask.png"])
    (tmp_path / "a.road/metadata.yaml").unlink()
    assert not has_result(tmp_path, "a.road")


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
    assert [*(read_cached(path, cache_key("a"), "sums") or ())] == ["sums"]
    assert read_cached(path, cache_key("b")) is None
    assert read_cached(path, cache_key("a"), "none") is None
    assert [file.name for file in path.parent.iterdir()] == ["x.npz"]
    path.write_bytes(path.read_bytes()[:-30])
    assert read_cached(path, cache_key("a")) is None
    write_arrays(path, ARRAYS)  # without a key
    assert read_cached(path, None) is None
    read = make_cached_reader()
    assert read(path) is read(path)


def test_an_archive_without_members_is_damaged(tmp_path: Path) -> None:
    (tmp_path / "x.npz").write_bytes(b"PK\5\6" + bytes(18))

    with pytest.raises(InputError, match=r"x\.npz: is damaged \(remove it; it will be made again"):
        memo.read_arrays(tmp_path / "x.npz")


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


def test_files_are_found_in_nested_settings(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("a")
    settings = {"a": str(file), "b": {"c": [file, "none"], "d": 3, "e": ""}, "f": str(tmp_path)}

    assert find_paths(settings) == [file, file, tmp_path]
    assert file_digests(settings) == 2 * [file_digest(file)]
    assert [path.name for path in find_paths({"w": "cnn-7"})] == ["cnn-7.safetensors"]
