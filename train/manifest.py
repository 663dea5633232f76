"""What the shipped weights were trained on: every picture by name, size and SHA-256.

    python train/manifest.py check PICTURES
    python train/manifest.py write PICTURES

PICTURES is a folder of street pictures called RECORDING_NUMBER. ``check`` tells which pictures of
train/pictures.csv are missing there, changed, or extra, and exits with 1 if any is. ``write`` makes
that file anew; every recording needs a row in recordings.csv beside it: where its pictures are
from, and on what terms. docs/research/training_data.md says what the weights were trained on.
"""

import argparse
import csv
import sys
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from roadtorch.errors import InputError, RoadtorchError
from roadtorch.inputs.item import Item
from roadtorch.inputs.pictures import find_pictures
from roadtorch.io.atomic import csv_text, write_text
from roadtorch.io.image import read_image
from roadtorch.train.folder import pictures_hash
from roadtorch.train.prepared import name_of
from roadtorch.train.recordings import recording_of

MANIFEST = Path(__file__).with_name("pictures.csv")
RECORDINGS = "recordings.csv"
SEPARATOR = "_"
"""What stands before the number in a name: ``recordings.separator`` of the training configs."""

COLUMNS = ("file", "bytes", "sha256", "width", "height", "recording")


class Differences(NamedTuple):
    """Names of pictures that a folder lacks, has with other bytes, or has besides."""

    missing: tuple[str, ...]
    changed: tuple[str, ...]
    extra: tuple[str, ...]


def fingerprint(path: Path) -> str:
    """SHA-256 of a file's bytes. Raises InputError when it cannot be read."""
    try:
        return sha256(path.read_bytes()).hexdigest()
    except OSError as problem:
        raise InputError(path, f"cannot be read: {problem.strerror}", "check the file") from None


def manifest_row(picture: Item) -> dict[str, object]:
    """The row of one picture. Raises InputError when it is no picture."""
    height, width = read_image(picture.path).shape[-2:]
    size, digest = picture.path.stat().st_size, fingerprint(picture.path)
    recording = recording_of(picture.name, SEPARATOR)
    values = (name_of(picture), size, digest, width, height, recording)
    return dict(zip(COLUMNS, values, strict=True))


def read_rows(path: Path, key: str) -> dict[str, Mapping[str, str]]:
    """The rows of a CSV file by the column ``key``. Raises InputError for a file without it."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return {row[key]: row for row in csv.DictReader(file)}
    except OSError as problem:
        raise InputError(path, f"cannot be read: {problem.strerror}", "check the file") from None
    except KeyError:
        raise InputError(path, f"has no column {key}", "give a file of write") from None


def check_recordings(rows: Sequence[Mapping[str, object]], path: Path) -> None:
    """InputError for a recording without a row in the file of recordings."""
    known = read_rows(path, "recording")
    for row in rows:
        if row["recording"] not in known:
            what = f"has no row for the recording {row['recording']}"
            raise InputError(path, what, "add where its pictures are from, and their terms")


def differences(told: Mapping[str, Mapping[str, str]], pictures: Sequence[Item]) -> Differences:
    """How a folder's pictures differ from the rows told of them, by file name."""
    found = {name_of(picture): picture.path for picture in pictures}
    changed = (
        name
        for name, row in told.items()
        if name in found and fingerprint(found[name]) != row["sha256"]
    )
    missing, extra = (name for name in told if name not in found), (set(found) - set(told))
    return Differences(tuple(missing), tuple(changed), tuple(sorted(extra)))


def write(folder: Path, manifest: Path) -> int:
    """Write the manifest of a folder; the exit status, 0."""
    pictures = find_pictures([folder])
    rows = [manifest_row(picture) for picture in pictures]
    check_recordings(rows, manifest.with_name(RECORDINGS))
    write_text(manifest, csv_text(COLUMNS, rows))
    print(f"{manifest}: {len(rows)} pictures, {pictures_hash(pictures)} (`pictures` in run.json)")
    return 0


def check(folder: Path, manifest: Path) -> int:
    """Tell how a folder differs from the manifest; the exit status, 1 if it does."""
    told = read_rows(manifest, "file")
    found = differences(told, find_pictures([folder]))
    for kind, names in found._asdict().items():
        for name in names:
            print(f"{kind} {name}")
    same = len(told) - len(found.missing) - len(found.changed)
    counts = ", ".join(f"{len(names)} {kind}" for kind, names in found._asdict().items())
    print(f"{same} of {len(told)} pictures are the same; {counts}")
    return int(any(found))


COMMANDS = {"write": write, "check": check}


def main(words: Sequence[str] | None = None) -> int:
    """Do what is asked; the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("command", choices=tuple(COMMANDS))
    parser.add_argument("pictures", type=Path, metavar="PICTURES")
    parser.add_argument("--manifest", type=Path, default=MANIFEST)
    given = parser.parse_args(words)
    try:
        return COMMANDS[given.command](given.pictures, given.manifest)
    except RoadtorchError as problem:
        print(f"roadtorch: error: {problem}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
