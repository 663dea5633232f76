"""What a run that started from weights has changed: measured, and written as a page."""

import csv
import math
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.evaluation.disagreement import (
    Disagreement,
    Taught,
    disagreements,
    mean_change,
    most_and_spread,
    unlabelled_set,
)
from roadtorch.evaluation.evaluate import evaluated
from roadtorch.evaluation.methods import Method, candidate
from roadtorch.evaluation.result import Evaluation, Failure
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import load_network, weights_path
from roadtorch.report.adaptation import Adaptation, write_adaptation
from roadtorch.sources.pictures import find_images
from roadtorch.train.config import PictureTraining, Training
from roadtorch.train.folder import LOG, PAGE
from roadtorch.train.prepared import name_of
from roadtorch.train.run import FUSION, PREPARED, Outcome, Request
from roadtorch.train.teachers import teacher_agreement

SHOWN = 10
"""Pictures on the page, half of them those that changed most."""

NAMES = ("before", "after")


def show_change(
    training: Training,
    request: Request,
    outcome: Outcome,
    compared: int,
    labelled: Dataset | None = None,
    command: str = "",
) -> Path | None:
    """Write the page of a finished run beside its weights; None where nothing could be seen.

    The run has to have a ``start``. compared: pictures that are looked at, evenly spread.
    labelled: a set that scores both; nothing is learned from it.
    """
    if outcome.weights is None:
        return None
    start = weights_path(training.start)
    methods = _methods(start, outcome.weights)
    dataset = every_kth(unlabelled_set(find_images([request.images], request.out)), compared)
    pictures, failures = _looked_at(dataset, methods, request.quiet)
    if not pictures:
        return None
    adaptation = Adaptation(
        dataset=dataset,
        methods=methods,
        files=(start, outcome.weights),
        means=mean_change(pictures),
        pictures=pictures,
        shown=most_and_spread(pictures, SHOWN),
        failures=failures,
        taught=_taught(training, request, compared, (start, outcome.weights)),
        rows=_rows(request.out / LOG),
        labelled=_scored(labelled, methods),
    )
    write_adaptation(request.out / PAGE, adaptation, command)
    return request.out / PAGE


def _methods(start: Path, weights: Path) -> tuple[Method, Method]:
    """The detectors with the weights of before and after, called so."""
    calibrated = weights.with_name(FUSION)
    last = calibrated if calibrated.exists() else weights
    one, other = candidate(str(start), ""), candidate(str(last), "")
    return replace(one, name=NAMES[0]), replace(other, name=NAMES[1])


def _looked_at(
    dataset: Dataset, methods: tuple[Method, Method], quiet: bool
) -> tuple[list[Disagreement], list[Failure]]:
    seen = tqdm(
        disagreements(dataset, *methods),
        "before and after",
        total=len(dataset.items),
        unit="image",
        disable=True if quiet else None,
        file=sys.stderr,
    )
    pictures: list[Disagreement] = []
    failures: list[Failure] = []
    for one in seen:
        if isinstance(one, Failure):
            failures.append(one)
        else:
            pictures.append(one)
    return pictures, failures


def _taught(
    training: Training, request: Request, most: int, files: tuple[Path, Path]
) -> Taught | None:
    """The agreement with the teacher before and after; None for networks without its maps."""
    if not isinstance(training, PictureTraining):
        return None
    folder = request.prepared or request.out / PREPARED
    prepared = _prepared_of(request, folder)
    step = max(1, math.ceil(len(prepared) / most))
    found = []
    for file in files:
        network = load_network(file)
        if not isinstance(network, PictureNetwork):
            return None
        found.append(teacher_agreement(network.eval(), prepared[::step], training))
    return Taught(training.teacher.detector, *found)


def _prepared_of(request: Request, folder: Path) -> Sequence[Path]:
    """The prepared files of this run's pictures, those that were skipped left out."""
    pictures = find_images([request.images], request.out)
    files = [folder / f"{name_of(one)}.npz" for one in pictures]
    return [file for file in files if file.exists()]


def _rows(path: Path) -> list[dict[str, Any]]:
    """Round, epoch and loss of each epoch, as the run's log has them."""
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {
                "round": int(row["round"]),
                "epoch": int(row["epoch"]),
                "loss": float(row["loss"] if "loss" in row else row["error"]),  # of older runs
            }
            for row in csv.DictReader(file)
        ]


def _scored(labelled: Dataset | None, methods: tuple[Method, Method]) -> Evaluation | None:
    """Both scored on a labelled set, the second compared with the first."""
    if labelled is None:
        return None
    return evaluated(labelled, methods, {}, against=NAMES[0])
