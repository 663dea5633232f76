"""Page at the end of an adaptation: masks, trust and agreement before and after."""

import math
import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from roadtorch.base.atomic import write_text
from roadtorch.base.bounded import plural
from roadtorch.base.image import read_image, tint_mask, to_pixels
from roadtorch.base.image_cache import image_cache
from roadtorch.evaluation.disagreement import Disagreement, Disagreements, TeacherAgreement
from roadtorch.evaluation.measure import UNDEFINED
from roadtorch.evaluation.report.charts import COLOURS, DASHES, GREY, PANEL_WIDTH, Series, svg_uri
from roadtorch.evaluation.report.montage import BLUE, VERMILLION, hstack_tiles, jpeg_uri
from roadtorch.evaluation.report.table import (
    MINUS,
    Cell,
    Section,
    Table,
    format_number,
    format_percent,
    format_signed,
    render_page,
)

NOTE = (
    "Trust is the predicted F of the mask. It depends on the agreement of the detector's parts, so "
    "training with this teacher may raise it without better masks. The agreement is that of the "
    "network alone, on the pixels where the teacher is confident."
)

ORDER = (
    "The largest difference first; if not all are shown, half are evenly spread over the others."
)
TRUST_CAPTION = "Trust before and after: a mark is an image; above the line trust rose."


def write_adaptation(
    path: Path,
    comparison: Disagreements,
    files: tuple[Path, Path],
    examples: Sequence[Disagreement],
    agreement: TeacherAgreement | None,
    epochs: Sequence[Mapping[str, float]],
    verdict: str = "",
    command: str = "",
) -> None:
    """Write the page as one self-contained file.

    comparison: masks before and after. files: the two weight files. examples: images to show.
    agreement: None for networks without a teacher's maps. epochs: round, epoch and loss of each.
    verdict: whether to adopt the network, and why.
    """
    differences = [image.difference for image in comparison.images]
    average, median, largest = (
        format_percent(function(differences))
        for function in (statistics.fmean, statistics.median, max)
    )
    losses = svg_uri(PANEL_WIDTH, 260, partial(draw_losses, rows=epochs))
    weights = Table("weights", ["before", "after"])
    weights.add("file", [Cell(str(file)) for file in files])
    weights.add("threshold", [Cell(format_number(m.threshold)) for m in comparison.methods])
    images = list(draw_montages(comparison, examples))
    charts = [("Mean loss of the epochs", losses), *trust_chart(comparison.images)]
    page = render_page(
        "Before and after the adaptation",
        f"Masks of {len(differences)} images with the initial and with the final weights differ on "
        f"{average} of the pixels on average (median {median}, maximum {largest}). The images have "
        "no labels: the page shows what changed, not what is correct.",
        [
            Section("Without labels", NOTE, [summary_table(comparison, agreement)], charts=charts),
            Section(f"Before and after, {plural(len(images), 'image')}", ORDER, images=images),
            Section("Weights", tables=[weights]),
        ],
        verdict=verdict,
        failures=comparison.failures,
        command=command,
    )
    write_text(path, page)


def draw_montages(
    comparison: Disagreements, examples: Iterable[Disagreement]
) -> Iterator[tuple[str, str]]:
    """Yield caption and image of each example: the two overlays, and their difference."""
    predictors = {m.name: m.prepare(comparison.dataset) for m in comparison.methods}
    for example in examples:
        image = read_image(example.item.image)
        with image_cache():
            detections = {n: predict(image, example.item) for n, predict in predictors.items()}
        pixels, masks = to_pixels(image), {n: d.mask.numpy() for n, d in detections.items()}
        tiles = {name: tint_mask(pixels, mask) for name, mask in masks.items()}
        tiles["blue: only before, orange: only after"] = difference_tile(pixels, *masks.values())
        caption = (
            f"{example.item.name}: {format_percent(example.difference)} of the pixels differ; road "
            f"{format_percent(example.first_road)} → {format_percent(example.second_road)}; trust "
            f"{format_number(example.first_trust)} → {format_number(example.second_trust)}"
        )
        yield caption, jpeg_uri(hstack_tiles(tiles, pixels.shape[:2]))


def difference_tile(pixels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return grey pixels, uint8 (H, W, 3), with road of one mask (H, W) alone in blue or orange."""
    grey = np.repeat(pixels.mean(2, keepdims=True), 3, axis=2) * 0.7
    for mask, colour in ((first & ~second, BLUE), (second & ~first, VERMILLION)):
        grey[mask] = 0.35 * grey[mask] + 0.65 * np.array(colour)
    return grey.round().astype(np.uint8)


def summary_table(comparison: Disagreements, agreement: TeacherAgreement | None) -> Table:
    """Return means before and after that need no labels: road, trust, agreement."""
    images, rows = comparison.images, {}
    starts, ends = ([getattr(i, side) for i in images] for side in ("first_road", "second_road"))
    rows["fraction of road"] = _row(statistics.fmean(starts), statistics.fmean(ends))
    if trusts := [(image.first_trust, image.second_trust) for image in images if image.has_trust]:
        start, end = map(statistics.fmean, zip(*trusts, strict=True))
        rose = sum(second > first for first, second in trusts)
        fell = sum(second < first for first, second in trusts)
        change = Cell(format_signed(end - start), note=f"rose on {rose}, fell on {fell} images")
        rows["trust"] = (Cell(format_number(start)), Cell(format_number(end)), change)
    if agreement is not None:
        teacher, initial, final = agreement
        note, key = f"{final.images} prepared images", f"agreement with the teacher {teacher} on"
        rows[f"{key} road"] = _row(initial.road, final.road, note)
        rows[f"{key} layout"] = _row(initial.layout, final.layout, note)
    table = Table("mean over the images", list(rows))
    for index, header in enumerate(("before", "after", "change")):
        table.add(header, [row[index] for row in rows.values()])
    return table


def _row(start: float, end: float, note: str = "") -> tuple[Cell, Cell, Cell]:
    """Return two fractions, and their difference in percentage points."""
    change = UNDEFINED if math.isnan(start + end) else f"{100 * (end - start):+.1f} points"
    difference = Cell(change.replace("-", MINUS), note=note)
    return Cell(format_percent(start)), Cell(format_percent(end)), difference


# --- charts ------------------------------------------------------------------------------


def draw_losses(figure: Figure, rows: Sequence[Mapping[str, float]]) -> None:
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


def trust_chart(images: Sequence[Disagreement]) -> list[tuple[str, str]]:
    """Return a chart of trust after over trust before, with its caption; empty without trust."""
    pairs = [(image.first_trust, image.second_trust) for image in images if image.has_trust]
    if not pairs:
        return []

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=GREY, linewidth=1)
        start, end = zip(*pairs, strict=True)
        axes.plot(start, end, "o", color=COLOURS[0], mfc="none", markersize=5)
        low = max(0.0, min(*start, *end) - 0.05)
        axes.set(xlabel="trust before", ylabel="trust after", xlim=(low, 1), ylim=(low, 1))

    return [(TRUST_CAPTION, svg_uri(PANEL_WIDTH, 260, draw))]
