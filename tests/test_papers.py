"""docs/papers.md: nothing in its tables is empty, and whatever they name exists.

Code is named below ``roadtorch.`` in backticks; so are files, detectors, settings, options and
measures. A row whose figure is pending may name what is still being built.
"""

import ast
import importlib
import re
import shlex
from collections.abc import Iterator, Sequence
from fnmatch import fnmatch
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import click
import pytest

from roadtorch.cli.group import COMMANDS
from roadtorch.data.catalogue import list_datasets
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.errors import RoadtorchError
from roadtorch.evaluation.measures import MEASURES
from roadtorch.settings import Settings, build_settings, parse_assignments
from roadtorch.train.config import PatchTraining, PictureTraining
from scripts.figures import FIGURES

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "papers.md"
COLUMNS = (
    *("item", "what it says", "where in the code", "command"),
    *("the paper's value", "ours", "why they differ"),
)
HISTORY = (ROOT / "train" / "README.md").read_text(encoding="utf-8").partition("in the history")[2]
PENDING = "pending"


class Row(NamedTuple):
    """One item of a paper."""

    paper: str
    item: str
    says: str
    where: str
    command: str
    value: str
    ours: str
    why: str


# --- the document -------------------------------------------------------------------------


def read_rows(text: str) -> Iterator[Row]:
    """The rows of the tables under ``## P1``, ``## P2``, ``## P3``."""
    paper = ""
    for line in text.splitlines():
        if line.startswith("## "):
            paper = line[3:]
        elif line.startswith("| ") and paper and not line.startswith("| item |"):
            yield Row(paper, *(cell.strip() for cell in line.strip().strip("|").split("|")))


ROWS = tuple(read_rows(DOCUMENT.read_text(encoding="utf-8")))
FINISHED = tuple(row for row in ROWS if row.ours != PENDING)


def backticked(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


# --- what exists --------------------------------------------------------------------------


def is_code(name: str) -> bool:
    """Whether a dotted name below roadtorch is a module, or something in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module("roadtorch." + ".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for part in parts[count:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


def is_detector(name: str) -> bool:
    """Whether a name or a pattern is that of at least one detector."""
    return any(fnmatch(known, name) for known in every_detector())


@cache
def every_detector() -> frozenset[str]:
    return frozenset([*list_detectors("*"), *list_detectors("oneclass:*:*")])


@cache
def every_model() -> tuple[type[Settings], ...]:
    """The settings of every detector on RGB, and of training."""
    some = [name for name in every_detector() if not name.startswith("oneclass")]
    some += [name for name in every_detector() if fnmatch(name, "oneclass:*:RGB")]
    return (*(detector_entry(name).settings for name in some), PatchTraining, PictureTraining)


def is_setting(text: str) -> bool:
    """Whether ``group.key``, ``group.key=value`` or ``group.*`` is a setting of anything."""
    key, given, _ = text.partition("=")
    return any(
        accepts(model, text) if given else has_field(model, key.removesuffix(".*").split("."))
        for model in every_model()
    )


def has_field(model: object, path: Sequence[str]) -> bool:
    if not (isinstance(model, type) and issubclass(model, Settings)):
        return False
    if path[0] not in model.model_fields:
        return False
    return len(path) == 1 or has_field(model.model_fields[path[0]].annotation, path[1:])


def accepts(model: type[Settings], assignment: str) -> bool:
    try:
        build_settings(model, parse_assignments([assignment]))
    except RoadtorchError:
        return False
    return True


def command_named(name: str) -> click.Command:
    module, attribute = COMMANDS[name][0].split(":")
    return getattr(importlib.import_module(module), attribute)


def options_of(name: str) -> set[str]:
    return {option for parameter in command_named(name).params for option in parameter.opts}


def is_option(name: str) -> bool:
    return any(name in options_of(command) for command in COMMANDS)


def is_command(text: str) -> bool:
    return text.startswith("roadtorch ") and text.split()[1] in COMMANDS


def is_file(name: str) -> bool:
    return "/" in name and (ROOT / name).exists()


def is_measure(name: str) -> bool:
    keys = {part for measure in MEASURES for part in (measure.key, measure.key.split("/")[0])}
    return name in keys | {"pooled"}


KNOWN = (is_code, is_detector, is_setting, is_option, is_command, is_file, is_measure)


def exists(name: str) -> bool:
    return any(kind(name) for kind in KNOWN)


# --- commands -----------------------------------------------------------------------------


def wrong_in(command: str) -> list[str]:
    """What a command names that does not exist."""
    words = shlex.split(command)
    match words:
        case ["python", "-m", "pytest", file, *rest]:
            return wrong_in_tests(ROOT / file, rest)
        case ["python", "scripts/figures", name, *rest]:
            return [name] * (name not in FIGURES) + [word for word in rest if word.islower()]
        case ["python", script, *rest]:
            return wrong_in_script(ROOT / script, rest)
        case ["roadtorch", name, *rest] if name in COMMANDS:
            return wrong_in_arguments(name, rest)
    return [command]


def wrong_in_tests(file: Path, rest: Sequence[str]) -> list[str]:
    if not file.is_file():
        return [str(file)]
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    told = [word for word in rest if word != "-k"]
    return [word for word in told if not any(word in name for name in names)]


def wrong_in_script(script: Path, rest: Sequence[str]) -> list[str]:
    """Options and lower-case words stand in the script in quotes; what is behind --out is free.

    A study that is in the history is named by train/README.md.
    """
    if not script.is_file():
        named = f"`python {script.relative_to(ROOT)} " in HISTORY
        return [] if named else [str(script)]
    source = script.read_text(encoding="utf-8")
    words = [word for before, word in zip(["", *rest], rest, strict=False) if before != "--out"]
    told = [word for word in words if word.startswith("--") or word.islower()]
    return [word for word in told if f'"{word}"' not in source]


def wrong_in_arguments(name: str, rest: Sequence[str]) -> list[str]:
    wrong = [word for word in rest if word.startswith("--") and word not in options_of(name)]
    pairs = list(pairwise(rest))
    wrong += [to for at, to in pairs if at == "--detector" and not is_detector(to)]
    wrong += [to for at, to in pairs if at == "--set" and not is_setting(to)]
    wrong += [to for at, to in pairs if at == "--config" and not is_file(to)]
    if name == "evaluate" and rest[0] not in list_datasets():
        wrong.append(rest[0])
    return wrong


# --- tests --------------------------------------------------------------------------------


def test_the_tables_have_the_seven_columns_and_every_paper_has_one() -> None:
    heads = re.findall(r"^\| item .*$", DOCUMENT.read_text(encoding="utf-8"), re.M)

    assert [tuple(c.strip() for c in head.strip("|").split("|")) for head in heads] == [COLUMNS] * 3
    assert {row.paper for row in ROWS} == {"P1", "P2", "P3"}


@pytest.mark.parametrize(
    ("paper", "kind", "numbers"),
    [
        ("P1", "Eq.", range(1, 12)),
        ("P1", "Fig.", range(1, 7)),
        ("P1", "Table", ("I", "II")),
        ("P2", "Eq.", range(1, 5)),
        ("P2", "Fig.", range(1, 9)),
        ("P3", "Fig.", range(1, 10)),
        ("P3", "Table", ("I", "II", "III")),
    ],
)
def test_every_numbered_item_of_a_paper_has_a_row(
    paper: str, kind: str, numbers: Sequence[int | str]
) -> None:
    items = " ; ".join(row.item for row in ROWS if row.paper == paper)

    for number in numbers:
        assert re.search(rf"{re.escape(kind)} {number}(?![0-9IVX])", items), f"{kind} {number}"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.paper} {row.item}")
def test_no_cell_is_empty(row: Row) -> None:
    assert all(re.search(r"\w", cell) for cell in row)


def test_no_item_stands_twice() -> None:
    assert len({(row.paper, row.item) for row in ROWS}) == len(ROWS)


@pytest.mark.parametrize("row", FINISHED, ids=lambda row: f"{row.paper} {row.item}")
def test_what_a_finished_row_names_exists(row: Row) -> None:
    commands = backticked(row.command)
    cells = (row.says, row.where, row.value, row.ours, row.why)
    files = re.findall(r"\b(?:configs|docs|train|scripts|tests)/[\w./-]+\.\w+", " ".join(cells))

    unknown = [name for cell in cells for name in backticked(cell) if not exists(name)]
    unknown += [name for name in files if not is_file(name)]
    unknown += [f"{wrong} in: {command}" for command in commands for wrong in wrong_in(command)]
    assert unknown == []
    assert commands, "a row has a command in backticks"
    assert backticked(row.where), "a row tells where in the code, in backticks"


def test_every_link_leads_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", DOCUMENT.read_text(encoding="utf-8")):
        assert (DOCUMENT.parent / target).exists(), target


def test_nothing_is_pending() -> None:
    assert [f"{row.paper} {row.item}" for row in ROWS if PENDING in " ".join(row)] == []


# --- the checks themselves ------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "ufl.preprocess.blurr",
        "ufl.nothing",
        "oneclass:gausian:*",
        "maps.encoder=banana",
        "maps.encodr",
        "--detectr",
        "configs/none.toml",
    ],
)
def test_a_misspelt_name_is_found(name: str) -> None:
    assert not exists(name)


@pytest.mark.parametrize(
    "command",
    [
        "python scripts/figures p9-fig1 DATA",
        "python train/choose_many.py bananas DATA",
        "python train/no_such_study.py DATA",
        "python -m pytest tests/ufl/test_maps.py -k banana",
        "python -m pytest tests/none.py",
        "roadtorch evaluate camvid CAMVID --detektor fusion",
        "roadtorch evaluate camvidd CAMVID --detector fusion",
        "roadtorch evaluate camvid CAMVID --detector fusionn",
        "roadtorch infer street.jpg --detector ufl --set maps.encoder=banana",
        "roadtorch train --config configs/none.toml --images PICTURES",
        "roadtorch banana",
    ],
)
def test_a_command_that_names_what_is_not_there_is_found(command: str) -> None:
    assert wrong_in(command) != []
