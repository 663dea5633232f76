"""Gather the benchmark of fourteen cameras into one folder, and check every byte.

    python scripts/benchmark.py SOURCES --out MANY
    roadtorch evaluate folder MANY --detector fusion

benchmark.csv names each file with its SHA-256, the data set and its address, the terms, and whether
the file may be passed on. SOURCES is searched for files of those names and bytes. No program makes
them from the original data sets: images were reduced, and those of dn_* were, with their labels,
read off small overview sheets. The exit status is 1 if a file is missing.
"""

import csv
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from train.free_images import gather

BENCHMARK = Path(__file__).with_name("benchmark.csv")


def main(words: Sequence[str] | None = None) -> int:
    """Gather the files and print a row for each camera; return the exit status."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("sources", type=Path, metavar="SOURCES")
    parser.add_argument("--out", type=Path, required=True, metavar="MANY")
    options = parser.parse_args(words)
    with BENCHMARK.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    missing = gather(
        options.sources, options.out, [(row["file"].rpartition(".")[0], row) for row in rows]
    )
    print("camera | files | missing | source | terms | may be passed on")
    for camera, group in groupby(rows, lambda row: row["file"].partition("/")[0]):
        files = list(group)
        absent = len({row["file"] for row in files}.intersection(missing))
        print(camera, len(files), absent, *[*files[0].values()][2:], sep=" | ")
    print("\n".join([*(f"missing {name}" for name in missing), f"{len(missing)} missing"]))
    return int(bool(missing))


if __name__ == "__main__":
    sys.exit(main())
