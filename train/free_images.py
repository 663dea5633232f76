"""Gather free images that weights learn from into one folder.

    python -m train.free_images DATA --out IMAGES [--count 500] [--without RECORDING ...]

A list names each image with its SHA-256, source and licence: street_images.csv, which new networks
learn from, none of which is one of many's; free_images.csv for CNN-7. DATA is searched for files
of those names; one with other bytes does not count. They are taken from all recordings in turn
until there are enough, so that no long recording outweighs the others, and are called
RECORDING_NUMBER, as ``roadtorch train`` tells recordings apart. The exit status is 1 if one is
missing.
"""

import argparse
import csv
import shutil
import sys
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, islice, zip_longest
from pathlib import Path

from roadtorch.base.atomic import file_digest

STREET_IMAGES = Path(__file__).with_name("street_images.csv")


def recordings(manifest: Path) -> dict[str, list[Mapping[str, str]]]:
    """Return the rows of each recording: a file's folder, or its name up to the last ``_``."""
    rows: dict[str, list[Mapping[str, str]]] = {}
    with manifest.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            folder, _, name = row["file"].rpartition("/")
            rows.setdefault(folder or name.rpartition("_")[0], []).append(row)
    return rows


def round_robin(
    rows: Mapping[str, Sequence[Mapping[str, str]]], count: int | None, without: Collection[str]
) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield (RECORDING_NUMBER, row) from all recordings in turn; ``count``, or all if None."""
    names = sorted({*rows} - {*without})
    hands = [[(f"{name}_{n:04d}", row) for n, row in enumerate(rows[name], 1)] for name in names]
    return islice(filter(None, chain.from_iterable(zip_longest(*hands))), count)


def gather(data: Path, out: Path, chosen: Iterable[tuple[str, Mapping[str, str]]]) -> list[str]:
    """Copy files of anywhere below a folder as (new stem, row) say; return those missing."""
    paths_by_name = defaultdict[str, list[Path]](list)
    for path in data.rglob("*.*"):
        paths_by_name[path.name].append(path)
    missing = []
    for stem, row in chosen:
        named = paths_by_name[Path(row["file"]).name]
        path = next((path for path in named if file_digest(path) == row["sha256"]), None)
        if path is None:
            missing.append(row["file"])
        else:
            (out / stem).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, out / f"{stem}{path.suffix}")
    return missing


def main(words: Sequence[str] | None = None) -> int:
    """Gather the images; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--out", type=Path, required=True, metavar="IMAGES")
    parser.add_argument("--count", type=int)
    parser.add_argument("--without", nargs="*", default=[], metavar="RECORDING")
    parser.add_argument("--list", type=Path, default=STREET_IMAGES, metavar="CSV")
    options = parser.parse_args(words)
    chosen = round_robin(recordings(options.list), options.count, options.without)
    missing = gather(options.data, options.out, chosen)
    print("\n".join([*(f"missing {name}" for name in missing), f"{len(missing)} missing"]))
    return int(bool(missing))


if __name__ == "__main__":
    sys.exit(main())
