"""The figures of single pictures, and which are the best, the median and the worst."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from roadtorch.evaluation import metrics
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.evaluation.result import DetectorFigures, PicturesByF
from roadtorch.evaluation.tally import Pictures, Tally

SHOWN = 10  # pictures of each kind in metrics.json

QUANTILES = (0.0, 0.1, 0.25, 0.5, 0.75, 0.9, 1.0)


@dataclass(frozen=True)
class PictureRow:
    """One picture as one detector saw it: a row of images.csv; NaN where undefined.

    threshold: of its drive; f: there, of the 8-bit map; f_mask, iou_mask: of the detector's
    own mask; trust: its expected F, by the detector; ms: the time of detect.
    """

    image: str
    group: str
    detector: str
    auc: float
    maxf: float
    threshold: float
    f: float
    f_mask: float
    iou_mask: float
    trust: float
    ms: float


def picture_rows(name: str, tally: Tally, figures: DetectorFigures) -> list[PictureRow]:
    """A row for every picture that one detector has seen."""
    kept = tally.kept()
    thresholds = [figures.thresholds[group] for group in kept.groups]
    columns = (
        kept.auc.tolist(),
        kept.max_f.tolist(),
        thresholds,
        image_f(kept, figures.thresholds).tolist(),
        metrics.f_measure(kept.mask).tolist(),
        metrics.iou(kept.mask).tolist(),
        kept.trust.tolist(),
        (1000 * kept.seconds).tolist(),
    )
    about = zip(kept.names, kept.groups, strict=True)
    return [
        PictureRow(image, group, name, *values)
        for (image, group), *values in zip(about, *columns, strict=True)
    ]


def image_f(pictures: Pictures, thresholds: Mapping[str, float]) -> Tensor:
    """F of each picture at its drive's threshold, of its 8-bit map, float64 (n,).

    NaN without road or threshold.
    """
    found = torch.full((len(pictures.names),), math.nan, dtype=torch.float64)
    for group, threshold in thresholds.items():
        own = torch.tensor([name == group for name in pictures.groups], dtype=torch.bool)
        if not math.isnan(threshold):
            counts = RoadCounts(pictures.road.road[own], pictures.road.other[own])
            found[own] = _f_with_road(metrics.decisions_at(counts, threshold))
    return found


def _f_with_road(outcome: Decisions) -> Tensor:
    has_road = outcome.true_positive + outcome.false_negative > 0
    return metrics.f_measure(outcome).where(has_road, torch.nan)


def chosen_pictures(pictures: Pictures, thresholds: Mapping[str, float], count: int) -> PicturesByF:
    """Quantiles of F over the pictures with road, and the best, median and worst ``count``."""
    values = image_f(pictures, thresholds).tolist()
    known = [(f, name) for f, name in zip(values, pictures.names, strict=True) if not math.isnan(f)]
    order = sorted(known, key=lambda pair: (-pair[0], pair[1]))
    begin = max((len(order) - count) // 2, 0)
    return PicturesByF(
        _quantiles([value for value, _ in order]),
        order[:count],
        order[begin : begin + count],
        order[::-1][:count],
    )


def _quantiles(values: Sequence[float]) -> dict[float, float]:
    if not values:
        return {}
    shares = torch.tensor(QUANTILES, dtype=torch.float64)
    found = torch.tensor(values, dtype=torch.float64).quantile(shares)
    return dict(zip(QUANTILES, found.tolist(), strict=True))
