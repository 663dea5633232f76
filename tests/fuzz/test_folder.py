"""A night's footage as it comes: all good pictures are done, whatever lies beside them."""

import csv
import os
import subprocess
import sys
from pathlib import Path
from random import Random

from roadtorch.base.bounded import printable
from tests.fuzz.pictures import scene

SUFFIXES = (".jpg", ".png", ".tif", ".webp", ".bmp")
GOOD, DAMAGED = 10, 40


def write_folder(folder: Path) -> set[str]:
    """Good pictures among damaged ones and what is none at all; the names of the good ones."""
    folder.mkdir()
    draw = Random(1)
    names = {f"g{number:02d}{SUFFIXES[number % len(SUFFIXES)]}" for number in range(GOOD)}
    for name in names:
        scene(0).resize((64, 48)).save(folder / name)
    whole = [(folder / name).read_bytes() for name in sorted(names)]
    for number in range(DAMAGED):
        data = bytearray(draw.choice(whole))
        for _ in range(draw.randint(1, 8)):
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        (folder / f"n{number:02d}{draw.choice(SUFFIXES)}").write_bytes(data)
    os.mkfifo(folder / "pipe.png")
    (folder / "zero.png").symlink_to("/dev/zero")
    (folder / "loop.png").symlink_to("loop.png")
    (folder / "gone.png").symlink_to("nowhere.png")
    (folder / "folder.png").mkdir()
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "line\nend.png").write_bytes(b"no picture")
    (folder / os.fsdecode(b"z\xff.jpg")).write_bytes(b"no picture")
    return names


def test_all_good_pictures_are_done_and_every_refusal_names_its_file(tmp_path: Path) -> None:
    names = write_folder(tmp_path / "in")
    words = ["infer", tmp_path / "in", "--detector", "grey-uniformity", "--out", tmp_path / "out"]

    ended = subprocess.run(
        [sys.executable, "-m", "roadtorch", *words, "--quiet"],
        timeout=300, check=False, stderr=subprocess.DEVNULL,
    )  # fmt: skip

    with (tmp_path / "out" / "index.csv").open(newline="", encoding="utf-8") as file:
        found = {row["file"]: row["status"] for row in csv.DictReader(file)}
    good = {found.pop(printable(name)) for name in names}
    failed = {file: told for file, told in found.items() if told.startswith("failed")}
    assert not any(status.startswith("failed") for status in good)
    assert ended.returncode == 1
    assert {"pipe.png", "zero.png", "loop.png", r"z\xff.jpg", "line\nend.png"} <= set(failed)
    assert [file for file, told in failed.items() if " ".join(file.split()) not in told] == []
