"""Under which conditions the pictures of a set were taken, from a table beside it.

The table is CSV with the columns ``file`` (the picture's file name), ``condition`` (words, any
number of them: "night rain") and, for a set with groups, ``name`` (the group). Other columns
are passed over; pictures that it does not list have no condition.
"""

import csv
import difflib
import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from roadtorch.data.dataset import Dataset, Item
from roadtorch.errors import DatasetError
from roadtorch.io.bounded import read_regular, reason

FILE = "pictures.csv"  # in the folder of a set

Key = tuple[str, str]
"""The group of a picture ("" in a set without groups) and the name of its file."""


def with_conditions(dataset: Dataset, path: Path) -> Dataset:
    """The set with the conditions that a table gives to its pictures.

    Raises DatasetError naming the table, and the line where there is one, for a file that
    cannot be read, lacks a column, names a picture that the set does not have, or one twice.
    """
    pictures = {_key_of(item): item for item in dataset.items}
    columns = ["name", "file", "condition"] if dataset.groups() else ["file", "condition"]
    found: dict[Key, tuple[str, ...]] = {}
    for line, row in _rows(path, columns):
        key = (row["name"] if dataset.groups() else "", row["file"])
        where, name = f"{path}, line {line}", _shown(key)
        if key not in pictures:
            near = difflib.get_close_matches(name, map(_shown, pictures), n=3, cutoff=0.5)
            remedy = f"did you mean {', '.join(near)}?" if near else "mend the line or remove it"
            raise DatasetError(where, f"there is no picture {name}", remedy)
        if key in found:
            raise DatasetError(where, f"names {name} a second time", "keep one of the two lines")
        found[key] = tuple(dict.fromkeys(row["condition"].split()))
    items = (replace(one, conditions=found.get(_key_of(one), ())) for one in dataset.items)
    return replace(dataset, items=tuple(items))


def _key_of(item: Item) -> Key:
    return item.group or "", item.image.name


def _shown(key: Key) -> str:
    return "/".join(filter(None, key))


def _rows(path: Path, columns: list[str]) -> Iterator[tuple[int, Mapping[str, str]]]:
    """Number of the line, and what it says, of every line below the names of the columns."""
    try:
        text = read_regular(path).decode("utf-8-sig")
        table = csv.DictReader(io.StringIO(text, newline=""), restval="")
        missing = [name for name in columns if name not in (table.fieldnames or ())]
        if missing:
            what = f"has no column {' and none '.join(missing)}"
            raise DatasetError(path, what, f"its first line has to name {', '.join(columns)}")
        for row in table:
            yield table.line_num, row
    except (OSError, UnicodeDecodeError, csv.Error) as problem:
        raise DatasetError(path, f"cannot be read: {reason(problem)}", "give a CSV file") from None
