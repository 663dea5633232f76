"""Page at the end of an adaptation: masks, trust and agreement before and after."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from roadtorch.base.atomic import write_text
from roadtorch.base.image import read_image, tint_mask, to_pixels
from roadtorch.base.image_cache import image_cache
from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation.disagreement import Disagreement, Disagreements, TeacherAgreement
from roadtorch.evaluation.measure import UNDEFINED
from roadtorch.evaluation.report.charts import COLOURS, DASHES, GREY, PANEL_WIDTH, Series, svg_uri
from roadtorch.evaluation.report.montage import BLUE, TILE_WIDTH, VERMILLION, caption_tile, jpeg_uri
from roadtorch.evaluation.report.table import (
    MINUS,
    Cell,
    Table,
    format_number,
    format_percent,
    format_signed,
    render_page,
)


@dataclass(frozen=True)
class Adaptation:
    """Changes by an adaptation."""

    comparison: Disagreements  # masks before and after
    files: tuple[Path, Path]  # the two weight files
    examples: Sequence[Disagreement]  # images on the page
    agreement: TeacherAgreement | None  # None for networks without a teacher's maps
    epochs: Sequence[Mapping[str, Any]]  # round, epoch and loss of each
    verdict: str = ""  # whether to adopt it, and why; empty without a verdict


def write_adaptation(path: Path, adaptation: Adaptation, command: str = "") -> None:
    """Write the page as one self-contained file."""
    items = [image.item for image in adaptation.examples]
    montages = draw_montages(adaptation.comparison, items, "blue: only before, orange: only after")
    is_part = len(items) < len(adaptation.comparison.images)
    loss_chart = svg_uri(PANEL_WIDTH, 260, partial(draw_losses, rows=adaptation.epochs))
    differences = [image.difference for image in adaptation.comparison.images]
    values = {
        "comparison": adaptation.comparison,
        "agreement": adaptation.agreement,
        "files": adaptation.files,
        "verdict": adaptation.verdict,
        "mean": statistics.fmean(differences),
        "median": statistics.median(differences),
        "maximum": max(differences),
        "examples": list(zip(adaptation.examples, montages, strict=True)),
        "half": len(items) - len(items) // 2 if is_part else len(items),
        "summary": summary_table(adaptation),
        "charts": [loss_chart, trust_chart(adaptation)],
    }
    write_text(path, render_page("adaptation.html", command, values))


def draw_montages(pair: Disagreements, items: Iterable[LabelledItem], caption: str) -> list[str]:
    """Return for each item a JPEG for the page: the two overlays, and their difference."""
    predictors = {method.name: method.prepare(pair.dataset) for method in pair.methods}
    montages = []
    for item in items:
        image = read_image(item.image)
        with image_cache():
            masks = {n: predict(image, item).mask.numpy() for n, predict in predictors.items()}
        pixels = to_pixels(image)
        tiles = {name: tint_mask(pixels, mask) for name, mask in masks.items()}
        tiles[caption] = difference_tile(pixels, *masks.values())
        height = round(pixels.shape[0] * TILE_WIDTH / pixels.shape[1])
        montage = np.hstack([caption_tile(tile, text, height) for text, tile in tiles.items()])
        montages.append(jpeg_uri(montage))
    return montages


def difference_tile(pixels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return grey pixels, uint8 (H, W, 3), with road of one mask (H, W) alone in blue or orange."""
    grey = np.repeat(pixels.mean(2, keepdims=True), 3, axis=2) * 0.7
    for mask, colour in ((first & ~second, BLUE), (second & ~first, VERMILLION)):
        grey[mask] = 0.35 * grey[mask] + 0.65 * np.array(colour)
    return grey.round().astype(np.uint8)


def summary_table(adaptation: Adaptation) -> Table:
    """Return means before and after that need no labels: road, trust, agreement."""
    images, rows = adaptation.comparison.images, {}
    road = [(image.first_road, image.second_road) for image in images]
    rows["fraction of road"] = _row(*map(statistics.fmean, zip(*road, strict=True)))
    if trusts := [(image.first_trust, image.second_trust) for image in images if image.has_trust]:
        start, end = map(statistics.fmean, zip(*trusts, strict=True))
        rose = sum(second > first for first, second in trusts)
        fell = sum(second < first for first, second in trusts)
        change = Cell(format_signed(end - start), note=f"rose on {rose}, fell on {fell} images")
        rows["trust"] = (Cell(format_number(start)), Cell(format_number(end)), change)
    if adaptation.agreement is not None:
        start, end = adaptation.agreement.initial, adaptation.agreement.final
        rows["agreement with the teacher on road"] = _row(start.road, end.road)
        rows["agreement with the teacher on layout"] = _row(start.layout, end.layout)
    table = Table("mean over the images", list(rows))
    for index, header in enumerate(("before", "after", "change")):
        table.add(header, [row[index] for row in rows.values()])
    return table


def _row(start: float, end: float) -> tuple[Cell, Cell, Cell]:
    """Return two fractions, and their difference in percentage points."""
    change = UNDEFINED if math.isnan(start + end) else f"{100 * (end - start):+.1f} points"
    return Cell(format_percent(start)), Cell(format_percent(end)), Cell(change.replace("-", MINUS))


# --- charts ------------------------------------------------------------------------------


def draw_losses(figure: Figure, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw the mean loss of the epochs, one line a round."""
    axes = figure.subplots()
    rounds = sorted({row["round"] for row in rows})
    for index, number in enumerate(rounds):
        epoch_rows = [row for row in rows if row["round"] == number]
        line = index % len(COLOURS)
        series = Series(f"round {number}", COLOURS[line], DASHES[line])
        epochs, losses = ([row[key] for row in epoch_rows] for key in ("epoch", "loss"))
        axes.plot(epochs, losses, marker=".", label=series.name, **series.line(1.5))
    axes.set(xlabel="epoch", ylabel="mean loss of the epoch")
    if len(rounds) > 1:
        axes.legend()


def trust_chart(adaptation: Adaptation) -> str:
    """Return a chart of trust after over trust before, a mark an image; empty without trust."""
    images = adaptation.comparison.images
    pairs = [(image.first_trust, image.second_trust) for image in images if image.has_trust]
    if not pairs:
        return ""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=GREY, linewidth=1)
        start, end = zip(*pairs, strict=True)
        axes.plot(start, end, "o", color=COLOURS[0], mfc="none", markersize=5)
        low = max(0.0, min(*start, *end) - 0.05)
        axes.set(xlabel="trust before", ylabel="trust after", xlim=(low, 1), ylim=(low, 1))

    return svg_uri(PANEL_WIDTH, 260, draw)
