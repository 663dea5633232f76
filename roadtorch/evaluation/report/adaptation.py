"""Page at the end of a training: masks, scores and trust before and after."""

import statistics
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from roadtorch.base.atomic import write_text
from roadtorch.base.bounded import plural
from roadtorch.base.image import tint_mask, to_pixels
from roadtorch.base.image_cache import image_cache
from roadtorch.evaluation.disagreement import Disagreement, Disagreements
from roadtorch.evaluation.metrics import f_measure
from roadtorch.evaluation.report import montage
from roadtorch.evaluation.report.charts import COLOURS, DASHES, GREY, PANEL_WIDTH, Series, svg_uri
from roadtorch.evaluation.report.table import (
    Cell,
    Section,
    Table,
    format_number,
    format_percent,
    format_signed,
    render_page,
)
from roadtorch.evaluation.report.tables import build_tables
from roadtorch.evaluation.result import Evaluation

NOTES = {
    "Held-out images": "They did not train, but chose the epoch: F after is slightly too high. "
    "Intervals resample images and are too narrow for frames of one drive; the column 95 % is that "
    "of MaxF. Grey rows ignore the image. F by epoch is the network's alone.",
    "Images that trained": "Where they are labelled, their labels trained the network.",
    "Without labels": "The page shows what changed, not what is correct.",
}
"""Notes on the images of a page, by the title of their section."""

TRUST_NOTE = (
    "Trust is the predicted F of the mask. It depends on the agreement of the detector's parts, so "
    "training may raise it without better masks."
)

ORDER = (
    "The largest difference first; if not all are shown, half are evenly spread over the others. "
    "Line: road of the labels, where there are some, and void is dark."
)
TRUST_CAPTION = "Trust before and after: a mark is an image; above the line trust rose."


def write_adaptation(
    path: Path,
    comparison: Disagreements,
    files: tuple[Path, Path],
    examples: Sequence[Disagreement],
    epochs: Sequence[Mapping[str, float]],
    evaluation: Evaluation | None,
    evidence: str,
    **texts: str,
) -> None:
    """Write the page as one self-contained file.

    comparison: masks before and after. files: the two weight files. examples: images to show.
    epochs: of ``RunFolder.read_log``. evaluation: scores of both, if there are labels. evidence:
    key of ``NOTES``. texts: verdict, whether to adopt the network, and why; use and command,
    command lines.
    """
    differences = [image.difference for image in comparison.images]
    average, largest = map(format_percent, (statistics.fmean(differences), max(differences)))
    charts = [
        (title, svg_uri(PANEL_WIDTH, 260, partial(draw_epochs, rows=epochs, key=key)))
        for key, title in CURVES.items()
        if key in epochs[0]
    ]
    weights = Table("weights", ["before", "after"])
    weights.add("file", [Cell(str(file)) for file in files])
    images = list(draw_montages(comparison, examples, evaluation))
    tables = build_tables(evaluation) if evaluation else []
    tables.append(summary_table(comparison))
    charts += trust_chart(comparison.images)
    page = render_page(
        "Before and after the training",
        f"Masks of {len(differences)} images with the initial and with the final weights differ on "
        f"{average} of the pixels on average, {largest} at most.",
        [
            Section(evidence, f"{NOTES[evidence]} {TRUST_NOTE}", tables, charts=charts),
            Section(f"Before and after, {plural(len(images), 'image')}", ORDER, images=images),
            Section("Weights", tables=[weights]),
        ],
        failures=comparison.failures,
        **texts,
    )
    write_text(path, page)


def draw_montages(
    comparison: Disagreements, examples: Iterable[Disagreement], evaluation: Evaluation | None
) -> Iterator[tuple[str, str]]:
    """Yield caption and image of each example: the two overlays, and their difference."""
    predictors = {m.name: m.prepare(comparison.dataset) for m in comparison.methods}
    f_by_image = dict[str, tuple[float, ...]]()
    if evaluation:
        tables = [evaluation.tallies[name].table() for name in predictors]
        pairs = zip(*(f_measure(table.mask).tolist() for table in tables), strict=True)
        f_by_image = dict(zip(tables[0].names, pairs, strict=True))
    for example in examples:
        image, truth = comparison.dataset.read(example.item)
        with image_cache():
            detections = {n: predict(image, example.item) for n, predict in predictors.items()}
        pixels, masks = to_pixels(image), {n: d.mask.numpy() for n, d in detections.items()}
        tiles = {name: tint_mask(pixels, mask) for name, mask in masks.items()}
        if truth.valid.any():
            tiles = {n: montage.decision_tile(image, d.mask, truth) for n, d in detections.items()}
        tiles["blue: only before, orange: only after"] = difference_tile(pixels, *masks.values())
        caption = (
            f"{example.item.name}: {format_percent(example.difference)} of the pixels differ; road "
            f"{format_percent(example.first_road)} → {format_percent(example.second_road)}; trust "
            f"{format_number(example.first_trust)} → {format_number(example.second_trust)}"
        )
        if pair := f_by_image.get(example.item.name):
            caption += f"; F {' → '.join(map(format_number, pair))}"
        yield caption, montage.jpeg_uri(montage.hstack_tiles(tiles, pixels.shape[:2]))


def difference_tile(pixels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return grey pixels, uint8 (H, W, 3), with road of one mask (H, W) alone in blue or orange."""
    grey = np.repeat(pixels.mean(2, keepdims=True), 3, axis=2) * 0.7
    for mask, colour in ((first & ~second, montage.BLUE), (second & ~first, montage.VERMILLION)):
        grey[mask] = 0.35 * grey[mask] + 0.65 * np.array(colour)
    return grey.round().astype(np.uint8)


def summary_table(comparison: Disagreements) -> Table:
    """Return means before and after that need no labels: road, trust."""
    images, rows = comparison.images, {}
    roads = zip(*((image.first_road, image.second_road) for image in images), strict=True)
    rows["fraction of road"] = (*map(statistics.fmean, roads), "")
    if trusts := [(image.first_trust, image.second_trust) for image in images if image.has_trust]:
        rose, fell = (sum(s * (new - old) > 0 for old, new in trusts) for s in (1, -1))
        note = f"rose on {rose}, fell on {fell} images"
        rows["trust"] = (*map(statistics.fmean, zip(*trusts, strict=True)), note)
    table, values = Table("mean over the images", list(rows)), rows.values()
    table.add("before", (Cell(format_number(old)) for old, _, _ in values))
    table.add("after", (Cell(format_number(new)) for _, new, _ in values))
    table.add("change", (Cell(format_signed(new - old), note=note) for old, new, note in values))
    return table


# --- charts ------------------------------------------------------------------------------


CURVES = {"loss": "Mean loss of the epochs", "held_out_f": "F on held-out images by epoch"}
"""Curves of a training, by the column of its log."""


def draw_epochs(figure: Figure, rows: Sequence[Mapping[str, float]], key: str = "loss") -> None:
    """Draw a curve of the epochs, one line a round."""
    axes = figure.subplots()
    rounds = sorted({row["round"] for row in rows})
    for number, style in zip(rounds, cycle(zip(COLOURS, DASHES, strict=True)), strict=False):
        points = [(row["epoch"], row[key]) for row in rows if row["round"] == number]
        line = Series("", *style).line(1.5)
        axes.plot(*zip(*points, strict=True), marker=".", label=f"round {number}", **line)
    axes.set(xlabel="epoch", ylabel=CURVES[key])
    axes.locator_params("x", integer=True)
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
