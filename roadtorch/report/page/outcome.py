"""What a run found, in sentences made from its numbers."""

from collections.abc import Mapping
from typing import Any

from roadtorch.report.page.svg import bounds, is_floor, number, ranked_names
from roadtorch.report.page.tables import best_floor, share, signed

Figures = Mapping[str, Any]


def outcome(document: Mapping[str, Any]) -> list[str]:
    """The best detector against the best floor; how far the drives differ; how sure it is."""
    detectors = document["detectors"]
    scores = {name: number(detectors[name].get("maxf")) for name in ranked_names(detectors)}
    floor = best_floor(scores)
    best = next((n for n, v in scores.items() if v is not None and not is_floor(n)), None)
    if best is None:
        return ["No detector has a score." if floor is None else _floor_alone(*floor)]
    score = scores[best] or 0.0
    sentences = [_first(best, score, detectors[best], floor)]
    sentences += _pair(best, floor, document) + _drives(best, detectors)
    return sentences + _next(best, scores, document) + _decided(best, detectors[best])


def _floor_alone(name: str, score: float) -> str:
    return f"Only floors were scored; the best is {name} with a MaxF of {share(score)}."


def _first(name: str, score: float, figures: Figures, floor: tuple[str, float] | None) -> str:
    ends = bounds((figures.get("ci95") or {}).get("maxf"))
    interval = f" (95 % interval {share(ends[0])} to {share(ends[1])})" if ends else ""
    text = f"{name} is best: MaxF {share(score)}{interval}"
    if floor is None:
        return f"{text}. No floor was scored beside it."
    distance = score - floor[1]
    if round(distance, 3) <= 0:
        text = f"No detector is above the floors: {name} has a MaxF of {share(score)}{interval}"
        return f"{text}, {share(-distance)} below {floor[0]} ({share(floor[1])})."
    return f"{text}, {share(distance)} above the best floor, {floor[0]} ({share(floor[1])})."


def _drives(name: str, detectors: Mapping[str, Figures]) -> list[str]:
    """The worst and the best drive, and on how many the detector is above the floors."""
    groups = detectors[name].get("groups", {})
    known = {drive: number(part.get("maxf")) for drive, part in groups.items()}
    scores = {drive: value for drive, value in known.items() if value is not None}
    if len(scores) < 2:
        return []
    low, high = min(scores, key=scores.__getitem__), max(scores, key=scores.__getitem__)
    text = f"By drive from {share(scores[low])} ({low}) to {share(scores[high])} ({high})"
    floors = {drive: _floor_of_drive(drive, detectors) for drive in scores}
    compared = {drive: value for drive, value in floors.items() if value is not None}
    if not compared:
        return [f"{text}."]
    above = sum(scores[drive] > value for drive, value in compared.items())
    return [f"{text}; above every floor on {above} of {len(compared)} drives."]


def _floor_of_drive(drive: str, detectors: Mapping[str, Figures]) -> float | None:
    parts = {name: one.get("groups", {}).get(drive, {}) for name, one in detectors.items()}
    found = best_floor({name: number(part.get("maxf")) for name, part in parts.items()})
    return found[1] if found else None


def paired_interval(
    document: Mapping[str, Any], one: str, other: str
) -> tuple[float, float] | None:
    """The interval of one detector's MaxF less that of another, if the run compared them."""
    paired = document.get("paired") or {}
    for name, against, sign in ((one, other, 1), (other, one, -1)):
        change = paired.get("detectors", {}).get(name, {}).get("maxf") or {}
        ends = bounds(change.get("ci95"))
        if paired.get("against") == against and ends:
            low, high = sorted(sign * end for end in ends)
            return low, high
    return None


def _pair(best: str, floor: tuple[str, float] | None, document: Mapping[str, Any]) -> list[str]:
    """How sure the distance to the floor is."""
    ends = paired_interval(document, best, floor[0]) if floor else None
    return [f"The 95 % interval of that distance is {_range(*ends)}."] if ends else []


def _next(best: str, scores: Mapping[str, float | None], document: Mapping[str, Any]) -> list[str]:
    """The detector that comes second."""
    others = [n for n, v in scores.items() if v is not None and n != best and not is_floor(n)]
    if not others:
        return []
    distance = (scores[best] or 0.0) - (scores[others[0]] or 0.0)
    ends = paired_interval(document, best, others[0])
    interval = f" (95 % interval {_range(*ends)})" if ends else ""
    return [f"Next is {others[0]}, {share(distance)} behind{interval}."]


def _range(low: float, high: float) -> str:
    """An interval in words; one that has 0 inside tells nothing apart."""
    apart = "" if low > 0 or high < 0 else ", which these pictures do not tell from 0"
    return f"{signed(low)} to {signed(high)}{apart}"


def _decided(name: str, figures: Figures) -> list[str]:
    """MaxF flatters; what is left of it when the threshold comes from elsewhere."""
    f, overlap = number(figures.get("f")), number(figures.get("iou"))
    if f is None or overlap is None:
        return []
    source = figures.get("threshold_from")
    origin = f", from {source}," if source else ""
    return [
        f"MaxF picks its threshold on the labels it is scored on; at the chosen threshold{origin} "
        f"{name} has an F of {share(f)} and an IoU of {share(overlap)}."
    ]
