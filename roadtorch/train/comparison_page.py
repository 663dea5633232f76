"""Page that compares the network of a training run with its initial weights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from roadtorch.base.atomic import claim_results
from roadtorch.base.bounded import plural
from roadtorch.base.errors import DatasetError
from roadtorch.data.corrections import HumanLabels, labels_to_truth, read_image_size
from roadtorch.data.dataset import Dataset, LabelledItem, Truth, subsample_dataset
from roadtorch.detectors.fusion import DEFAULT_WEIGHTS
from roadtorch.evaluation.disagreement import compare_masks, select_changed
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measures import F_MASK, IOU_MASK, MAXF
from roadtorch.evaluation.methods import parse_reference
from roadtorch.evaluation.report.adaptation import write_adaptation
from roadtorch.evaluation.result import Evaluation
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.layout.weights import weights_path
from roadtorch.train.config import Training
from roadtorch.train.run import Outcome, TrainingRequest
from roadtorch.train.run_folder import ADAPTATION_PAGE, RunFolder

MIN_INTERVAL, SCORES = 5, (F_MASK, IOU_MASK, MAXF)
"""Held-out images from which an interval is given, and their scores on the page."""

MAX_COMPARED, MAX_SHOWN = 60, 10
"""Images that are compared, evenly spaced, and those on the page, half of them the most changed.

Of held-out images all are compared.
"""


@dataclass(frozen=True)
class LabelsByImage:
    """Truth of images by their resolved file; those without labels are void everywhere."""

    labels: Mapping[Path, HumanLabels]

    def truth(self, item: LabelledItem) -> Truth:
        """Return the truth; DatasetError where labels, or an image without any, cannot be read."""
        if (labels := self.labels.get(item.image.resolve())) is None:
            return labels_to_truth(np.zeros(read_image_size(item.image), np.uint8))
        return labels_to_truth(labels.labels)


def select_compared(
    images: Sequence[Item], held_out: Sequence[HumanLabels], labels: Sequence[HumanLabels]
) -> Dataset:
    """Return the held-out images, or else some of all, with the truth of those that have labels."""
    by_image = {entry.image.resolve(): entry for entry in held_out or labels}
    if held_out:
        images = [image for image in images if image.path.resolve() in by_image]
    items = tuple(LabelledItem(image.name, image.path, image.path) for image in images)
    dataset = Dataset("images", Path(), "", items, LabelsByImage(by_image))
    return dataset if held_out else subsample_dataset(dataset, MAX_COMPARED)


def describe_gain(evaluation: Evaluation) -> str:
    """Return in words whether the masks of held-out images got better, and a blind baseline."""
    change = evaluation.comparison.differences["after"][F_MASK.key]
    scores = {name: F_MASK.get(values) for name, values in evaluation.headlines.items()}
    enough = evaluation.images >= MIN_INTERVAL
    word = ("undecided", "better", "worse")[enough * change.interval.sign]
    hint = {"better": "", "worse": "; use fusion as it is", "undecided": "; add masks to decide"}
    return (
        f"{word}: on {plural(evaluation.images, 'held-out image')} F of the mask "
        f"{scores['before']:.3f} before, {scores['after']:.3f} after, "
        + (str(change) if enough else f"{change.value:+.3f} (no interval below {MIN_INTERVAL})")
        + f"; prior:rows {scores['prior:rows']:.3f}"
        + hint[word]
    )


def write_page(
    training: Training,
    request: TrainingRequest,
    outcome: Outcome,
    verdict: str = "",
    command: str = "",
    use: str = "",
) -> str | None:
    """Write the page of a run; return its verdict, or None without weights or images.

    verdict: sentence at the top, if no image has labels. command: command line at the end. use:
    that which uses the result.
    """
    if outcome.weights is None:
        return None
    weights = outcome.weights
    start = weights_path(DEFAULT_WEIGHTS if training.is_new else training.initial_weights)
    initial, trained = (parse_reference(str(path), {}) for path in (start, weights))
    methods = (replace(initial, name="before"), replace(trained, name="after"))
    images, held_out = find_images([request.images], request.out), outcome.held_out
    dataset = select_compared(images, held_out, request.corrections)
    comparison = compare_masks(dataset, methods, quiet=request.quiet, desc="before and after")
    if not comparison.images:
        return None
    evidence, evaluation = "Without labels", None
    if held_out:
        evidence = "Held-out images"
        try:
            evaluation = evaluate(dataset, methods, against="before", measures=SCORES, jobs=None)
            verdict = describe_gain(evaluation)
        except DatasetError as error:
            verdict = f"undecided: {error.problem}"
    elif request.corrections:
        evidence = "Images that trained"
        verdict = "undecided: no image was held out, so nothing shows what the labels bring"
    with claim_results(request.out, {ADAPTATION_PAGE: ""}):
        write_adaptation(
            request.out / ADAPTATION_PAGE,
            comparison,
            (start, weights),
            select_changed(comparison.images, MAX_SHOWN),
            RunFolder(request.out).read_log(),
            evaluation,
            evidence,
            verdict=verdict,
            command=command,
            use=use,
        )
    return verdict
