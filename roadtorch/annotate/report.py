"""What the time of people bought: pictures, pixels, clicks, and how wrong the machine was."""

import statistics
from collections.abc import Sequence
from pathlib import Path

import torch

from roadtorch.annotate.review import GLANCE, RUN, confirmation, hasty_runs
from roadtorch.annotate.views import VIEWS, read_view, view_path
from roadtorch.data.correction_labels import NOT_ROAD, ROAD_SAID
from roadtorch.data.corrections import Correction, read_corrections
from roadtorch.data.event_log import read_logs
from roadtorch.evaluation.metrics import count_mask, f_measure
from roadtorch.imaging.resize import resized

TEN_MINUTES = 600.0  # seconds


def corrections_report(out: Path, pictures: Path | None = None) -> str:
    """The report of a folder of corrections, as lines; DatasetError where there are none."""
    found = read_corrections(out, pictures)
    confirmed = [one for one in found if one.confirmed]
    figures = {one.name: machine_f(one, out) for one in confirmed}
    lines = [_row("picture", "who", "clicks", "seconds", "said", "agree", "machine's F")]
    for one in found:
        said = f"{100 * float((one.labels > 0).mean()):.1f} %"
        agree = "" if one.agreement is None else f"{100 * one.agreement:.1f} %"
        figure = figures.get(one.name)
        verdict = "" if figure is None else f"{figure:.3f}"
        verdict = verdict if one.confirmed else "not confirmed"
        seconds = f"{one.seconds:.0f}"
        lines.append(_row(one.name, _people(one), str(one.clicks), seconds, said, agree, verdict))
    known = [one for one in figures.values() if one is not None]
    lines += ["", *_totals(found, len(confirmed), known)]
    took = ((log.head.user, confirmation(log)) for log in read_logs(out))
    lines += [
        f"caution: {user} called {max(runs)} pictures in a row right in less than {GLANCE:g} s each"
        for user, runs in hasty_runs(took).items()
        if max(runs) >= RUN
    ]
    return "\n".join(lines)


def _people(one: Correction) -> str:
    """Who corrected, and after a slash who reviewed."""
    who = ",".join(one.users)
    return f"{who}/{','.join(one.reviewers)}" if one.reviewers else who


def machine_f(correction: Correction, out: Path) -> float | None:
    """F of the machine's first mask on a confirmed picture; None where its view is gone."""
    view = read_view(view_path(out / VIEWS, correction.name))
    if view is None:
        return None
    road = torch.from_numpy(correction.road)
    known = (road == ROAD_SAID) | (road == NOT_ROAD)
    mask = resized(view.odds, view.size) >= 0
    return float(f_measure(count_mask(mask, road == ROAD_SAID, known)))


def _row(*cells: str) -> str:
    widths = (-32, -16, 7, 8, 8, 8, 14)
    padded = (f"{c:<{-w}}" if w < 0 else f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))
    return " ".join(padded).rstrip()


def _totals(found: Sequence[Correction], confirmed: int, figures: Sequence[float]) -> list[str]:
    """All together, and for every ten minutes."""
    seconds = sum(one.seconds for one in found)
    pixels = sum(int((one.labels > 0).sum()) for one in found)
    clicks = sum(one.clicks for one in found)
    lines = [
        f"{len(found)} pictures, {confirmed} confirmed; {clicks} clicks, "
        f"{seconds / 60:.1f} minutes, {pixels:,} pixels said",
        f"a picture: {statistics.median(one.clicks for one in found):g} clicks, "
        f"{statistics.median(one.seconds for one in found):.0f} s (medians)",
    ]
    if figures:
        mean = statistics.mean(figures)
        lines.append(f"the machine's masks of {len(figures)} confirmed pictures: mean F {mean:.3f}")
    if seconds:
        share = TEN_MINUTES / seconds
        lines.append(
            f"ten minutes buy {share * confirmed:.1f} confirmed pictures, {share * clicks:.0f} "
            f"clicks, {share * pixels:,.0f} pixels"
        )
    return lines
