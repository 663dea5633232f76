"""What a run that started from weights has changed, measured."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.evaluation.disagreement import (
    Taught,
    disagreements,
    most_and_spread,
    unlabelled_set,
)
from roadtorch.evaluation.evaluate import evaluated
from roadtorch.evaluation.methods import candidate
from roadtorch.layout.weights import WholePictureNetwork, load_network, weights_path
from roadtorch.report.adaptation import Adaptation
from roadtorch.sources.frame import spread
from roadtorch.sources.pictures import find_images
from roadtorch.train.config import PictureTraining, Training
from roadtorch.train.folder import RunFolder
from roadtorch.train.prepared import name_of
from roadtorch.train.run import FUSION, PREPARED, Outcome, Request
from roadtorch.train.teachers import teacher_agreement

SHOWN = 10
"""Pictures on the page, half of them those that changed most."""


def adaptation_of(
    training: Training,
    request: Request,
    outcome: Outcome,
    compared: int,
    labelled: Dataset | None = None,
    verdict: str = "",
) -> Adaptation | None:
    """What a finished run has changed; None where nothing could be seen.

    The run has to have a ``start``. compared: pictures that are looked at, evenly spread.
    labelled: a set that scores both; nothing is learned from it. verdict: a sentence on top.
    """
    if outcome.weights is None:
        return None
    calibrated = outcome.weights.with_name(FUSION)
    files = (
        weights_path(training.start),
        calibrated if calibrated.exists() else outcome.weights,
    )
    before, after = (candidate(str(file), "") for file in files)
    methods = (replace(before, name="before"), replace(after, name="after"))
    found = find_images([request.images], request.out)
    dataset = every_kth(unlabelled_set(found), compared)
    seen = disagreements(dataset, methods, request.quiet, desc="before and after")
    if not seen.pictures:
        return None
    folder = request.prepared or request.out / PREPARED
    made = [folder / f"{name_of(picture)}.npz" for picture in found]
    made = [file for file in made if file.exists()]  # the others were skipped
    made = spread(made, compared)
    return Adaptation(
        seen=seen,
        files=(files[0], outcome.weights),
        shown=most_and_spread(seen.pictures, SHOWN),
        taught=_taught(training, made, files[0], outcome.weights),
        rows=RunFolder(request.out).read_log(),
        labelled=evaluated(labelled, methods, {}, against="before") if labelled else None,
        verdict=verdict,
    )


def _taught(training: Training, prepared: Sequence[Path], *files: Path) -> Taught | None:
    """The agreement with the teacher before and after; None for networks without its maps."""
    if not isinstance(training, PictureTraining):
        return None
    agreements = []
    for file in files:
        network = load_network(file)
        if not isinstance(network, WholePictureNetwork):
            return None
        agreements.append(teacher_agreement(network.eval(), prepared, training))
    return Taught(training.teacher.detector, *agreements)
