"""Evaluations with made-up scores, for tests of the report."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.data.label_folders import FolderLabels
from roadtorch.evaluation.measure import Scores
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.evaluation.result import Comparison, DetectorScores, Difference, Evaluation, Interval

GROUPS = ("0001TP", "0006R0", "0016E5")
NAMES = ("fusion", "labeller", "prior:mean", "cpf:v2", "prior:rows")


def make_run(names: Sequence[str] = NAMES, groups: Sequence[str] = GROUPS) -> Evaluation:
    """Make an evaluation whose first detector is the best, each next one worse; without counts.

    Names that begin with "prior:" are baselines. Each group scores a hundredth more than the last.
    The intervals of differences reach 0.03 to both sides.
    """
    quality = {name: 0.95 - 0.3 * rank / len(names) for rank, name in enumerate(names)}
    items = [
        LabelledItem(f"{group}_{i}", Path("x.png"), Path("y.png"), group)
        for group in groups or [None]
        for i in range(10)
    ]
    dataset = Dataset("camvid", Path("data"), "dev", tuple(items), FolderLabels())
    detectors = {
        name: DetectorScores(
            make_contender(name),
            make_scores(score),
            {group: make_scores(score + 0.01 * (i - 1)) for i, group in enumerate(groups)},
            make_scores(score) if groups else {},
            intervals={"maxf": Interval(score - 0.015, score + 0.0125)},
        )
        for name, score in quality.items()
    }
    changes = {name: score - quality[names[0]] for name, score in quality.items()}
    keys = ["f_mask", "maxf", "auc_pooled", "iou"]
    differences = {
        name: dict.fromkeys(keys, Difference(change, Interval(change - 0.03, change + 0.03)))
        for name, change in changes.items()
        if name != names[0]
    }
    return Evaluation(dataset, detectors, Comparison(names[0], differences))


def make_scored_run(scores: Mapping[str, float | None]) -> Evaluation:
    """Make an evaluation of detectors with a MaxF each, or with no scores for None."""
    dataset = Dataset("folder", Path("data"), "all", (), FolderLabels())
    detectors = {
        name: DetectorScores(make_contender(name), {} if score is None else {"maxf": score})
        for name, score in scores.items()
    }
    return Evaluation(dataset, detectors, Comparison(next(iter(scores)), {}))


def make_contender(name: str) -> Contender:
    """Make a contender that must not run; one called "prior:…" is a baseline."""

    def prepare(_: Dataset) -> Predictor:
        raise AssertionError("must not run")

    return Contender(name, prepare, is_baseline=name.startswith("prior:"))


def make_scores(score: float) -> Scores:
    """Make a value for every measure."""
    scores = {measure.key: score - 0.001 * rank for rank, measure in enumerate(MEASURES)}
    return {**scores, "images": 10, "maxf": score, "ms_per_image": 12.34}


def replace_scores(evaluation: Evaluation, name: str, **fields: Any) -> Evaluation:
    """Return an evaluation with other fields of one detector's scores."""
    scores = replace(evaluation.detectors[name], **fields)
    return replace(evaluation, detectors={**evaluation.detectors, name: scores})
