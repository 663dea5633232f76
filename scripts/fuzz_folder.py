"""A night's footage as it comes: are all good pictures done, whatever lies beside them?

    python scripts/fuzz_folder.py                     # 40 good ones among 400 that are not
    python scripts/fuzz_folder.py --count 4000 --out fuzzed-night

Writes whole pictures, tampered ones, and what is no picture at all (pipes, devices, links to
themselves, folders, names that are not UTF-8) into one folder, runs ``roadtorch infer`` over it,
and reads index.csv: the good ones are done, every other row is done or failed by its name.
"""

import argparse
import csv
import os
import random
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadtorch.io.bounded import printable
from scripts.fuzz_bytes import BYTES, mutated
from scripts.fuzz_pictures import resize, scene, whole_picture

GOOD, COUNT, SEED, SECONDS = 40, 400, 0, 1_800
SUFFIXES = (".jpg", ".png", ".tif", ".webp", ".bmp")
DETECTOR = "grey-uniformity"


class Night(NamedTuple):
    """What came of a folder: statuses of good and of other files, by name, and the exit code."""

    good: dict[str, str]
    others: dict[str, str]
    code: int

    @property
    def done(self) -> int:
        """How many of the good pictures are done."""
        return sum(not status.startswith("failed") for status in self.good.values())

    @property
    def unnamed(self) -> list[str]:
        """Files whose refusal does not name them."""
        failed = {file: told for file, told in self.others.items() if told.startswith("failed")}
        return [file for file, told in failed.items() if " ".join(file.split()) not in told]


def write_folder(folder: Path, good: int, count: int, seed: int) -> set[str]:
    """Write ``good`` whole pictures among ``count`` tampered ones and odd files; their names."""
    folder.mkdir(parents=True)
    draw = random.Random(seed)
    for number in range(count):
        data = mutated(whole_picture(draw), draw, (*BYTES, resize))
        (folder / f"n{number:05d}{draw.choice(SUFFIXES)}").write_bytes(data)
    names = {f"g{number:05d}{SUFFIXES[number % len(SUFFIXES)]}" for number in range(good)}
    for number, name in enumerate(sorted(names)):
        scene(number % 4).resize((64, 48)).save(folder / name)
    _write_odd_files(folder)
    return names


def _write_odd_files(folder: Path) -> None:
    os.mkfifo(folder / "pipe.png")
    (folder / "zero.png").symlink_to("/dev/zero")
    (folder / "loop.png").symlink_to("loop.png")
    (folder / "gone.png").symlink_to("nowhere.png")
    (folder / "folder.png").mkdir()
    (folder / "empty.jpg").write_bytes(b"")
    (folder / "line\nend.png").write_bytes(b"no picture")
    (folder / os.fsdecode(b"z\xff.jpg")).write_bytes(b"no picture")


def run(folder: Path, out: Path, names: set[str], seconds: float = SECONDS) -> Night:
    """Run ``infer`` over the folder; TimeoutExpired where it hangs."""
    words = [sys.executable, "-m", "roadtorch", "infer", folder, "--detector", DETECTOR]
    ended = subprocess.run(
        [*words, "--out", out, "--quiet"], timeout=seconds, check=False, stderr=subprocess.DEVNULL
    )
    with (out / "index.csv").open(newline="", encoding="utf-8") as file:
        found = {row["file"]: row["status"] for row in csv.DictReader(file)}
    good = {name: found.pop(printable(name), "failed: not in the index") for name in names}
    return Night(good, found, ended.returncode)


def main(words: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--good", type=int, default=GOOD)
    options.add_argument("--count", type=int, default=COUNT, help="tampered ones beside them")
    options.add_argument("--seed", type=int, default=SEED)
    options.add_argument("--out", type=Path, default=Path("fuzzed-night"))
    chosen = options.parse_args(words)
    names = write_folder(chosen.out / "footage", chosen.good, chosen.count, chosen.seed)
    night = run(chosen.out / "footage", chosen.out / "roads", names)
    failed = sum(status.startswith("failed") for status in night.others.values())
    print(f"{night.done} of {len(night.good)} good pictures done; exit status {night.code}")
    print(f"of {len(night.others)} others {len(night.others) - failed} done, {failed} refused")
    print(f"refusals that do not name their file: {len(night.unnamed)}")
    return 0 if night.done == len(night.good) and not night.unnamed else 1


if __name__ == "__main__":
    sys.exit(main())
