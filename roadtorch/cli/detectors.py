"""roadtorch detectors: what there is, and what can be set."""

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, zip_longest
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.options import suggest_detectors

if TYPE_CHECKING:
    from roadtorch.detectors.detector import Entry

WIDTH = 100  # letters in a line
CELL = 14  # letters in a line of an inner column
GAP = "  "

CIRCULAR = "; circular"


@click.command()
@click.argument("name", required=False, shell_complete=suggest_detectors)
def detectors(name: str | None) -> None:
    """List the detectors; with a NAME, its settings and their meaning.

    A NAME with wildcards lists those that it fits: 'oneclass:*:HS'. The NAME planes lists the
    colour planes with their ranges, and the representations made of them.
    """
    from roadtorch.detectors.catalogue import (
        detector_entry,
        detector_groups,
        is_pattern,
        list_detectors,
    )

    if name is None:
        rows = [row for group in detector_groups().items() for row in listed(*group)]
    elif name == "planes":
        click.echo(planes())
        return
    elif is_pattern(name):
        rows = [(known, detector_entry(known).summary) for known in list_detectors(name)]
    else:
        entry = detector_entry(name)
        click.echo(f"{name}: {entry.summary}\n")
        header = ("setting", "type", "default", "allowed", "meaning")
        defaults = entry.configured({}).model_dump(mode="json")
        schema = entry.settings.model_json_schema()
        rows = [header, *setting_rows(schema, defaults=defaults)]
    click.echo("\n".join(columns(rows)))


def planes() -> str:
    """Return the colour planes with their ranges, and the representations made of them."""
    from roadtorch.imaging.color import PLANES, REPRESENTATIONS

    rows = [("plane", "low", "high", "meaning")]
    rows += [
        (name, f"{plane.low:g}", f"{plane.high:g}", plane.summary + CIRCULAR * plane.circular)
        for name, plane in PLANES.items()
    ]
    combined = [("representation", "planes")]
    combined += [(name, " ".join(parts)) for name, parts in REPRESENTATIONS.items()]
    return "\n".join([*columns(rows), "", *columns(combined)])


def listed(name: str, entries: Sequence["Entry"]) -> Iterator[tuple[str, str]]:
    """The lines for a detector, or for a grid of them: name and summary, then its options."""
    grid = entries[0].grid
    if grid is None:
        yield name, entries[0].summary
        return
    yield name, f"{grid.summary}: {len(entries)} detectors, '{grid.wildcard}' lists them"
    options = zip(*(entry.name.split(":")[1:] for entry in entries), strict=True)
    for option, values in zip(name.split(":")[1:], options, strict=True):
        if option.startswith("<"):
            yield f"  {option}", " ".join(dict.fromkeys(values))


def columns(rows: list[tuple[str, ...]]) -> Iterator[str]:
    """Rows as lines with aligned columns, long cells over several lines, to fit WIDTH.

    The first column, which holds names, is as wide as it must be; the last gets the rest.
    """
    wrapped = [[row[0:1], *(_wrapped(cell, CELL) for cell in row[1:-1])] for row in rows]
    widths = [max(map(len, chain(*column))) for column in zip(*wrapped, strict=True)]
    rest = WIDTH - sum(widths) - len(GAP) * len(widths)
    for cells, row in zip(wrapped, rows, strict=True):
        for line in zip_longest(*cells, _wrapped(row[-1], rest), fillvalue=""):
            padded = (text.ljust(width) for text, width in zip(line, [*widths, 0], strict=True))
            yield GAP.join(padded).rstrip()


def _wrapped(text: str, width: int) -> Sequence[str]:
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


# --- what can be set --------------------------------------------------------------------


def setting_rows(
    schema: Mapping[str, Any],
    shared: Mapping[str, Any] | None = None,
    defaults: Mapping[str, Any] | None = None,
    path: str = "",
) -> Iterator[tuple[str, str, str, str, str]]:
    """Key, type, default, allowed and meaning of each setting in a JSON schema, depth first.

    shared: definitions that the schema refers to. defaults: those that the owner of a group of
    settings gives it, which go before the group's own. path: what stands before its keys.
    """
    definitions = schema.get("$defs", {}) if shared is None else shared
    defaults = defaults or {}
    for key, field in schema.get("properties", {}).items():
        meaning = field.get("description", "")
        target = definitions.get(str(field.get("$ref", "")).rpartition("/")[2], field)
        given = defaults.get(key, field.get("default"))
        if "properties" in target:
            yield from setting_rows(target, definitions, given, f"{path}{key}.")
        else:
            default = _text(given) if "default" in field or key in defaults else ""
            yield f"{path}{key}", _kind(target), default, _allowed(target), meaning


def _kind(field: Mapping[str, Any]) -> str:
    if "anyOf" in field:
        return " or ".join(_kind(option) for option in field["anyOf"])
    values = field.get("enum", [field["const"]] if "const" in field else None)
    return "choice" if values else str(field.get("type", "any"))


def _allowed(field: Mapping[str, Any]) -> str:
    if "anyOf" in field:
        return ", ".join(filter(None, (_allowed(option) for option in field["anyOf"])))
    if "enum" in field or "const" in field:
        return " | ".join(map(_text, field.get("enum", [field.get("const")])))
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    return ", ".join(f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field)


def _text(value: Any) -> str:
    """A value as ``--set`` takes it; strings without their quotes, 30.0 as 30."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
