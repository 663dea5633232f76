"""Human corrections in training: those that a run uses, and the record of them with its weights."""

import json
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np

from roadtorch.base.atomic import make_folder
from roadtorch.base.errors import DatasetError, InputError
from roadtorch.data.corrections import HumanLabels, read_image_size
from roadtorch.inputs.item import Item
from roadtorch.layout.pretrained import IMAGENET
from roadtorch.layout.weights import read_correction_runs, weights_path
from roadtorch.run.memo import Arrays, read_arrays, write_arrays
from roadtorch.train.config import Descent, ImageTraining, Training
from roadtorch.train.prepared import image_file_name

# --- corrections of a run ---------------------------------------------------------------

WRONG_IMAGES = "give the images that were corrected"


def corrections_by_image(
    images: Sequence[Item], corrections: Sequence[HumanLabels]
) -> tuple[dict[str, HumanLabels], dict[str, str]]:
    """Return the correction of each corrected image, by the image's name with suffix.

    Returns also the errors of those where image or labels cannot be read. Raises InputError if no
    correction is of these images, or an image has changed its size.
    """
    by_path = {correction.image.resolve(): correction for correction in corrections}
    by_name, errors = dict[str, HumanLabels](), dict[str, str]()
    for image in images:
        correction = by_path.get(image.path.resolve())
        if correction is None:
            continue
        try:
            is_equal = read_image_size(image.path) == correction.labels.shape
        except DatasetError as error:
            errors[image_file_name(image)] = str(error)
            continue
        if not is_equal:
            message = "has changed its size since it was corrected"
            raise InputError(image.path, message, WRONG_IMAGES)
        by_name[image_file_name(image)] = correction
    if corrections and not by_name and not errors:
        message = f"is not among --images, as none of {len(corrections)} corrected images is"
        raise InputError(corrections[0].image, message, WRONG_IMAGES)
    return by_name, errors


def corrections_summary(corrections: Mapping[str, HumanLabels]) -> dict[str, object] | None:
    """Summarise the corrections of a run: images, pixels, hash of all labels; None without any."""
    if not corrections:
        return None
    digest = sha256()
    pixels = 0
    for name, correction in sorted(corrections.items()):
        labels = correction.labels
        digest.update(json.dumps([name, labels.shape]).encode())
        digest.update(np.ascontiguousarray(labels).tobytes())
        pixels += int((labels > 0).sum())
    return {"images": len(corrections), "pixels": pixels, "sha256": digest.hexdigest()}


def scale_learning_rate(training: ImageTraining, corrected: int) -> Descent:
    """Scale the learning rate by n / (n + half_rate_images) for n corrected images, if any. Ours.

    A few unrepresentative images then do less harm.
    """
    descent = training.descent
    if not corrected:
        return descent
    rate = descent.learning_rate * corrected / (corrected + training.corrections.half_rate_images)
    return descent.model_copy(update={"learning_rate": rate})


def write_corrections(
    folder: Path,
    files: Mapping[Path, str],
    corrections: Mapping[str, HumanLabels],
    correct: Callable[[Arrays, HumanLabels], Arrays],
) -> dict[Path, Path]:
    """Write copies of prepared images with their corrections; return the copy by prepared file.

    files: names of the images by prepared file. correct: of a recipe.
    """
    corrected = sorted(file for file, name in files.items() if name in corrections)
    copies = {file: folder / f"{number:06d}.npz" for number, file in enumerate(corrected)}
    for file, path in copies.items():
        make_folder(folder)
        write_arrays(path, correct(read_arrays(file), corrections[files[file]]))
    return copies


# --- record in the weights --------------------------------------------------------------


def inherited_corrections(training: Training) -> list[Mapping[str, object]]:
    """Return the corrections that the initial and the teacher's weights were trained with.

    Raises WeightsError for an unusable weight file.
    """
    names = [training.initial_weights]
    if isinstance(training, ImageTraining):
        names.append(training.teacher.weights)
    runs = [
        run
        for name in names
        if name not in ("", IMAGENET)
        for run in read_correction_runs(weights_path(name))
    ]
    return [run for number, run in enumerate(runs) if run not in runs[:number]]


def format_card(runs: Sequence[Mapping[str, object]]) -> str:
    """Format the card beside weights that were trained with human corrections."""
    lines = [
        "# Weights trained with human corrections",
        "",
        "Humans corrected machine labels, and their corrections were the truth. Results with these",
        "weights are **not label-free** and must not be reported as such.",
        "",
        "| images | pixels | sha256 of the corrections |",
        "|---|---|---|",
    ]
    keys = ("images", "pixels", "sha256")
    lines += ["| " + " | ".join(str(run.get(key, "")) for key in keys) + " |" for run in runs]
    return "\n".join([*lines, ""])
