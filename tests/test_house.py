"""Where modules live and what they may import; and that the checks of it find what is wrong."""

import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from scripts import house
from scripts.house import ROWS, Row
from scripts.import_graph import (
    Graph,
    circles,
    functions,
    import_graph,
    public_constants,
    public_definitions,
    read_package,
    room_graph,
)

ROOT = Path(house.__file__).parents[1]
MODULES = read_package(ROOT / "roadtorch")
GRAPH = import_graph(MODULES)


# --- the rules --------------------------------------------------------------------------


def test_no_module_is_in_a_circle_of_imports() -> None:
    assert circles(GRAPH) == []


def test_no_room_is_in_a_circle_of_imports() -> None:
    assert circles(room_graph(GRAPH)) == []


def test_every_module_has_a_row() -> None:
    assert house.homeless(MODULES) == []


def test_imports_point_up_the_rows() -> None:
    assert house.against_the_rows(GRAPH) == []


def test_nothing_inside_imports_the_public_face() -> None:
    assert [name for name, imported in GRAPH.items() if "roadtorch" in imported] == []


def test_a_public_class_or_function_is_defined_once() -> None:
    # Constants are left out: LEAST, ROUNDS or BLOCK is a number of its own module and is read
    # there, and some, as ENTRIES, are what several modules offer in the same way.
    assert house.twin_definitions(MODULES) == {}


def test_no_module_has_more_than_400_lines() -> None:
    assert house.too_long(MODULES) == {}


def test_the_house_is_drawn_as_it_is() -> None:
    drawn = (ROOT / "docs" / "house.svg").read_text(encoding="utf-8")

    assert drawn == house.house_picture(MODULES), "python scripts/house.py draw docs/house.svg"


# --- the page ---------------------------------------------------------------------------

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_every_path_on_the_page_exists() -> None:
    paths = re.findall(r"`((?:roadtorch|scripts|tests|train|docs|configs)/[\w./-]*)`", PAGE)

    assert len(paths) > 20
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_page_names_every_room_in_the_order_of_the_rows() -> None:
    table = [line.split("|")[2] for line in PAGE.splitlines() if re.match(r"\| \d+ \|", line)]
    named = [re.findall(r"`([\w]+)/?`", cell) for cell in table]

    assert named == [[room for room in row.rooms if _built(room)] for row in ROWS]


def _built(room: str) -> bool:
    return (ROOT / "roadtorch" / room).is_dir() or (ROOT / "roadtorch" / f"{room}.py").is_file()


# --- the checks themselves, on toys -----------------------------------------------------


def toy(folder: Path, sources: Mapping[str, str]) -> Path:
    """A checkout whose package ``roadtorch`` has these sources, by path without suffix."""
    for name, source in {"__init__": "", **sources}.items():
        path = folder / "roadtorch" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(source)
    return folder


def toy_graph(folder: Path, sources: Mapping[str, str]) -> Graph:
    return import_graph(read_package(toy(folder, sources) / "roadtorch"))


@pytest.mark.parametrize(
    "back",
    [
        "from roadtorch.a import one",
        "from roadtorch import a",
        "import roadtorch.a",
        "from . import a",
        "from .a import one",
        "def late():\n    from roadtorch.a import one",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from roadtorch.a import one",
        "import typing\nif typing.TYPE_CHECKING:\n    from roadtorch.a import one",
    ],
)
def test_a_circle_is_found_however_it_is_closed(tmp_path: Path, back: str) -> None:
    graph = toy_graph(
        tmp_path, {"a": "from roadtorch.b import two", "b": "import roadtorch.c", "c": back}
    )

    assert circles(graph) == [("roadtorch.a", "roadtorch.b", "roadtorch.c")]


def test_two_circles_are_told_apart_and_a_way_between_them_is_none(tmp_path: Path) -> None:
    graph = toy_graph(
        tmp_path,
        {
            "a": "import roadtorch.b",
            "b": "import roadtorch.a, roadtorch.c",
            "c": "import roadtorch.d",
            "d": "import roadtorch.c, os, roadtorch.missing",
        },
    )

    assert circles(graph) == [("roadtorch.a", "roadtorch.b"), ("roadtorch.c", "roadtorch.d")]


def test_rooms_may_be_in_a_circle_where_no_module_is(tmp_path: Path) -> None:
    graph = toy_graph(
        tmp_path,
        {
            "left/one": "import roadtorch.right.one",
            "right/one": "",
            "right/two": "from ..left import two",
            "left/two": "from . import one",
        },
    )

    assert circles(graph) == []
    assert circles(room_graph(graph)) == [("left", "right")]


def test_a_folder_is_imported_by_the_names_of_its_init(tmp_path: Path) -> None:
    graph = toy_graph(
        tmp_path, {"a": "from roadtorch.box import thing", "box/lid": "", "box/__init__": ""}
    )

    assert graph["roadtorch.a"] == {"roadtorch.box"}


def test_the_face_may_name_for_type_checkers_what_it_loads_late(tmp_path: Path) -> None:
    late = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from roadtorch.a import one"

    graph = toy_graph(tmp_path, {"__init__": late, "a": "from roadtorch import __version__"})

    assert graph == {"roadtorch": set(), "roadtorch.a": {"roadtorch"}}


def test_an_import_from_the_face_is_against_the_rows(tmp_path: Path) -> None:
    graph = toy_graph(tmp_path, {"errors": "from roadtorch import __version__"})

    assert house.against_the_rows(graph) == [("roadtorch.errors", "roadtorch")]


def test_an_import_down_the_rows_is_found(tmp_path: Path) -> None:
    graph = toy_graph(
        tmp_path,
        {
            "top": "",
            "beside": "import roadtorch.top\ndef late():\n    import roadtorch.below.one",
            "below/one": "import roadtorch.top, roadtorch.beside",
        },
    )
    rows = (Row("upper", ("top", "beside")), Row("lower", ("below",)))

    assert house.against_the_rows(graph, rows) == [("roadtorch.beside", "roadtorch.below.one")]


def test_a_module_in_no_row_is_found(tmp_path: Path) -> None:
    graph = toy_graph(tmp_path, {"errors": "", "helpers": "", "utils/text": ""})

    assert house.homeless(graph) == ["roadtorch.helpers", "roadtorch.utils.text"]


def test_the_ways_in_of_folders_belong_to_the_last_row(tmp_path: Path) -> None:
    graph = toy_graph(tmp_path, {"train/__main__": "import roadtorch.cli.run", "cli/run": ""})

    assert house.homeless(graph) == []
    assert house.against_the_rows(graph) == []


def test_twins_are_found_and_commands_and_private_names_are_none(tmp_path: Path) -> None:
    body = "class Grid: ...\ndef _own(): ...\nclass Box:\n    def width(self): ...\n"
    root = toy(
        tmp_path,
        {
            "a": body,
            "b": "async def Grid(): ...\ndef _own(): ...\ndef width(): ...",
            "planes": "def planes(): ...",
            "cli/planes": "def planes(): ...",
        },
    )

    found = house.twin_definitions(read_package(root / "roadtorch"))

    assert found == {"Grid": ["roadtorch.a", "roadtorch.b"]}


def test_what_a_module_defines_is_what_stands_at_its_top(tmp_path: Path) -> None:
    source = (
        "import os\nfrom sys import path\n"
        "LEAST: int = 3\nX, (Y, _z) = 1, (2, 3)\nX = 4\n"
        "def one():\n    inner = 1\n    def two():\n        pass\n    return two\n"
        "class Three:\n    four = 4\n    @property\n    def five(self):\n        return 5\n"
    )
    module = read_package(toy(tmp_path, {"a": source}) / "roadtorch")["roadtorch.a"]

    assert public_definitions(module) == ["one", "Three"]
    assert public_constants(module) == ["LEAST", "X", "Y"]
    assert [(one.name, one.lines) for one in functions(module)] == [
        ("roadtorch.a.one", 5),
        ("roadtorch.a.one.two", 2),
        ("roadtorch.a.Three.five", 2),
    ]


def test_a_module_of_401_lines_is_too_long(tmp_path: Path) -> None:
    root = toy(tmp_path, {"a": "x = 1\n" * 400, "b": "x = 1\n" * 401})

    assert house.too_long(read_package(root / "roadtorch")) == {"roadtorch.b": 401}


def test_figures_of_another_checkout_are_printed(tmp_path: Path) -> None:
    root = toy(
        tmp_path,
        {
            "a": "import roadtorch.b\nLEAST = 1\ndef one(): ...\n",
            "b": "import roadtorch.a\nLEAST = 2\ndef one():\n    return 1\n",
            "room/c": "def two():\n    x = 1\n    return x\n",
        },
    )

    told = run("figures", "--root", root)

    assert told.returncode == 0, told.stderr
    assert re.sub(" +", " ", told.stdout).splitlines() == [
        "lines 10",
        "files 4",
        "functions 3: of 2 lines in the median, 90 % up to 3, at most 3 (roadtorch.room.c.two)",
        "circles between modules 1",
        " roadtorch.a roadtorch.b",
        "circles between rooms 1",
        " a b",
        "names defined twice 1",
        " one: roadtorch.a roadtorch.b",
        "constants defined twice 1",
        " LEAST: roadtorch.a roadtorch.b",
        "modules over 400 lines 0",
        "rooms 4",
        " b 4 40.0%",
        " a 3 30.0%",
        " room 3 30.0%",
        " __init__ 0 0.0%",
    ]


def test_a_folder_without_the_package_is_told(tmp_path: Path) -> None:
    told = run("figures", "--root", tmp_path)

    assert told.returncode == 2
    assert "no modules there" in told.stderr
    assert "Traceback" not in told.stderr


def test_the_picture_shows_rooms_modules_and_counted_imports(tmp_path: Path) -> None:
    root = toy(
        tmp_path,
        {
            "top": "x = 1\n" * 51,
            "below/one": "import roadtorch.top",
            "below/two": "import roadtorch.top, roadtorch.below.one",
        },
    )
    rows = (Row("upper", ("top", "not_built")), Row("lower", ("below",)))

    picture = house.house_picture(read_package(root / "roadtorch"), rows)

    texts = re.findall(r"<text[^>]*>([^<]*)</text>", picture)
    assert texts[:-1] == ["upper", "top", "100", "lower", "below/", "50", "one  two", "  2"]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, str(house.__file__), *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, timeout=60)
