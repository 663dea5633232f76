"""What the time of people bought: images, pixels, clicks, and how wrong the machine was."""

import statistics
from collections.abc import Sequence
from pathlib import Path

import torch

from roadtorch.annotate.machine import VIEWS, read_view, view_path
from roadtorch.data.corrections import Correction, read_corrections
from roadtorch.data.events import ROAD_SAID
from roadtorch.evaluation.metrics import count_mask, f_measure
from roadtorch.evaluation.report.table import aligned
from roadtorch.imaging.resize import resized

TEN_MINUTES = 600.0  # seconds


def corrections_report(out: Path, images: Path | None = None) -> str:
    """The report of a folder of corrections, as lines; DatasetError where there are none."""
    corrections = read_corrections(out, images)
    figures = [machine_f(each, out) if each.confirmed else None for each in corrections]
    rows = [["image", "clicks", "seconds", "said", "machine's F"]]
    for correction, figure in zip(corrections, figures, strict=True):
        clicks, seconds = str(correction.clicks), f"{correction.seconds:.0f}"
        spoken = f"{100 * float((correction.labels > 0).mean()):.1f} %"
        verdict = "" if figure is None else f"{figure:.3f}"
        verdict = verdict if correction.confirmed else "not confirmed"
        rows.append([correction.name, clicks, seconds, spoken, verdict])
    totals = _totals(corrections, [figure for figure in figures if figure is not None])
    return "\n".join([aligned(rows), "", *totals])


def machine_f(correction: Correction, out: Path) -> float | None:
    """F of the machine's first mask on a confirmed image; None where its view is gone."""
    view = read_view(view_path(out / VIEWS, correction.name))
    if view is None:
        return None
    road, known = torch.from_numpy(correction.road), torch.from_numpy(correction.says_road)
    mask = resized(view.odds, view.size) >= 0
    return float(f_measure(count_mask(mask, road == ROAD_SAID, known)))


def _totals(corrections: Sequence[Correction], figures: Sequence[float]) -> list[str]:
    """All together, and for every ten minutes."""
    confirmed = sum(correction.confirmed for correction in corrections)
    seconds = sum(correction.seconds for correction in corrections)
    pixels = sum(int((correction.labels > 0).sum()) for correction in corrections)
    clicks = sum(correction.clicks for correction in corrections)
    lines = [
        f"{len(corrections)} images, {confirmed} confirmed; {clicks} clicks, "
        f"{seconds / 60:.1f} minutes, {pixels:,} pixels said",
        f"an image: {statistics.median(each.clicks for each in corrections):g} clicks, "
        f"{statistics.median(each.seconds for each in corrections):.0f} s (medians)",
    ]
    if figures:
        mean = statistics.mean(figures)
        lines.append(f"the machine's masks of {len(figures)} confirmed images: mean F {mean:.3f}")
    if seconds:
        share = TEN_MINUTES / seconds
        lines.append(
            f"ten minutes buy {share * confirmed:.1f} confirmed images, {share * clicks:.0f} "
            f"clicks, {share * pixels:,.0f} pixels"
        )
    return lines
