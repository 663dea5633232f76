"""Free images: gathered by their bytes, taken from the recordings in turn."""

import csv
from hashlib import sha256
from itertools import chain
from pathlib import Path

import pytest

from roadtorch.base.atomic import file_digest
from roadtorch.layout.weights import read_origin, shipped_weights
from scripts.benchmark import BENCHMARK
from train.free_images import STREET_IMAGES, main, recordings, round_robin

FREE_IMAGES = STREET_IMAGES.with_name("free_images.csv")


@pytest.fixture
def manifest(tmp_path: Path) -> Path:
    """Write three images of one recording and one of a folder, one of which has changed."""
    files = {"one_1.jpg": b"a", "one_2.jpg": b"b", "one_3.jpg": b"c", "two/x.jpg": b"d"}
    rows = [f"{name},{sha256(data).hexdigest()},r,p,MIT" for name, data in files.items()]
    path = tmp_path / "list.csv"
    path.write_text("\n".join(["file,sha256,repo,path,licence", *rows]) + "\n")
    for name, data in files.items():
        place = tmp_path / "data" / "deep" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(b"changed" if name == "one_3.jpg" else data)
    return tmp_path


def test_they_are_gathered_by_recording(manifest: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [manifest / "data", "--out", manifest / "out", "--list", manifest / "list.csv"]
    status = main([str(word) for word in folders])

    assert status == 1
    assert capsys.readouterr().out.splitlines() == ["missing one_3.jpg", "1 missing"]
    files = {path.name: path.read_bytes() for path in (manifest / "out").iterdir()}
    assert files == {"one_0001.jpg": b"a", "one_0002.jpg": b"b", "two_0001.jpg": b"d"}


def test_the_weights_to_the_letter_saw_as_many_as_the_paper_has() -> None:
    chosen = list(round_robin(recordings(FREE_IMAGES), 500, {"vineyard_it", "dnit_br", "comma10k"}))

    assert read_origin(shipped_weights("cnn-7-paper"))["images"] == len(chosen) == 500
    assert sum("/" in row["file"] for _, row in chosen) == 142


@pytest.mark.data
def test_the_images_of_the_street_runs_are_those_listed_and_none_of_the_fourteen_cameras(
    data_root: Path,
) -> None:
    listed = chain.from_iterable(recordings(STREET_IMAGES).values())
    hashes = {row["sha256"] for row in listed if row["licence"]}
    files = {row["sha256"] for row in csv.DictReader(BENCHMARK.read_text().splitlines())}

    assert {file_digest(path) for path in data_root.glob("unlabelled_free/*.jpg")} == hashes
    assert not hashes & files
