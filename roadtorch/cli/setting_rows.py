"""What can be set: a row for each setting of a JSON schema."""

import json
from collections.abc import Iterator, Mapping
from typing import Any


def describe(schema: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str, str]]:
    """Key, type, default, allowed and meaning of each setting in a JSON schema, depth first."""
    yield from _describe(schema, schema.get("$defs", {}), {}, "")


def _describe(
    schema: Mapping[str, Any], shared: Mapping[str, Any], defaults: Mapping[str, Any], path: str
) -> Iterator[tuple[str, str, str, str, str]]:
    """defaults: those that the owner of this group gives it, which go before the group's own."""
    for key, field in schema.get("properties", {}).items():
        meaning = field.get("description", "")
        target = shared.get(str(field.get("$ref", "")).rpartition("/")[2], field)
        given = defaults.get(key, field.get("default"))
        if "properties" in target:
            yield from _describe(target, shared, given or {}, f"{path}{key}.")
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
