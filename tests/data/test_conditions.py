"""Conditions come from a table beside a set; groups are left out by name."""

from pathlib import Path

import numpy as np
import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.conditions import with_conditions
from roadtorch.data.dataset import Dataset, leave_out
from roadtorch.errors import ConfigError, DatasetError
from tests.data.conftest import write_png

TABLE = """name,file,place,condition,size
near,a.png,"a town, by the sea",day bonnet,3x1
far,a.png,,night,3x1
far,b.png,,night rain night,3x1
"""


@pytest.fixture
def root(tmp_path) -> Path:
    """Two cameras; ``a`` is a picture of both."""
    for name in ("near/{}/a", "far/{}/a", "far/{}/b", "far/{}/c"):
        for part in ("images", "masks"):
            write_png(tmp_path / f"{name.format(part)}.png", np.zeros((1, 3), np.uint8))
    return tmp_path


def conditions(dataset: Dataset) -> dict[str, list[str]]:
    return {name: [item.name for item in items] for name, items in dataset.by_condition().items()}


# --- conditions ----------------------------------------------------------------------------------


def test_a_table_in_the_folder_is_read_and_every_word_is_a_condition(root):
    (root / "pictures.csv").write_text(TABLE)

    found = open_dataset("folder", root)

    assert conditions(found) == {
        "bonnet": ["near/a"], "day": ["near/a"], "night": ["far/a", "far/b"], "rain": ["far/b"]
    }  # fmt: skip
    assert {item.name: item.conditions for item in found.items}["far/c"] == ()
    assert conditions(open_dataset("folder", root / "far")) == {}


def test_another_table_takes_its_place(root, tmp_path):
    (root / "pictures.csv").write_text(TABLE)
    other = tmp_path / "other.csv"
    other.write_text("\N{ZERO WIDTH NO-BREAK SPACE}condition,name,file\nfog,far,c.png\n")

    found = with_conditions(open_dataset("folder", root), other)

    assert conditions(found) == {"fog": ["far/c"]}


def test_a_set_without_groups_needs_no_name(root, tmp_path):
    table = tmp_path / "other.csv"
    table.write_text("file,condition\nb.png,dusk\n")

    found = with_conditions(open_dataset("folder", root / "far"), table)

    assert conditions(found) == {"dusk": ["b"]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name,file\nnear,a.png\n", r"csv: has no column condition \(its first line has to name"),
        ("", r"csv: has no column name and none file and none condition"),
        ("file,condition\na.png,day\n", r"csv: has no column name"),
        (TABLE + "far,a.jpg,,day,\n", r"line 5: there is no picture far/a.jpg \(did.*far/a.png"),
        (TABLE + "zzzzzz,q.tiff,,day,\n", r"line 5: there is no picture zzzzzz/q.tiff \(mend"),
        (TABLE + "far,b.png,,day,\n", r"line 5: names far/b.png a second time \(keep one"),
        ("name,file,condition\nfar\n", r"line 2: there is no picture far"),
        ("name,file,condition\nfar,\0,\n", r"csv(: cannot be read|, line 2: there is no picture)"),
    ],
)
def test_a_table_that_does_not_fit_is_told_in_one_line(root, text, message):
    (root / "pictures.csv").write_text(text)

    with pytest.raises(DatasetError, match=message) as problem:
        open_dataset("folder", root)

    assert "\n" not in str(problem.value)


def test_a_table_that_is_no_text_or_not_there(root, tmp_path):
    dataset, table = open_dataset("folder", root), tmp_path / "other.csv"

    with pytest.raises(DatasetError, match=r"other\.csv: cannot be read: .*No such file"):
        with_conditions(dataset, table)
    table.write_bytes(b"name,file,condition\n\xff\xfe,a,b\n")
    with pytest.raises(DatasetError, match=r"other\.csv: cannot be read: 'utf-8' codec"):
        with_conditions(dataset, table)


# --- groups left out -----------------------------------------------------------------------------


def test_groups_left_out_stay_in_the_set_but_in_no_condition(root):
    (root / "pictures.csv").write_text(TABLE)
    whole = open_dataset("folder", root)

    found = leave_out(whole, ["far"])

    assert found.items == whole.items
    assert found.groups() == ["far", "near"]
    assert found.left_out == {"far"}
    assert set(found.by_condition()) == {"day", "bonnet"}
    assert leave_out(whole, ()) == whole


def test_what_cannot_be_left_out_is_refused(root):
    whole = open_dataset("folder", root)

    with pytest.raises(ConfigError, match=r"fra: unknown group of folder \(did you mean far"):
        leave_out(whole, ["fra"])
    with pytest.raises(ConfigError, match="--leave-out: leaves out every group"):
        leave_out(whole, ["far", "near"])
    with pytest.raises(ConfigError, match="which has no groups"):
        leave_out(open_dataset("folder", root / "far"), ["far"])
