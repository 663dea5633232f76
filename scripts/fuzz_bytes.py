"""What ``scripts/fuzz.py`` does to files: to bytes, to texts, to nested values."""

import json
import random
import re
from collections.abc import Callable
from typing import Any

Mutation = Callable[[bytearray, random.Random], None]

SHORT = (
    *(b"", b"\0", b"\xff", b"\xef\xbb\xbf", b"\r", b"\n\n", b'"', b"'", b'"""', b",", b"=", b":"),
    *(b"NaN", b"1e999", b"-Infinity", b"null", b"true", b"-1", b"0", b"1e308", b"0x", b"1_0"),
    *(b"\\ud800", b"\xed\xa0\x80", b"&lol;", b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"<![CDATA[", b"#"),
    "ß\N{RIGHT-TO-LEFT OVERRIDE}".encode(),
)
LONG = (
    *(b"9" * 5_000, b"a." * 40_000 + b"a", b"[" * 3_000, b'{"a":' * 3_000, b"<a>" * 3_000),
    b"x" * 200_000,
)
"""Pieces of text that have tripped parsers, ours or others'."""

WORD = re.compile(rb"[\w.+-]+")

VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1e999, float("nan"), 1e308, 2**63, 10**400, "", "x", "\ud800", "\0"),
    *([], {}, [[]], "y" * 100_000, [0] * 1_000, "/dev/zero", "../../x", "nan", "inf"),
)
"""Values that stand where a file of ours has another one."""


def flip_bits(data: bytearray, draw: random.Random) -> None:
    """Turn one to eight bits anywhere."""
    for _ in range(draw.randint(1, 8)):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def break_header(data: bytearray, draw: random.Random) -> None:
    """Give bytes near the beginning values that are at the edge."""
    for _ in range(draw.randint(1, 4)):
        data[draw.randrange(min(len(data), 200))] = draw.choice((0, 1, 127, 128, 254, 255))


def cut(data: bytearray, draw: random.Random) -> None:
    """Leave out everything behind some place."""
    del data[max(1, draw.randrange(len(data))) :]


def leave_out(data: bytearray, draw: random.Random) -> None:
    """Leave out a piece inside."""
    at = draw.randrange(len(data))
    del data[at : at + draw.randint(1, 200)]
    data += b"\0" * (not data)


def swap(data: bytearray, draw: random.Random) -> None:
    """Let two pieces of one length change places."""
    length = draw.randint(1, max(1, len(data) // 4))
    one, two = (draw.randrange(len(data) - length + 1) for _ in range(2))
    data[one : one + length], data[two : two + length] = (
        data[two : two + length],
        data[one : one + length],
    )


def repeat(data: bytearray, draw: random.Random) -> None:
    """Insert a piece once more somewhere else."""
    at = draw.randrange(len(data))
    to = draw.randrange(len(data))
    data[to:to] = data[at : at + draw.randint(1, 500)]


def insert(data: bytearray, draw: random.Random) -> None:
    """Put a piece that trips parsers in the place of up to twenty bytes."""
    at = draw.randrange(len(data))
    data[at : at + draw.choice((0, 0, 1, 5, 20))] = a_piece(draw)
    data += b"\0" * (not data)


def replace_word(data: bytearray, draw: random.Random) -> None:
    """Put a piece that trips parsers, or another word of the text, in the place of a word."""
    words = list(WORD.finditer(data))
    if not words:
        return
    word, other = draw.choice(words), bytes(draw.choice(words)[0])
    data[word.start() : word.end()] = draw.choice([other, a_piece(draw)])
    data += b"\0" * (not data)


def a_piece(draw: random.Random) -> bytes:
    """One of ``SHORT``, or one time in ten of ``LONG``."""
    return draw.choice(LONG if draw.random() < 0.1 else SHORT)


def shuffle_lines(data: bytearray, draw: random.Random) -> None:
    """Take lines out, write lines twice, and mix their order."""
    lines = data.split(b"\n")
    lines = draw.choices(lines, k=draw.randint(1, len(lines) + 2))
    data[:] = b"\n".join(lines) or b"\0"


BYTES: tuple[Mutation, ...] = (flip_bits, break_header, cut, leave_out, swap, repeat)
TEXT: tuple[Mutation, ...] = (*BYTES, *(insert,) * 2, *(replace_word,) * 8, shuffle_lines)


def mutated(data: bytes, draw: random.Random, mutations: tuple[Mutation, ...]) -> bytes:
    """Bytes after one to three mutations."""
    changed = bytearray(data or b"\0")
    for _ in range(draw.choice((1, 1, 2, 3))):
        draw.choice(mutations)(changed, draw)
    return bytes(changed)


def mutated_values(values: Any, draw: random.Random) -> Any:
    """Nested values with one part, anywhere, replaced, removed, wrapped or written twice."""
    if not isinstance(values, dict | list) or not values or draw.random() < 0.15:
        return draw.choice(VALUES) if draw.random() < 0.8 else [values]
    changed: Any = values.copy()
    key = draw.choice(list(values)) if isinstance(values, dict) else draw.randrange(len(values))
    match draw.randrange(6):
        case 0:
            del changed[key]
        case 1 if isinstance(changed, list):
            changed.append(changed[key])
        case 1:
            changed[draw.choice(["", "x", "shapes", f"{key} "])] = changed[key]
        case _:
            changed[key] = mutated_values(changed[key], draw)
    return changed


def as_json(values: Any) -> bytes:
    """Values as JSON, surrogates and numbers that JSON has not included."""
    return json.dumps(values).encode()


def mutated_json(values: Any, draw: random.Random) -> bytes:
    """JSON that was tampered with: mostly its values, sometimes its text."""
    for _ in range(draw.randint(1, 2)):
        values = mutated_values(values, draw)
    data = as_json(values)
    return mutated(data, draw, TEXT) if draw.random() < 0.3 else data
