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
from roadtorch.inputs.item import evenly_spaced
from roadtorch.layout.weights import WholeImageNetwork, load_network, weights_path
from roadtorch.train.config import ImageTraining, Training
from roadtorch.train.folder import PAGE, RunFolder
from roadtorch.train.prepared import image_file_name
from roadtorch.train.run import FUSION_CONFIG, PREPARED, Outcome, Request
from roadtorch.train.teachers import teacher_agreement

MAX_COMPARED, MAX_SHOWN = 60, 10
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
    weights, calibrated = outcome.weights, outcome.weights.with_name(FUSION_CONFIG)
    start = weights_path(training.initial_weights)
    initial = reference(str(start), {})
    trained = reference(str(calibrated if calibrated.exists() else weights), {})
    methods = (replace(initial, name="before"), replace(trained, name="after"))
    images = find_images([request.images], request.out)
    dataset = every_kth(unlabelled_set(images), MAX_COMPARED)
    comparison = disagreements(dataset, methods, quiet=request.quiet, desc="before and after")
    if not comparison.images:
        return False
    taught = None
    if isinstance(training, ImageTraining):
        folder = request.prepared or request.out / PREPARED
        files = [folder / f"{image_file_name(image)}.npz" for image in images]
        # Skipped images have no file.
        files = evenly_spaced([file for file in files if file.exists()], MAX_COMPARED)
        agreements = [
            teacher_agreement(network.eval(), files, training)
            for network in map(load_network, (start, weights))
            if isinstance(network, WholeImageNetwork)
        ]
        taught = Taught(training.teacher.detector, *agreements)
    change = Adaptation(
        seen=comparison,
        files=(start, weights),
        shown=most_and_spread(comparison.images, MAX_SHOWN),
        taught=taught,
        rows=RunFolder(request.out).read_log(),
        verdict=verdict,
    )
    write_adaptation(request.out / PAGE, change, command)
    return True
