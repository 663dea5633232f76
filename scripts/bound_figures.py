"""Figures in documents that are bound to where they come from.

A figure is bound by a comment right after it, which no reader sees, with the name of a record::

    F of the mask is .827<!-- figure: many.fusion.f_mask --> on average
    the worst camera is `dn_tas500`<!-- figure: many.fusion.f_mask.worst.camera -->
    18.2 %<!-- figure: steady.left -->      (a share, said in percent)

A figure agrees when it is the record's value, rounded to as many digits as it is said with. A
table between ``<!-- table: NAME -->`` and ``<!-- end -->`` is written whole from records. What
stands between ``<!-- study: WHERE -->`` and ``<!-- end -->`` was measured once, by the commands
that WHERE names, and is compared with nothing.

Records are JSON: a list of {"name", "value", "unit", "command"}.
"""

import json
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

MINUS = "\N{MINUS SIGN}"

NUMBER = rf"[+{MINUS}-]?(?:\d{{1,3}}(?:,\d{{3}})+|\d+)?(?:\.\d+|(?<=\d))(?:\s?%)?"

MARK = re.compile(rf"(?P<said>`[^`\n]+`|{NUMBER})<!-- figure: (?P<key>\S[^\n>]*?) -->")

TABLE = re.compile(r"<!-- table: (?P<name>\S+) -->\n(?P<body>.*?)<!-- end -->", re.S)

STUDY = re.compile(r"<!-- study: [^\n]*? -->.*?<!-- end -->", re.S)

NO_FIGURES = (
    re.compile(r"^(?P<fence>```+|~~~+).*?^(?P=fence)", re.S | re.M),
    re.compile(r"`[^`\n]+`"),
    re.compile(r"(?<=\])\([^)\s]*\)"),  # where a link leads
    re.compile(r"<[^>]*>"),
    re.compile(r"https?://\S+"),
    re.compile(r"(?m)^\s*\d+\. "),  # numbered lists
    re.compile(r"\d+(?:,\d{3})*×\d+(?:,\d{3})*"),  # sizes of pictures
    re.compile(
        r"(?:Python|ROS|License|CC BY(?:-\w\w)*|arXiv|ECCV|ICPR|IVCNZ|Figs?\.|eq\.|Table) ?[\d.]+"
    ),
    re.compile(
        r"\b\w*[A-Za-z][\w:.-]*\d[\w.-]*|\b\d+-?[A-Za-z]\w*"
    ),  # CNN-7, P1, dn_tas500, 0001TP, 8-bit
    re.compile(r"\b95 %(?! of)"),  # the level of all intervals
)
"""What holds digits and is no figure: code, links, sizes, versions, years, names."""


class Record(NamedTuple):
    """A figure and its source."""

    value: float | str
    unit: str
    command: str


Records = Mapping[str, Record]
Tables = Mapping[str, Callable[[Records], str]]


def read_records(paths: Iterable[Path]) -> dict[str, Record]:
    """All records of some files; ValueError for a name that stands twice."""
    found: dict[str, Record] = {}
    for path in paths:
        for one in json.loads(path.read_text(encoding="utf-8")):
            if one["name"] in found:
                raise ValueError(f"{path}: {one['name']} is there twice (keep one)")
            found[one["name"]] = Record(one["value"], one["unit"], one["command"])
    return found


def write_records(path: Path, records: Records) -> None:
    """Write records, a line each, by name."""
    lines = [json.dumps({"name": name, **records[name]._asdict()}) for name in sorted(records)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


# --- one figure --------------------------------------------------------------------------


def restated(said: str, value: float | str) -> str:
    """A value in the words of an old figure: its digits, its sign, its percent.

    ".827" and .8312 → ".831"; "1,318" and 55 → "55"; "470,000" and 474,373 → "474,000"; "18 %"
    and .2 → "20 %"; "`a`" and "b" → "`b`". A minus is a true one.
    """
    if said.startswith("`"):
        return f"`{value}`"
    if isinstance(value, str):
        raise ValueError(f"{value!r} is no number")
    percent = re.search(r"\s?%$", said)
    digits = said.removesuffix(percent[0] if percent else "")
    places = len(digits.partition(".")[2])
    if not places and (zeros := len(digits) - len(digits.rstrip("0,"))) >= 3:
        places = -3 * (zeros // 4) if "," in digits else -zeros
    number = round(value * (100 if percent else 1), places)
    text = f"{abs(number):{',' if ',' in said else ''}.{max(places, 0)}f}"
    if places > 0 and re.match(rf"[+{MINUS}-]?\.", said):
        text = text.removeprefix("0")
    signed = said[0] in f"+-{MINUS}"
    sign = MINUS if number < 0 else "+" if signed else ""
    return sign + text + (percent[0] if percent else "")


def _agrees(said: str, value: float | str) -> bool:
    now = restated(said, value)
    return now == said or (not said.startswith("`") and now == said.replace("-", MINUS, 1))


# --- a document --------------------------------------------------------------------------


class Stale(NamedTuple):
    """Something in a document that is not as its source has it."""

    line: int
    what: str


def stale(text: str, records: Records, tables: Tables) -> list[Stale]:
    """Bound figures and tables of a document that differ from their sources."""
    found = []
    for one in MARK.finditer(text):
        line, said, key = _line(text, one.start()), one["said"], one["key"]
        if key not in records:
            found.append(Stale(line, f"{said}: no record is called {key}"))
        elif not _agrees(said, records[key].value):
            command = textwrap.shorten(records[key].command, 80, placeholder=" …")
            found.append(Stale(line, f"{said}: {key} is {records[key].value} ({command})"))
    for one in TABLE.finditer(text):
        line, name = _line(text, one.start()), one["name"]
        if name not in tables:
            found.append(Stale(line, f"no table is called {name}"))
            continue
        try:
            same = tables[name](records) == one["body"]
        except KeyError as missing:
            found.append(Stale(line, f"table {name}: no record is called {missing.args[0]}"))
            continue
        if not same:
            found.append(Stale(line, f"table {name} is not as its records have it"))
    return sorted(found)


def rewritten(text: str, records: Records, tables: Tables) -> str:
    """The document with every bound figure and table as its source has it.

    KeyError for a name without a record or table.
    """

    def figure(one: re.Match[str]) -> str:
        value = records[one["key"]].value
        said = one["said"] if _agrees(one["said"], value) else restated(one["said"], value)
        return f"{said}<!-- figure: {one['key']} -->"

    def table(one: re.Match[str]) -> str:
        return f"<!-- table: {one['name']} -->\n{tables[one['name']](records)}<!-- end -->"

    return MARK.sub(figure, TABLE.sub(table, text))


def bound(text: str) -> int:
    """How many figures of a document are bound; a table counts with all its numbers."""
    inside = "".join(one["body"] for one in TABLE.finditer(text))
    return len(MARK.findall(text)) + len(_numbers(_without_names(inside)))


def unbound(text: str) -> list[tuple[int, str]]:
    """(line, number) of every figure in a document that nothing is bound to."""
    for pattern in (TABLE, STUDY, MARK):
        text = pattern.sub(_blank, text)
    text = _without_names(text)
    return [(_line(text, one.start()), one[0]) for one in _numbers(text)]


def in_studies(text: str) -> int:
    """How many figures stand in studies that were measured once."""
    inside = "\n".join(one[0] for one in STUDY.finditer(text))
    return len(_numbers(_without_names(inside)))


def _without_names(text: str) -> str:
    for pattern in NO_FIGURES:
        text = pattern.sub(_blank, text)
    return text


def _numbers(text: str) -> list[re.Match[str]]:
    return list(re.finditer(r"\d[\d,]*(?:\.\d+)?|\.\d+", text))


def _blank(match: re.Match[str]) -> str:
    """Spaces and the same line breaks, so that lines keep their numbers."""
    return re.sub(r"[^\n]", " ", match[0])


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1


# --- tables ------------------------------------------------------------------------------

CELL = re.compile(r"\[\[(?P<optional>\??)(?P<key>[^|\]]+)\|(?P<style>[^\]]+)\]\]")


class Table(NamedTuple):
    """A table of records.

    header: the columns, the rows' first. rows: (what stands first, the word for {row} and, from
    its "@" on, for {at}). cells: of each further column, text in which ``[[name|style]]`` is a
    record's value in the style of a figure ("[[many.{row}.maxf|.000]]"); ``[[?name|style]]`` is a
    dash where there is none. sort: the record by which rows fall, with {row}; as given without.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]
    cells: tuple[str, ...]
    sort: str = ""

    def __call__(self, records: Records) -> str:
        """Markdown lines; KeyError for a missing record, ValueError for a missing header."""
        if len(self.header) != 1 + len(self.cells):
            raise ValueError(f"{len(self.header)} headers over {1 + len(self.cells)} columns")
        rows = self.rows
        if self.sort:
            rows = tuple(sorted(rows, key=lambda row: -_number(records, self.sort, row[1])))
        lines = [self.header, ("---",) * len(self.header)]
        for first, word in rows:
            texts = (CELL.sub(_cell(records), _with_word(one, word)) for one in self.cells)
            lines.append((first, *texts))
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _number(records: Records, key: str, word: str) -> float:
    return float(records[_with_word(key, word)].value)


def _with_word(text: str, word: str) -> str:
    row, at, group = word.partition("@")
    return text.replace("{row}", row).replace("{at}", at + group)


def _cell(records: Records) -> Callable[[re.Match[str]], str]:
    def text(one: re.Match[str]) -> str:
        if one["optional"] and one["key"] not in records:
            return "–"
        return restated(one["style"], records[one["key"]].value)

    return text


class _Recording(dict[str, Record]):
    """Records that are all there, and remember who asked."""

    def __missing__(self, key: str) -> Record:
        self[key] = Record(0.0, "", "")
        return self[key]

    def __contains__(self, key: Any) -> bool:
        return bool(self[key])


def names_used(texts: Iterable[str], tables: Tables) -> Iterator[str]:
    """The records that documents and tables name, each once."""
    asked = _Recording()
    for text in texts:
        for one in MARK.finditer(text):
            asked[one["key"]]
        for one in TABLE.finditer(text):
            if one["name"] in tables:
                tables[one["name"]](asked)
    yield from Counter(asked)
