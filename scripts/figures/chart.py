"""What the figures of P3 have in common: a small PNG chart, a table on the screen and as CSV."""

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image
from torch import Tensor

from roadtorch.base.atomic import atomic, csv_text, write_text
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.metrics import auc, count_levels
from roadtorch.evaluation.report.charts import STYLE
from roadtorch.evaluation.report.table import aligned
from roadtorch.imaging.color import PLANES
from roadtorch.oneclass.axes import circular_mean, unrolled

DOTS = 100  # per inch
COLOURS = 128  # of a chart's file: lines and their soft edges need no more
FOLDERS = {"camvid": "camvid", "idd-lite": "idd_lite", "folder": "many"}
"""Where each set lies below the folder DATA."""


def open_sets(data: Path, *names: str) -> list[Dataset]:
    """The named sets below the folder of data."""
    return [open_dataset(name, data / FOLDERS[name]) for name in names]


@contextmanager
def chart(path: Path, width: float, height: float, dots: int = DOTS) -> Iterator[Figure]:
    """A figure of so many inches to draw on, in the report's style; written as PNG at the end."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        matplotlib.rcParams.update({"font.size": 8, "axes.titlesize": 8})
        matplotlib.rcParams.update(
            {"axes.labelsize": 8, "xtick.labelsize": 7, "ytick.labelsize": 7}
        )
        figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
        yield figure
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=dots)
    few = Image.open(drawn).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    with atomic(path) as temporary:
        few.save(temporary, format="PNG", optimize=True)


def tell(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, object]]) -> None:
    """Print a table and write it as CSV, numbers with three decimals."""
    cells = [{key: _cell(value) for key, value in row.items()} for row in rows]
    print(aligned([columns, *([row.get(name, "") for name in columns] for row in cells)]))
    write_text(path, csv_text(columns, cells))


def _cell(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


# --- of planes --------------------------------------------------------------------------


def middle(values: Tensor, name: str) -> Tensor:
    """The median of values (n,) of a plane; of hue along the circle, seen from the mean."""
    if not PLANES[name].circular:
        return values.median()
    mean = circular_mean(values)
    return (unrolled(values, mean).median() + mean).remainder(1)


def apart(one: Tensor, other: Tensor, name: str) -> Tensor:
    """How far values of a plane are from others, ≥ 0; of hue along the circle."""
    return (unrolled(one, other) if PLANES[name].circular else one - other).abs()


def spread(values: Tensor, name: str) -> float:
    """Root of the mean squared distance of values (n,) of a plane from their mean."""
    mean = circular_mean(values) if PLANES[name].circular else values.mean()
    return float(apart(values, mean, name).square().mean().sqrt())


# --- of detectors -----------------------------------------------------------------------


def area_of(name: str, image: Tensor, road: Tensor, valid: Tensor, **settings: Any) -> float:
    """AUC of a detector's likelihood in one picture; NaN without road or background."""
    return float(
        auc(count_levels(load_detector(name, **settings).detect(image).likelihood, road, valid))
    )
