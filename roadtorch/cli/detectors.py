"""roadtorch detectors: list the detectors, and the settings of each."""

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, zip_longest
from typing import TYPE_CHECKING, Any

import click

from roadtorch.cli.options import suggest_detectors

if TYPE_CHECKING:
    from roadtorch.detectors.entry import Entry

LINE_WIDTH = 100  # characters
INNER_COLUMN_WIDTH = 14  # characters, at most
COLUMN_GAP = "  "


@click.command()
@click.argument("name", required=False, shell_complete=suggest_detectors)
def detectors_command(name: str | None) -> None:
    """List the detectors, or the settings of the detector NAME.

    A NAME with wildcards lists the detectors that match: 'oneclass:*:HS'.
    """
    from roadtorch.detectors.catalogue import (
        detector_entry,
        detector_groups,
        is_pattern,
        list_detectors,
    )

    if name is None:
        rows = [row for group in detector_groups().items() for row in detector_rows(*group)]
    elif is_pattern(name):
        rows = [(match, detector_entry(match).summary) for match in list_detectors(name)]
    else:
        entry = detector_entry(name)
        click.echo(f"{name}: {entry.summary}\n")
        header = ("setting", "type", "default", "allowed", "meaning")
        defaults = entry.make_settings({}).model_dump(mode="json")
        schema = entry.settings.model_json_schema()
        rows = [header, *setting_rows(schema, defaults=defaults)]
    click.echo("\n".join(wrap_columns(rows)))


def detector_rows(name: str, entries: Sequence["Entry"]) -> Iterator[tuple[str, str]]:
    """Yield name and summary of a detector; for a grid of detectors, its options as well."""
    grid = entries[0].grid
    if grid is None:
        yield name, entries[0].summary
        return
    yield name, f"{grid.summary}: {len(entries)} detectors, '{grid.wildcard}' lists them"
    options = zip(*(entry.name.split(":")[1:] for entry in entries), strict=True)
    for option, values in zip(name.split(":")[1:], options, strict=True):
        if option.startswith("<"):
            yield f"  {option}", " ".join(dict.fromkeys(values))


def wrap_columns(rows: list[tuple[str, ...]]) -> Iterator[str]:
    """Yield rows as lines of LINE_WIDTH with aligned columns; all cells but names are wrapped."""
    wrapped = [[row[0:1], *(_wrap(cell, INNER_COLUMN_WIDTH) for cell in row[1:-1])] for row in rows]
    widths = [max(map(len, chain(*column))) for column in zip(*wrapped, strict=True)]
    last_width = LINE_WIDTH - sum(widths) - len(COLUMN_GAP) * len(widths)
    for cells, row in zip(wrapped, rows, strict=True):
        for line in zip_longest(*cells, _wrap(row[-1], last_width), fillvalue=""):
            padded = (text.ljust(width) for text, width in zip(line, [*widths, 0], strict=True))
            yield COLUMN_GAP.join(padded).rstrip()


def _wrap(text: str, width: int) -> Sequence[str]:
    return textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]


# --- settings ---------------------------------------------------------------------------


def setting_rows(
    schema: Mapping[str, Any],
    shared: Mapping[str, Any] | None = None,
    defaults: Mapping[str, Any] | None = None,
    path: str = "",
) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield key, type, default, allowed and meaning of each setting in a JSON schema, depth first.

    shared: definitions that the schema refers to. defaults: values that override the schema's.
    path: prefix of the keys.
    """
    definitions = schema.get("$defs", {}) if shared is None else shared
    defaults = defaults or {}
    for key, field in schema.get("properties", {}).items():
        meaning = field.get("description", "")
        target = definitions.get(str(field.get("$ref", "")).rpartition("/")[2], field)
        value = defaults.get(key, field.get("default"))
        if "properties" in target:
            yield from setting_rows(target, definitions, value, f"{path}{key}.")
        else:
            default = _format(value) if "default" in field or key in defaults else ""
            yield f"{path}{key}", _type_name(target), default, _allowed(target), meaning


def _type_name(field: Mapping[str, Any]) -> str:
    if "anyOf" in field:
        return " or ".join(_type_name(option) for option in field["anyOf"])
    values = field.get("enum", [field["const"]] if "const" in field else None)
    return "choice" if values else str(field.get("type", "group" if "$ref" in field else "any"))


def _allowed(field: Mapping[str, Any]) -> str:
    if "anyOf" in field:
        return ", ".join(filter(None, (_allowed(option) for option in field["anyOf"])))
    if "enum" in field or "const" in field:
        return " | ".join(map(_format, field.get("enum", [field.get("const")])))
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    return ", ".join(f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field)


def _format(value: Any) -> str:
    """Format a value as ``--set`` takes it: strings without quotes, 30.0 as 30."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
