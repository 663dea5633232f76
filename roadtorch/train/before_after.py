"""The page of a run that started from weights: its network before and after, measured."""

from dataclasses import replace

from roadtorch.data.dataset import every_kth
from roadtorch.evaluation.disagreement import (
    Taught,
    disagreements,
    most_and_spread,
    unlabelled_set,
)
from roadtorch.evaluation.methods import reference
from roadtorch.evaluation.report.adaptation import Adaptation, write_adaptation
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import spread
from roadtorch.layout.weights import WholeImageNetwork, load_network, weights_path
from roadtorch.train.config import ImageTraining, Training
from roadtorch.train.folder import PAGE, RunFolder
from roadtorch.train.prepared import name_of
from roadtorch.train.run import FUSION, PREPARED, Outcome, Request
from roadtorch.train.teachers import teacher_agreement

COMPARED, SHOWN = 60, 10
"""Images that are compared, evenly spaced, and images on the page, half of them those that changed
most."""


def write_page(
    training: Training,
    request: Request,
    outcome: Outcome,
    verdict: str = "",
    command: str = "",
) -> bool:
    """Write the page of a finished run with initial weights; return False without readable images.

    verdict: sentence at the top. command: command line at the end.
    """
    if outcome.weights is None:
        return False
    weights, calibrated = outcome.weights, outcome.weights.with_name(FUSION)
    start = weights_path(training.start)
    before = reference(str(start), {})
    after = reference(str(calibrated if calibrated.exists() else weights), {})
    methods = (replace(before, name="before"), replace(after, name="after"))
    images = find_images([request.images], request.out)
    dataset = every_kth(unlabelled_set(images), COMPARED)
    seen = disagreements(dataset, methods, quiet=request.quiet, desc="before and after")
    if not seen.images:
        return False
    taught = None
    if isinstance(training, ImageTraining):
        folder = request.prepared or request.out / PREPARED
        made = [folder / f"{name_of(image)}.npz" for image in images]
        made = spread([file for file in made if file.exists()], COMPARED)  # skipped ones have none
        agreements = [
            teacher_agreement(network.eval(), made, training)
            for network in map(load_network, (start, weights))
            if isinstance(network, WholeImageNetwork)
        ]
        taught = Taught(training.teacher.detector, *agreements)
    change = Adaptation(
        seen=seen,
        files=(start, weights),
        shown=most_and_spread(seen.images, SHOWN),
        taught=taught,
        rows=RunFolder(request.out).read_log(),
        verdict=verdict,
    )
    write_adaptation(request.out / PAGE, change, command)
    return True
