"""What the figures have in common: a small PNG chart, and a table on the screen and as CSV."""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from roadtorch.base.atomic import atomic_write, csv_text, write_text
from roadtorch.evaluation.report.charts import STYLE
from roadtorch.evaluation.report.table import align_columns

DOTS = 100  # per inch
COLOURS = 128  # of a chart's file: lines and their soft edges need no more
SIZES = dict.fromkeys(("font.size", "axes.titlesize", "axes.labelsize"), 8)
SIZES |= dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), 7)


@contextmanager
def chart(path: Path, width: float, height: float, dots: int = DOTS) -> Iterator[Figure]:
    """Yield a figure of so many inches in the report's style, and write it as PNG."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(dict[Any, Any](STYLE | SIZES))
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
        yield figure
        png = io.BytesIO()
        figure.savefig(png, dpi=dots)
    image = Image.open(png).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    with atomic_write(path) as temporary:
        image.save(temporary, format="PNG", optimize=True)


def show_table(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Print a table and write it as CSV, numbers with three decimals."""
    columns = list(rows[0])
    styles = {True: "{:.3f}", False: "{}"}
    cells = [{k: styles[isinstance(v, float)].format(v) for k, v in row.items()} for row in rows]
    print(align_columns([columns, *([row.get(name, "") for name in columns] for row in cells)]))
    write_text(path, csv_text(columns, cells))
