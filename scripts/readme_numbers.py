"""Which numbers a page says of what ships today without a record behind them.

A number counts that somebody has measured: one with a fraction, in percent, or of a unit (seconds,
bytes, pixels apart, pictures …). It has to be bound to a record (scripts/readme_figures.py), or be
of a study: of a paragraph that names the commit and the date at which it was measured::

    F rose by .031 (at 3f5c3f1, 2026-10-30).

or of a section or a page whose first paragraph says ``Measured at 3f5c3f1, 2026-10-30``. Code,
addresses, formulas, and what is part of a name are no numbers here.
"""

import re
from collections.abc import Iterator

STUDY = re.compile(r"\bat (?P<commit>[0-9a-f]{7}), (?P<date>\d{4}-\d\d-\d\d)\b")
SECTION_STUDY = re.compile(rf"^Measured {STUDY.pattern}", re.M)

HIDDEN = (
    r"<!-- table: \S+ -->\n.*?<!-- end -->",
    r"^( *)(`{3,}).*?^\1\2 *$",  # code
    r"\$\$.*?\$\$|\$[^$\n]+\$",  # formulas
    r"(?:`[^`\n]+`|[^\s(`|]+(?:\s%)?)<!-- figure: [^\n>]*? -->",  # bound
    r"<!--.*?-->",
    r"`[^`\n]*`",
    r"\]\([^)\s]*\)|https?://\S+",  # addresses
    r"\b(?:arXiv|Python|torch|ROS|License|BY|BY-NC-SA|Fig\.|Figs\.|Table|eq\.|§) ?[\d.]*\d"
    r"(?:(?:,| or| to) [\d.]+\d)*",  # names
    r"\b95 %",  # the level of every interval
)
"""What holds no numbers of the page's own, in this order."""

UNITS = (
    *("ms", "s", "seconds?", "minutes?", "hours?", "[KMG]i?B", "bytes", "Hz", "fps"),
    *("cm", "m", "degrees", "times", "pixels", "images", "frames", "worlds", "weights"),
    r"(?:(?:real|rendered|free) )?(?:pictures|streets)",
)
MEASURED = re.compile(
    r"(?<![\w.,/-])"
    r"(?:[+\N{MINUS SIGN}×]?\d*\.\d+(?![\w.]*\d)|\d[\d,]* ?%"
    rf"|\d[\d,]*\s(?:{'|'.join(UNITS)})\b)"
)

HEADING = re.compile(r"^#{1,6} .*$", re.M)


def unbound(page: str) -> list[str]:
    """The numbers of a page (Markdown) that neither a record nor a study stands behind."""
    for pattern in HIDDEN:
        page = re.sub(pattern, " ", page, flags=re.M | re.S)
    top, *sections = re.split(rf"(?={HEADING.pattern})", page.lstrip(), flags=re.M)
    sections = [top, *sections] if top else sections
    if sections and SECTION_STUDY.search(sections[0]):
        return []
    return [number for section in sections for number in _unbound_in(section)]


def _unbound_in(section: str) -> Iterator[str]:
    if SECTION_STUDY.search(section):
        return
    for paragraph in re.split(r"\n\s*\n|^\s*[-*] ", section, flags=re.M):
        if not STUDY.search(paragraph):
            yield from (match[0] for match in MEASURED.finditer(paragraph))


def studies(page: str) -> Iterator[tuple[str, str]]:
    """Commit and date of each study of a page."""
    yield from ((match["commit"], match["date"]) for match in STUDY.finditer(page))
