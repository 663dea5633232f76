"""The house that the package's modules live in: its rows, what breaks their rules, its figures.

    python scripts/house.py figures                   # of this checkout
    python scripts/house.py figures --root ../before  # of another one, older ones too
    python scripts/house.py draw docs/house.svg

A room is a folder or module right under ``roadtorch/``. Imports point to rooms in rows above, or
in the same row, and never in a circle. A module of 400 lines probably holds two concepts.
"""

import argparse
import statistics
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from scripts.house_picture import Arrow, Band, Box, picture
from scripts.import_graph import (
    Graph,
    Module,
    circles,
    functions,
    import_graph,
    public_constants,
    public_definitions,
    read_package,
    room_graph,
    room_of,
    twins,
)

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "roadtorch"
MOST_LINES = 400
ROUNDED = 50  # lines in the picture, so that it does not change with every commit
CAPTION = (
    "Grey: lines of code, rounded up to fifties. Arrows: imports between rows, with the number "
    "of pairs of modules."
)


@dataclass(frozen=True)
class Row:
    """Rooms that stand side by side."""

    title: str
    rooms: tuple[str, ...]


ROWS = (
    Row("contract", ("errors", "version", "settings", "io", "runtime")),
    Row("steps", ("imaging", "superpixels", "road")),
    Row("papers", ("layout", "oneclass", "ufl", "vanishing")),
    Row("camera", ("camera",)),
    Row("what a detector is", ("analysis", "detector")),
    Row("detectors", ("detectors",)),
    Row("pictures in", ("sources", "scenes", "testing")),
    Row("footage through", ("sinks", "stream")),
    Row("out of Python", ("export",)),
    Row("labelled sets", ("data",)),
    Row("evaluation", ("evaluation",)),
    Row("report", ("report",)),
    Row("runs", ("runs",)),
    Row("training", ("train",)),
    Row("correction", ("annotate",)),
    Row("installation", ("doctor",)),
    Row("ways in", ("cli", "__main__", "__init__")),
)
"""From top to bottom. A room that is not built yet may have its place."""


# --- rules ------------------------------------------------------------------------------


def homeless(modules: Iterable[str], rows: Sequence[Row] = ROWS) -> list[str]:
    """The modules whose room is in no row."""
    known = {room for row in rows for room in row.rooms}
    return sorted(name for name in modules if room_of(name) not in known)


def against_the_rows(graph: Graph, rows: Sequence[Row] = ROWS) -> list[tuple[str, str]]:
    """Imports, as (importer, imported), of a room in a row below the importer's."""
    place = _places(rows)
    return sorted(
        (importer, imported)
        for importer, imported in _known(graph, place)
        if place[room_of(importer)] < place[room_of(imported)]
    )


def _places(rows: Sequence[Row]) -> dict[str, int]:
    """The row of each room, counted from the top."""
    return {room: index for index, row in enumerate(rows) for room in row.rooms}


def _known(graph: Graph, place: Mapping[str, int]) -> Iterator[tuple[str, str]]:
    """All imports between modules whose rooms have a place."""
    for importer, names in graph.items():
        for imported in names:
            if room_of(importer) in place and room_of(imported) in place:
                yield importer, imported


def too_long(modules: Mapping[str, Module]) -> dict[str, int]:
    """The modules that hold more than 400 lines, with their lines."""
    return {name: one.lines for name, one in modules.items() if one.lines > MOST_LINES}


def twin_definitions(modules: Mapping[str, Module]) -> dict[str, list[str]]:
    """Public classes and functions that several modules define, with those modules.

    A command's function has the name that the user types, whatever else has it.
    """
    return twins(
        {
            name: [one for one in public_definitions(module) if not _is_command(name, one)]
            for name, module in modules.items()
        }
    )


def _is_command(module: str, name: str) -> bool:
    return module == f"{PACKAGE}.cli.{name}"


# --- figures ----------------------------------------------------------------------------


def figures(modules: Mapping[str, Module]) -> str:
    """What can be counted about the house, a line each."""
    graph = import_graph(modules)
    between_modules, between_rooms = circles(graph), circles(room_graph(graph))
    definitions = twin_definitions(modules)
    constants = twins({name: public_constants(one) for name, one in modules.items()})
    over = [f"{name} ({lines})" for name, lines in too_long(modules).items()]
    total = sum(module.lines for module in modules.values())
    return "\n".join(
        [
            f"lines                       {total:,}",
            f"files                       {len(modules)}",
            f"functions                   {_function_lengths(modules)}",
            *_listed("circles between modules", [" ".join(group) for group in between_modules]),
            *_listed("circles between rooms", [" ".join(group) for group in between_rooms]),
            *_listed("names defined twice", _with_homes(definitions)),
            *_listed("constants defined twice", _with_homes(constants)),
            *_listed(f"modules over {MOST_LINES} lines", over),
            *_listed("rooms", _room_lines(modules)),
        ]
    )  # fmt: skip


def _listed(title: str, lines: Sequence[str]) -> list[str]:
    return [f"{title:<27} {len(lines)}", *(f"    {line}" for line in lines)]


def _with_homes(names: Mapping[str, Sequence[str]]) -> list[str]:
    return [f"{name}: {' '.join(homes)}" for name, homes in names.items()]


def _function_lengths(modules: Mapping[str, Module]) -> str:
    found = sorted(
        (one for module in modules.values() for one in functions(module)),
        key=lambda one: (one.lines, one.name),
    )
    if not found:
        return "0"
    median = statistics.median(one.lines for one in found)
    most = found[min(len(found) * 9 // 10, len(found) - 1)].lines
    longest = found[-1]
    return (
        f"{len(found)}: of {median:g} lines in the median, 90 % up to {most}, "
        f"at most {longest.lines} ({longest.name})"
    )


def _room_lines(modules: Mapping[str, Module]) -> list[str]:
    """Every room with its lines and its share of all, the largest first."""
    lines: Counter[str] = Counter()
    for name, module in modules.items():
        lines[room_of(name)] += module.lines
    total = sum(lines.values())
    return [f"{room:<20} {count:>6,} {count / total:>6.1%}" for room, count in lines.most_common()]


# --- picture ----------------------------------------------------------------------------


def house_picture(modules: Mapping[str, Module], rows: Sequence[Row] = ROWS) -> str:
    """The house as SVG: a band for each row, and arrows for the imports between rows."""
    place = _places(rows)
    counts = Counter(
        (place[room_of(importer)], place[room_of(imported)])
        for importer, imported in _known(import_graph(modules), place)
    )
    arrows = [Arrow(*pair, count) for pair, count in sorted(counts.items()) if pair[0] != pair[1]]
    bands = []
    for row in rows:
        boxes = [box for room in row.rooms if (box := _box(room, modules))]
        bands.append(Band(row.title, boxes))
    return picture(bands, arrows, CAPTION)


def _box(room: str, modules: Mapping[str, Module]) -> Box | None:
    """The box of a room: its rounded lines, and the modules inside; None where it is not built."""
    inside = [module for name, module in modules.items() if room_of(name) == room]
    if not inside:
        return None
    lines = -(-sum(module.lines for module in inside) // ROUNDED) * ROUNDED
    if [module.name for module in inside] in ([f"{PACKAGE}.{room}"], [PACKAGE]):
        return Box(room, lines, [])
    names = [module.name for module in inside if module.path.name != "__init__.py"]
    shown = [name.removeprefix(f"{PACKAGE}.").removeprefix(f"{room}.") for name in names]
    return Box(room if room.startswith("__") else f"{room}/", lines, shown)


# --- command ----------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    shown = commands.add_parser("figures", help="what can be counted")
    shown.add_argument("--root", type=Path, default=ROOT, help="another checkout")
    drawn = commands.add_parser("draw", help="the picture")
    drawn.add_argument("file", type=Path, help="such as docs/house.svg")
    arguments = parser.parse_args()
    if arguments.command == "draw":
        arguments.file.write_text(house_picture(read_package(ROOT / PACKAGE)), encoding="utf-8")
        return
    modules = read_package(arguments.root / PACKAGE)
    if not modules:
        parser.error(f"{arguments.root / PACKAGE}: no modules there (give the root of a checkout)")
    print(figures(modules))


if __name__ == "__main__":
    main()
