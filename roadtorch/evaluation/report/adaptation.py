"""The page at the end of an adaptation: before and after, on one page."""

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
from roadtorch.evaluation.disagreement import Disagreement, Disagreements, Taught
from roadtorch.evaluation.report.charts import BASELINE, COLOURS, DASHES, WIDTH, Series, svg_uri
from roadtorch.evaluation.report.montage import BLUE, TILE_WIDTH, VERMILLION, captioned, jpeg_uri
from roadtorch.evaluation.report.table import (
    MINUS,
    NONE,
    Cell,
    Table,
    page_text,
    percent,
    share,
    signed,
)


@dataclass(frozen=True)
class Adaptation:
    """What a run changed.

    seen: the images as the detectors before and after see them; files: their weights. shown:
    the images on the page. taught: None for networks without a teacher's maps. rows: round,
    epoch and error of each epoch. verdict: whether to adopt it, and why; empty where nobody judged.
    """

    seen: Disagreements
    files: tuple[Path, Path]
    shown: Sequence[Disagreement]
    taught: Taught | None
    rows: Sequence[Mapping[str, Any]]
    verdict: str = ""


def write_adaptation(path: Path, adaptation: Adaptation, command: str = "") -> None:
    """Write the page: one file that asks for no other."""
    items = [image.item for image in adaptation.shown]
    caption = "only before blue, only after orange"
    sheets = both_sheets(adaptation.seen, items, caption)
    is_part = len(items) < len(adaptation.seen.images)
    loss_chart = svg_uri(WIDTH, 260, partial(draw_losses, rows=adaptation.rows))
    differs = [image.differs for image in adaptation.seen.images]
    values = {
        "one": adaptation,
        "mean": statistics.fmean(differs),
        "median": statistics.median(differs),
        "most": max(differs),
        "shown": list(zip(adaptation.shown, sheets, strict=True)),
        "half": len(items) - len(items) // 2 if is_part else len(items),
        "summary": summary_table(adaptation),
        "charts": [loss_chart, trust_chart(adaptation)],
    }
    write_text(path, page_text("adaptation.html", command, values))


def both_sheets(seen: Disagreements, items: Iterable[LabelledItem], caption: str) -> list[str]:
    """Return for each item a JPEG for the page: the overlays of both, and what differs."""
    looks = {contender.name: contender.prepare(seen.dataset) for contender in seen.methods}
    sheets = []
    for item in items:
        image = read_image(item.image)
        with image_cache():
            masks = {name: look(image, item).mask.numpy() for name, look in looks.items()}
        pixels = to_pixels(image)
        tiles = {name: tint_mask(pixels, mask) for name, mask in masks.items()}
        tiles[caption] = differing(pixels, *masks.values())
        height = round(pixels.shape[0] * TILE_WIDTH / pixels.shape[1])
        sheet = np.concatenate([captioned(t, text, height) for text, t in tiles.items()], axis=1)
        sheets.append(jpeg_uri(sheet))
    return sheets


def differing(pixels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return pixels uint8 (H,W,3), grey, with what one mask (H,W) alone has in blue or orange."""
    grey = np.repeat(pixels.mean(2, keepdims=True), 3, axis=2) * 0.7
    for mask, colour in ((first & ~second, BLUE), (second & ~first, VERMILLION)):
        grey[mask] = 0.35 * grey[mask] + 0.65 * np.array(colour)
    return grey.round().astype(np.uint8)


def summary_table(adaptation: Adaptation) -> Table:
    """What can be said without a label: road, trust and agreement before and after."""
    images, rows = adaptation.seen.images, {}
    road = [(image.first, image.second) for image in images]
    rows["share of road"] = _row(*map(statistics.fmean, zip(*road, strict=True)))
    if trusts := [(image.first_trust, image.second_trust) for image in images if image.has_trust]:
        before, after = map(statistics.fmean, zip(*trusts, strict=True))
        rose = sum(second > first for first, second in trusts)
        fell = sum(second < first for first, second in trusts)
        change = Cell(signed(after - before), note=f"rose on {rose}, fell on {fell} images")
        rows["trust"] = (Cell(share(before)), Cell(share(after)), change)
    if adaptation.taught is not None:
        before, after = adaptation.taught.before, adaptation.taught.after
        rows["agrees with the teacher on road"] = _row(before.road, after.road)
        rows["agrees with the teacher on layout"] = _row(before.layout, after.layout)
    table = Table("mean over the images", list(rows))
    for place, header in enumerate(("before", "after", "change")):
        table.add(header, [row[place] for row in rows.values()])
    return table


def _row(before: float, after: float) -> tuple[Cell, Cell, Cell]:
    """Return two fractions, and the difference in points of a per cent."""
    change = NONE if math.isnan(before + after) else f"{100 * (after - before):+.1f} points"
    return Cell(percent(before)), Cell(percent(after)), Cell(change.replace("-", MINUS))


# --- charts ------------------------------------------------------------------------------


def draw_losses(figure: Figure, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw the mean loss of the epochs, one line a round."""
    axes = figure.subplots()
    rounds = sorted({row["round"] for row in rows})
    for place, number in enumerate(rounds):
        own = [row for row in rows if row["round"] == number]
        line = place % len(COLOURS)
        series = Series(f"round {number}", COLOURS[line], DASHES[line])
        epochs, losses = ([row[key] for row in own] for key in ("epoch", "loss"))
        axes.plot(epochs, losses, marker=".", label=series.name, **series.line(1.5))
    axes.set(xlabel="epoch", ylabel="mean loss of the epoch")
    if len(rounds) > 1:
        axes.legend()


def trust_chart(adaptation: Adaptation) -> str:
    """Return a chart of trust after over trust before, a mark an image; empty without trust."""
    pairs = [
        (image.first_trust, image.second_trust)
        for image in adaptation.seen.images
        if image.has_trust
    ]
    if not pairs:
        return ""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=BASELINE, linewidth=1)
        before, after = zip(*pairs, strict=True)
        axes.plot(before, after, "o", color=COLOURS[0], mfc="none", markersize=5)
        low = max(0.0, min(*before, *after) - 0.05)
        axes.set(xlabel="trust before", ylabel="trust after", xlim=(low, 1), ylim=(low, 1))

    return svg_uri(WIDTH, 260, draw)
