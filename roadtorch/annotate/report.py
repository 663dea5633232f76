"""The report on a folder of corrections: images, clicks, time, and the detector's F-score."""

import statistics
from collections.abc import Sequence
from pathlib import Path

from roadtorch.annotate.views import VIEWS_FOLDER, read_view, view_path
from roadtorch.base.bounded import plural
from roadtorch.data.corrections import Correction, labels_to_truth, read_corrections
from roadtorch.evaluation.metrics import count_mask, f_measure
from roadtorch.evaluation.report.table import align_columns
from roadtorch.imaging.resize import resize_maps


def corrections_report(out: Path, images: Path | None = None) -> str:
    """Return the report on a folder of corrections as text; DatasetError where it has none."""
    corrections = read_corrections(out, images)
    scores = [detector_f_score(entry, out) if entry.confirmed else None for entry in corrections]
    rows = [["image", "clicks", "seconds", "labelled", "detector's F"]]
    for correction, score in zip(corrections, scores, strict=True):
        clicks, seconds = str(correction.clicks), f"{correction.seconds:.0f}"
        labelled = f"{100 * float((correction.labels > 0).mean()):.1f} %"
        verdict = "" if score is None else f"{score:.3f}"
        verdict = verdict if correction.confirmed else "not confirmed"
        rows.append([correction.name, clicks, seconds, labelled, verdict])
    totals = _totals(corrections, [score for score in scores if score is not None])
    return "\n".join([align_columns(rows), "", *totals])


def detector_f_score(correction: Correction, out: Path) -> float | None:
    """Return the F-score of the detector's mask on a confirmed image; None without its view."""
    view = read_view(view_path(out / VIEWS_FOLDER, correction.name))
    if view is None or view.size != correction.labels.shape:
        return None
    truth, mask = labels_to_truth(correction.labels), resize_maps(view.odds, view.size) >= 0
    return float(f_measure(count_mask(mask, truth.road, truth.valid)))


def _totals(corrections: Sequence[Correction], scores: Sequence[float]) -> list[str]:
    """Return lines with the totals, and medians per image."""
    confirmed = sum(correction.confirmed for correction in corrections)
    seconds = sum(correction.seconds for correction in corrections)
    pixels = sum(int((correction.labels > 0).sum()) for correction in corrections)
    clicks = sum(correction.clicks for correction in corrections)
    lines = [
        f"{plural(len(corrections), 'image')}, {confirmed} confirmed; {plural(clicks, 'click')}, "
        f"{seconds / 60:.1f} minutes, {pixels:,} labelled pixels",
        f"per image: {plural(statistics.median(entry.clicks for entry in corrections), 'click')}, "
        f"{statistics.median(entry.seconds for entry in corrections):.0f} s (medians)",
    ]
    if scores:
        mean = statistics.mean(scores)
        lines.append(f"detector's masks of {len(scores)} confirmed images: mean F {mean:.3f}")
    return lines
