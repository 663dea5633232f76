"""Page that compares the network of a training run with its initial weights."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from roadtorch.base.atomic import claim_results
from roadtorch.base.image import read_image
from roadtorch.data.corrections import HumanLabels, labels_to_truth
from roadtorch.data.dataset import subsample_dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.disagreement import (
    TeacherAgreement,
    compare_masks,
    select_changed,
    unlabelled_dataset,
)
from roadtorch.evaluation.methods import parse_reference
from roadtorch.evaluation.metrics import count_mask
from roadtorch.evaluation.report.adaptation import write_adaptation
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    percentile_interval,
    pooled_f,
    sample_weights,
)
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import evenly_spaced
from roadtorch.layout.weights import WholeImageNetwork, load_network, weights_path
from roadtorch.run.loop import Inference
from roadtorch.train.config import ImageTraining, Training
from roadtorch.train.prepared import image_file_name
from roadtorch.train.run import Outcome, TrainingRequest
from roadtorch.train.run_folder import ADAPTATION_PAGE, FUSION_CONFIG, PREPARED, RunFolder
from roadtorch.train.teachers import teacher_agreement

MIN_INTERVAL = 5
"""Held-out images from which an interval is given."""

MAX_COMPARED, MAX_SHOWN = 60, 10
"""Images that are compared, evenly spaced, and those on the page, half of them the most changed."""


def score_held_out(weights: Mapping[str, str], held_out: Sequence[HumanLabels]) -> str:
    """Compare two networks of `fusion`, by title, on held-out images; return the result in words.

    The interval is a bootstrap of the images.
    """
    if not held_out:
        return "no image was held out, so nothing shows what the masks bring"
    detectors = {name: load_detector("fusion", weights={"file": weights[name]}) for name in weights}
    detectors["prior:rows"] = load_detector("prior:rows")
    images = [read_image(labels.image) for labels in held_out]
    truths = [labels_to_truth(labels.labels) for labels in held_out]
    draws = sample_weights(("",) * len(images), torch.Generator().manual_seed(BOOTSTRAP_SEED))
    scores = {}
    for name, detector in detectors.items():
        masks = [Inference(detector)(image).mask for image in images]
        counts = [
            torch.stack(count_mask(mask, truth.road, truth.valid))
            for mask, truth in zip(masks, truths, strict=True)
        ]
        scores[name] = pooled_f(torch.stack(counts), draws)
    first, second = (scores[name] for name in weights)
    interval = percentile_interval(second[1:] - first[1:])
    texts = [f"{values[0]:.3f} {name}" for name, values in scores.items()]
    text = f"{len(images)} held out: F of the mask {', '.join(texts)}"
    text += f"; difference {second[0] - first[0]:+.3f}"
    if len(images) >= MIN_INTERVAL:
        text += f" (95 % {interval.low:+.3f} to {interval.high:+.3f})"
    return text + ("" if second[0] > first[0] else "; no gain: use fusion as it is, or add masks")


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
    with claim_results(request.out, {ADAPTATION_PAGE: ""}):
        write_adaptation(
            request.out / ADAPTATION_PAGE,
            comparison,
            (start, weights),
            select_changed(comparison.images, MAX_SHOWN),
            agreement,
            RunFolder(request.out).read_log(),
            verdict,
            command,
        )
    return True
