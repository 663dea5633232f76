"""The table of docs/weights.md, from what evaluate writes."""

import json
from pathlib import Path
from typing import Any

import pytest

from scripts.weights_table import folder_table, main_table, placed, read_pair


def figures(f: float, maxf: float, floor: bool = False) -> dict[str, Any]:
    group = {"images": 3, "f_mask": f, "maxf": maxf}
    return {"f_mask": f, "maxf": maxf, "floor": floor, "groups": {"dn_cat": group, "ycor": group}}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    change = {"difference": -0.1, "ci95": [-0.2, 0.05]}
    found = {
        "images": 8,
        "detectors": {
            "b": figures(0.6, 0.7),
            "a": figures(0.7, 0.8),
            "prior:rows": figures(0.1, 0.2, floor=True),
        },
        "paired": {"against": "a", "detectors": {"b": {"f_mask": change, "maxf": change}}},
    }
    path = tmp_path / "many-fusion" / "metrics.json"
    path.parent.mkdir()
    path.write_text(json.dumps(found))
    return tmp_path


def test_research_stands_before_free_with_the_difference(results: Path) -> None:
    rows = list(main_table(results))

    assert rows[2:] == [
        "| many, 14 folders | 6 | `fusion` | F | 0.700 | 0.600 | -0.100 (-0.200 to +0.050) |",
        "| many, 14 folders | 6 | `fusion` | MaxF | 0.800 | 0.700 | -0.100 (-0.200 to +0.050) |",
    ]


def test_folders_of_a_source_that_was_learned_from_are_marked(results: Path) -> None:
    rows = list(folder_table(read_pair(results / "many-fusion" / "metrics.json")))

    assert rows[2:] == [
        "| dn_cat † | 0.700 | 0.600 | 0.800 | 0.700 |",
        "| ycor | 0.700 | 0.600 | 0.800 | 0.700 |",
    ]


def test_tables_replace_what_stood_in_their_place() -> None:
    begin, end = "<!-- weights_table -->", "<!-- /weights_table -->"

    assert placed(f"a\n{begin}\nold\n{end}\nb", "new") == f"a\n{begin}\nnew\n{end}\nb"
    with pytest.raises(SystemExit):
        placed("a", "new")
