"""Page that compares the network of a training run with its initial weights."""

from dataclasses import replace

from roadtorch.data.dataset import subsample_dataset
from roadtorch.evaluation.disagreement import (
    TeacherAgreement,
    compare_masks,
    select_changed,
    unlabelled_dataset,
)
from roadtorch.evaluation.methods import parse_reference
from roadtorch.evaluation.report.adaptation import Adaptation, write_adaptation
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import evenly_spaced
from roadtorch.layout.weights import WholeImageNetwork, load_network, weights_path
from roadtorch.train.config import ImageTraining, Training
from roadtorch.train.prepared import image_file_name
from roadtorch.train.run import FUSION_CONFIG, PREPARED, Outcome, TrainingRequest
from roadtorch.train.run_folder import ADAPTATION_PAGE, RunFolder
from roadtorch.train.teachers import teacher_agreement

MAX_COMPARED, MAX_SHOWN = 60, 10
"""Images that are compared, evenly spaced, and those on the page, half of them the most changed."""


def write_page(
    training: Training,
    request: TrainingRequest,
    outcome: Outcome,
    verdict: str = "",
    command: str = "",
) -> bool:
    """Write the page of a run with initial weights; return False without weights or images.

    verdict: sentence at the top. command: command line at the end.
    """
    if outcome.weights is None:
        return False
    weights, config = outcome.weights, outcome.weights.with_name(FUSION_CONFIG)
    start = weights_path(training.initial_weights)
    initial = parse_reference(str(start), {})
    trained = parse_reference(str(config if config.exists() else weights), {})
    methods = (replace(initial, name="before"), replace(trained, name="after"))
    images = find_images([request.images], request.out)
    dataset = subsample_dataset(unlabelled_dataset(images), MAX_COMPARED)
    comparison = compare_masks(dataset, methods, quiet=request.quiet, desc="before and after")
    if not comparison.images:
        return False
    agreement = None
    if isinstance(training, ImageTraining):
        folder = request.prepared or request.out / PREPARED
        files = [folder / f"{image_file_name(image)}.npz" for image in images]
        files = evenly_spaced([file for file in files if file.exists()], MAX_COMPARED)
        agreements = [
            teacher_agreement(network.eval(), files, training)
            for network in map(load_network, (start, weights))
            if isinstance(network, WholeImageNetwork)
        ]
        agreement = TeacherAgreement(training.teacher.detector, *agreements)
    change = Adaptation(
        comparison=comparison,
        files=(start, weights),
        examples=select_changed(comparison.images, MAX_SHOWN),
        agreement=agreement,
        epochs=RunFolder(request.out).read_log(),
        verdict=verdict,
    )
    write_adaptation(request.out / ADAPTATION_PAGE, change, command)
    return True
