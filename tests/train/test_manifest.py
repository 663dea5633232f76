"""The manifest of the training pictures: written, checked, and that of the shipped weights."""

from collections import Counter
from hashlib import sha256
from pathlib import Path

import pytest

from roadtorch.inputs.pictures import find_pictures
from roadtorch.io.image import write_jpeg
from roadtorch.scenes.street import render_scene
from train.manifest import (
    COLUMNS,
    MANIFEST,
    RECORDINGS,
    Differences,
    differences,
    main,
    read_rows,
)


@pytest.fixture
def street(tmp_path: Path) -> Path:
    """A folder of three pictures of two recordings."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for number, name in enumerate(("one_0001", "one_0002", "two_town_0001")):
        write_jpeg(folder / f"{name}.jpg", render_scene(number, 48, 64).image)
    (tmp_path / RECORDINGS).write_text("recording,terms\none,CC0\ntwo_town,unknown\n")
    return folder


def run(name: str, street: Path) -> int:
    return main([name, str(street), "--manifest", str(street.with_name("told.csv"))])


def test_a_written_manifest_tells_name_size_bytes_and_recording(street: Path) -> None:
    assert run("write", street) == 0

    rows = list(read_rows(street.with_name("told.csv"), "file").values())
    assert tuple(rows[0]) == COLUMNS
    assert [row["recording"] for row in rows] == ["one", "one", "two_town"]
    data = (street / "two_town_0001.jpg").read_bytes()
    values = [rows[2][key] for key in ("file", "bytes", "sha256", "width", "height")]
    assert values == ["two_town_0001.jpg", str(len(data)), sha256(data).hexdigest(), "64", "48"]


def test_the_same_folder_passes_and_every_difference_is_told(
    street: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run("write", street)
    assert run("check", street) == 0
    (street / "one_0001.jpg").unlink()
    same_size = bytearray((street / "one_0002.jpg").read_bytes())
    same_size[-3] ^= 1
    (street / "one_0002.jpg").write_bytes(same_size)
    (street / "new_0001.jpg").write_bytes((street / "two_town_0001.jpg").read_bytes())
    capsys.readouterr()

    assert run("check", street) == 1

    assert capsys.readouterr().out.splitlines() == [
        "missing one_0001.jpg",
        "changed one_0002.jpg",
        "extra new_0001.jpg",
        "1 of 3 pictures are the same; 1 missing, 1 changed, 1 extra",
    ]


@pytest.mark.parametrize(
    ("command", "file", "text", "message"),
    [
        (
            "write",
            RECORDINGS,
            "recording,terms\none,CC0\n",
            "has no row for the recording two_town",
        ),
        ("check", "told.csv", None, "cannot be read"),
        ("check", "told.csv", "hello\nthere\n", "has no column file"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused_in_a_line(
    command: str,
    file: str,
    text: str | None,
    message: str,
    street: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if text is not None:
        street.with_name(file).write_text(text)

    assert run(command, street) == 2

    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"roadtorch: error: {street.with_name(file)}: {message}")
    assert command == "check" or not street.with_name("told.csv").exists()


# --- the shipped one --------------------------------------------------------------------


def test_every_recording_has_its_source_and_terms() -> None:
    counted = Counter(row["recording"] for row in read_rows(MANIFEST, "file").values())
    told = read_rows(MANIFEST.with_name(RECORDINGS), "recording")

    assert {name: int(row["pictures"]) for name, row in told.items()} == counted
    assert all(row["source"] and row["terms"] and row["use"] for row in told.values())


@pytest.mark.data
def test_the_pictures_at_hand_are_those_of_the_manifest(data_root: Path) -> None:
    pictures = find_pictures([data_root / "unlabelled"])

    assert differences(read_rows(MANIFEST, "file"), pictures) == Differences((), (), ())
