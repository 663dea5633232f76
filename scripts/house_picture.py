"""Rows of boxes as SVG, with the arrows between rows in lanes beside them.

Plain text in the reader's own fonts, no dates, no files: the same rows give the same bytes.
Lengths are pixels. Text is set in a fixed pitch, so that its width is known here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

WIDTH = 1200
TITLES = 180  # the width of the rows' titles at the left
COUNTS = 30  # the width of the arrows' counts, in the band's right end
LANE = 21  # between the lanes at the right, one for each row that imports
SLOT = 13  # between the arrows that end in one row
GAP = 10  # between boxes, and around them
ROW_GAP = 6
LETTER = 7.3  # the width of a letter of 12 pixels, with a little air
LINE = 17  # from one line of text to the next
HEAD = 6  # the length of an arrow's head
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#b0578d", "#8a6500", "#1f7ea8", "#444444")
"""Those of Okabe and Ito (2008), dark enough for thin lines on white."""

STYLE = """<style>
text { font: 12px ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; fill: #222222 }
.row { font: 600 14px system-ui, "Segoe UI", "DejaVu Sans", sans-serif }
.room { font-weight: 600 }
.lines, .count { fill: #6a6a6a }
.count { font-size: 10px }
</style>"""


@dataclass(frozen=True)
class Box:
    """A room. lines: of code; names: what is inside, none for a single module."""

    title: str
    lines: int
    names: Sequence[str]


@dataclass(frozen=True)
class Band:
    """A row of boxes, from left to right."""

    title: str
    boxes: Sequence[Box]


@dataclass(frozen=True)
class Arrow:
    """Imports between two rows, which are counted from the top; ``count`` of them."""

    source: int
    target: int
    count: int


@dataclass(frozen=True)
class _Placed:
    """A box with its texts and its place inside its band."""

    box: Box
    texts: Sequence[str]
    x: float
    y: float
    width: float

    @property
    def height(self) -> float:
        return LINE * (1 + len(self.texts)) + 10


def picture(bands: Sequence[Band], arrows: Sequence[Arrow], caption: str) -> str:
    """The SVG of bands from top to bottom, of arrows between them, and of a line below."""
    sources = sorted({arrow.source for arrow in arrows})
    lanes = {source: WIDTH - LANE * (len(sources) - index) for index, source in enumerate(sources)}
    right = min(lanes.values(), default=WIDTH) - LANE
    parts, tops, y = [], [], GAP
    for index, band in enumerate(bands):
        placed = _place(band.boxes, right)
        ends = sum(arrow.target == index for arrow in arrows)
        inside = max((one.y + one.height for one in placed), default=LINE)
        height = max(inside + GAP, SLOT * (ends + 2))
        parts += _draw_band(band, placed, y, height, right)
        tops.append((y, y + height))
        y += height + ROW_GAP
    parts += _draw_arrows(arrows, lanes, tops, right)
    parts.append(_text(2 * GAP, y + LINE, caption, "lines"))
    return _document(parts, y + LINE + GAP)


def _document(parts: Sequence[str], height: float) -> str:
    size = f'width="{WIDTH}" height="{height:g}" viewBox="0 0 {WIDTH} {height:g}"'
    start = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>'
    paper = f'<rect width="{WIDTH}" height="{height:g}" fill="#ffffff"/>'
    return "\n".join([start, STYLE, paper, *parts, "</svg>", ""])


def _place(boxes: Sequence[Box], right: float) -> list[_Placed]:
    """Boxes side by side; those that do not fit begin a new line."""
    folders = sum(bool(box.names) for box in boxes) or 1
    widest = (right - TITLES - COUNTS + GAP) / folders - GAP
    placed, x, y, bottom = [], TITLES, GAP, GAP
    for box in boxes:
        texts = _wrapped(box.names, int((widest - 2 * GAP) / LETTER))
        longest = max(len(text) for text in (f"{box.title} {box.lines}", *texts))
        width = longest * LETTER + 2 * GAP
        if x + width > right - COUNTS:
            x, y = TITLES, bottom + GAP
        placed.append(_Placed(box, texts, x, y, width))
        x += width + GAP
        bottom = max(bottom, y + placed[-1].height)
    return placed


def _wrapped(names: Sequence[str], letters: int) -> list[str]:
    """Names in lines of at most so many letters; a longer name has its own line."""
    lines: list[str] = []
    for name in names:
        if lines and len(f"{lines[-1]}  {name}") <= letters:
            lines[-1] += f"  {name}"
        else:
            lines.append(name)
    return lines


def _draw_band(
    band: Band, placed: Sequence[_Placed], top: float, height: float, right: float
) -> list[str]:
    parts = [
        f'<rect x="{GAP}" y="{top:g}" width="{right - GAP:g}" height="{height:g}" fill="#f3f5f8"/>',
        _text(2 * GAP, top + GAP + LINE, band.title, "row"),
    ]
    for one in placed:
        x, y = one.x, top + one.y
        parts += [
            f'<rect x="{x:g}" y="{y:g}" width="{one.width:g}" height="{one.height:g}" rx="3" '
            'fill="#ffffff" stroke="#b8c0cc"/>',
            _text(x + GAP, y + LINE, one.box.title, "room"),
            _text(
                x + GAP + (len(one.box.title) + 1) * LETTER, y + LINE, f"{one.box.lines}", "lines"
            ),
        ]
        for index, text in enumerate(one.texts, 2):
            parts.append(_text(x + GAP, y + LINE * index, text))
    return parts


def _text(x: float, y: float, text: str, kind: str = "") -> str:
    role = f' class="{kind}"' if kind else ""
    # Spaces side by side would fall together.
    return f'<text x="{x:g}" y="{y:g}"{role} xml:space="preserve">{escape(text)}</text>'


def _draw_arrows(
    arrows: Sequence[Arrow],
    lanes: dict[int, int],
    tops: Sequence[tuple[float, float]],
    right: float,
) -> list[str]:
    """For each row that imports: out to its lane, along it, and into every row it imports."""
    parts, slots = [], [top + SLOT for top, _ in tops]
    for index, (source, lane) in enumerate(lanes.items()):
        colour = COLOURS[index % len(COLOURS)]
        line = f'stroke="{colour}" fill="none"'
        start = tops[source][1] - SLOT / 2
        ends = [start]
        for arrow in (one for one in arrows if one.source == source):
            y = slots[arrow.target]
            slots[arrow.target] += SLOT
            ends.append(y)
            width = min(0.75 + arrow.count / 12, 4)
            parts += [
                f'<path d="M{lane} {y:g}H{right + HEAD:g}" stroke-width="{width:.2f}" {line}/>',
                f'<path d="M{right:g} {y:g}l{HEAD} -3.5v7z" fill="{colour}"/>',
                _text(right - COUNTS + 6, y + 3.5, f"{arrow.count:>3}", "count"),
            ]
        parts += [
            f'<circle cx="{right:g}" cy="{start:g}" r="3" fill="{colour}"/>',
            f'<path d="M{right:g} {start:g}H{lane}M{lane} {min(ends):g}V{max(ends):g}" {line}/>',
        ]
    return parts
