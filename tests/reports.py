"""Runs with made-up numbers, as `evaluate` hands them to the report, and what its page holds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.data.folder import FolderLabels
from roadtorch.evaluation.document import DetectorCurves, RunCurves
from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.methods import Contender, Look
from roadtorch.evaluation.report.montage import on_page
from roadtorch.evaluation.result import (
    Comparison,
    DetectorFigures,
    Difference,
    Evaluation,
    Failure,
    Interval,
    PictureRow,
)
from roadtorch.layout.classes import NAMES as CLASSES

GROUPS = ("0001TP", "0006R0", "0016E5")
NAMES = ("fusion", "labeller", "prior:mean", "cpf:v2", "prior:rows")
COMMAND = "roadtorch evaluate camvid data --detector 'cpf*'"
SETTINGS = {"seed": {"height": 30}}


def made_run(
    names: Sequence[str] = NAMES, groups: Sequence[str] = GROUPS
) -> tuple[Evaluation, RunCurves, list[PictureRow]]:
    """(evaluation, curves, rows): the first is the best, each next one a little worse.

    Names that begin with "prior:" are those of baselines.
    """
    quality = {name: 0.95 - 0.3 * place / len(names) for place, name in enumerate(names)}
    items = [made_item(f"{group}_{i}", group) for group in groups or [None] for i in range(10)]
    failed = Failure(f"{GROUPS[0]}_99", GROUPS[0], "is not a picture")
    dataset = Dataset(
        "camvid", Path("data"), "dev", (*items, made_item(failed.image, failed.group)),
        FolderLabels(),
    )  # fmt: skip
    evaluation = Evaluation(
        dataset,
        {name: made_figures(name, score, groups) for name, score in quality.items()},
        made_pairs(quality),
        [failed],
    )
    curves = {name: made_curves(score, groups) for name, score in quality.items()}
    rows = [
        made_row(name, group, f=score - 0.02 * i)
        for name, score in quality.items()
        for group in groups or ("all",)
        for i in range(10)
    ]
    return evaluation, curves, rows


def with_conditions(evaluation: Evaluation) -> Evaluation:
    """The same run by day, and one group by night as well; F of the mask .8 and .3."""
    first = evaluation.groups[0]
    items = tuple(
        replace(item, conditions=("day", "night") if item.group == first else ("day",))
        for item in evaluation.dataset.items
    )
    evaluation = replace(evaluation, dataset=replace(evaluation.dataset, items=items))
    for name in evaluation.detectors:
        found = {"day": {"f_mask": 0.8, "maxf": 0.9}, "night": {"f_mask": 0.3, "maxf": 0.5}}
        evaluation = changed(evaluation, name, conditions=found)
    return evaluation


def scored(scores: Mapping[str, float | None]) -> Evaluation:
    """A run of detectors with a MaxF each and nothing else; None: not even that."""
    dataset = Dataset("folder", Path("data"), "all", (), FolderLabels())
    return Evaluation(
        dataset,
        {
            name: DetectorFigures(made_contender(name), {} if score is None else {"maxf": score})
            for name, score in scores.items()
        },
        Comparison(next(iter(scores)), {}),
    )


def made_item(name: str, group: str | None) -> LabelledItem:
    return LabelledItem(name, Path(f"{name}.png"), Path(f"{name}_label.png"), group)


def made_row(detector: str, group: str, f: float) -> PictureRow:
    return PictureRow("picture", group, detector, 0.9, f, 0.5, f, f, f, f, 12.0)


def made_contender(name: str, settings: Mapping[str, Any] | None = None) -> Contender:
    """One that nobody asks to look; a baseline by its name."""

    def prepare(_: Dataset) -> Look:
        raise AssertionError("nobody looks")

    return Contender(name, prepare, settings or {}, is_baseline=name.startswith("prior:"))


def made_figures(name: str, score: float, groups: Sequence[str]) -> DetectorFigures:
    """Figures of one detector; a group has a hundredth more than the one before."""
    return DetectorFigures(
        made_contender(name, SETTINGS),
        made_part(score),
        {group: made_part(score + 0.01 * (i - 1)) for i, group in enumerate(groups)},
        made_part(score) if groups else {},
        threshold_from="the other groups",
        intervals={"maxf": Interval(score - 0.015, score + 0.0125)},
    )


def made_part(score: float) -> Figures:
    """A number for every measure; those that the tests look for are told apart."""
    confusion = {
        f"layout/confusion/{truth}/{decided}": 0.9 if truth == decided else 0.05
        for truth in CLASSES
        for decided in CLASSES
    }
    return {
        **{one.key: score - 0.001 * place for place, one in enumerate(MEASURES)},
        "images": 10,
        "maxf": score,
        "boundary_f/0.005": score / 3,
        "boundary_f/0.0025": score / 4,
        "ms_per_image": 12.34,
        **confusion,
    }


def made_pairs(quality: Mapping[str, float]) -> Comparison:
    """Everybody less the first, with intervals that reach 0.03 to both sides."""
    against = next(iter(quality))
    changes = {name: score - quality[against] for name, score in quality.items()}
    return Comparison(
        against,
        {
            name: dict.fromkeys(
                ("f_mask", "maxf", "auc_pooled", "iou"),
                Difference(change, Interval(change - 0.03, change + 0.03)),
            )
            for name, change in changes.items()
            if name != against
        },
    )


def made_curves(score: float, groups: Sequence[str]) -> DetectorCurves:
    x = np.linspace(0, 1, 50)
    one = {
        "roc": [x.tolist(), (x ** (1 - score)).tolist()],
        "pr": [x.tolist(), (1 - (1 - score) * x).tolist()],
        "reliability": [[0.1, 0.5, 0.9], [0.1, score / 2, score], [0.7, 0.1, 0.2]],
    }
    risk = {"risk": [[0.5, 1], [0.1, 1 - score]], "risk_ideal": [[0.5, 1], [0, 1 - score]]}
    return {"mean": {**one, **risk}, "groups": dict.fromkeys(groups, one)}


def made_sheet(width: int = 64, height: int = 24) -> dict[str, str]:
    """A sheet of pictures as the page has it."""
    return on_page(np.tile(np.arange(width, dtype=np.uint8)[None, :, None], (height, 1, 3)))


def changed(evaluation: Evaluation, name: str, **fields: Any) -> Evaluation:
    """The same run with other fields of one detector's figures."""
    other = replace(evaluation.detectors[name], **fields)
    return replace(evaluation, detectors={**evaluation.detectors, name: other})


def without_group(evaluation: Evaluation, group: str) -> Evaluation:
    """The same run with one group left out."""
    for name, one in evaluation.detectors.items():
        kept = {each: figures for each, figures in one.groups.items() if each != group}
        left_out = {group: one.groups[group]}
        evaluation = changed(evaluation, name, groups=kept, left_out=left_out)
    return evaluation


@dataclass
class Page(HTMLParser):
    """What a browser would find: tables by section, text, tags and attributes."""

    source: str
    tables: dict[str, list[list[list[str]]]] = field(default_factory=dict)
    tags: list[tuple[str, dict[str, str]]] = field(default_factory=list)
    text: dict[str, str] = field(default_factory=dict)
    rows_of_baselines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        self._section, self._cell, self._inside = "head", False, ""
        self.feed(self.source)

    def handle_starttag(self, tag, attrs):
        values = {name: value or "" for name, value in attrs}
        self.tags.append((tag, values))
        self._inside = tag
        if tag == "section":
            self._section = values["id"]
        tables = self.tables.setdefault(self._section, [])
        if tag == "table":
            tables.append([])
        elif tag == "tr":
            tables[-1].append([])
            self._baseline = values.get("class") == "baseline"
        elif tag in ("td", "th"):
            tables[-1][-1].append("")
            self._cell = True

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._cell = False
            if tag == "th" and self._baseline:
                self.rows_of_baselines.append(self.tables[self._section][-1][-1][-1])

    def handle_data(self, data):
        if self._inside not in ("style", "script"):
            self.text[self._section] = self.text.get(self._section, "") + data
        if self._cell:
            self.tables[self._section][-1][-1][-1] += data

    def named(self, tag: str) -> list[dict[str, str]]:
        return [values for name, values in self.tags if name == tag]

    def charts(self) -> list[str]:
        return [values["aria-label"] for values in self.named("svg") if values.get("role") == "img"]
