"""Adaptation of a whole-image network to footage without labels. Ours.

On each half of the sampled frames a network is fine-tuned and its bias calibrated; it is judged on
the other half. The result is the average of both networks' weights: networks fine-tuned from the
same initial weights lie in one low-loss basin (Wortsman et al., Model soups, ICML 2022).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from signal import SIGTERM, Signals

import torch

from roadtorch.base.atomic import remove_leftovers, write_text
from roadtorch.base.errors import InputError
from roadtorch.base.signals import stop_on_signals
from roadtorch.camera.footage import StaticFootageError, estimate_camera
from roadtorch.imaging.motion import flow_image
from roadtorch.imaging.resize import spatial_size
from roadtorch.inputs.item import evenly_spaced
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.network_cues import ROAD_OUTPUT
from roadtorch.layout.weights import load_network, read_origin, save_network, weights_path
from roadtorch.road.bayes import log_odds
from roadtorch.road.temporal_filter import TemporalFilterSettings, smooth_log_odds
from roadtorch.run.memo import read_arrays, read_cached, write_cached
from roadtorch.train.adaptation.frames import HALVES, SampledFrames, sample_frames
from roadtorch.train.adaptation.verdict import (
    Verdict,
    count_masks,
    decide_verdict,
    fit_bias,
    no_verdict,
)
from roadtorch.train.config import ImageTraining
from roadtorch.train.corrections import format_card, inherited_corrections
from roadtorch.train.prepared import from_uint8, to_uint8
from roadtorch.train.run import Outcome, TrainingRequest, prepare_folder, train
from roadtorch.train.run_folder import ADAPTATION_PAGE, CARD, LOG, PREPARED, WEIGHTS, RunFolder
from roadtorch.train.teachers import resize_as_prepared
from roadtorch.train.whole_images import ImageRecipe

CAMERA_FILE, FRAMES, TEACHER_LABELS = "camera.toml", "frames", "labels"
"""Names in the folder of results; the last is the folder of the teacher's labels."""

CALIBRATED = "calibrated.safetensors"
"""Weights of a half's network, with its bias calibrated to the teacher."""

MAX_FRAMES = 120
"""Largest number of frames from which a camera is estimated, evenly spaced."""

LABEL_SMOOTHING = TemporalFilterSettings(flow_error=2.0, relative_flow_error=0.1, contrast=0.1)
"""Stricter than for video: frames are far apart in time, so that forward and backward flow often
agree by chance."""


@dataclass(frozen=True)
class AdaptationResult:
    """The result of an adaptation.

    camera: file of the camera, None if none was written. missing: results that could not be
    written, each with its reason. outcome: weights, or the signal that interrupted the run.
    """

    frames: SampledFrames
    camera: Path | None
    missing: Sequence[str]
    outcome: Outcome
    verdict: Verdict | None = None


def adapt(
    inputs: Sequence[str], out: Path, training: ImageTraining, limit: int, quiet: bool = False
) -> AdaptationResult:
    """Adapt a network to at most ``limit`` frames of footage; write the results to ``out``.

    An interrupted run is resumed. Raises InputError for footage with fewer than two frames,
    ConfigError if ``out`` holds another run.
    """
    folders = (f"{name}/" for name in (FRAMES, TEACHER_LABELS, PREPARED, *HALVES))
    with RunFolder(out).lock((CAMERA_FILE, WEIGHTS, CARD, LOG, ADAPTATION_PAGE, *folders)):
        remove_leftovers([out / FRAMES])
        frames = sample_frames(inputs, out / FRAMES, limit, quiet)
        error = _write_camera(frames, out / CAMERA_FILE, inputs[0])
        missing = [f"no {CAMERA_FILE}: {error.where} {error.problem}"] if error else []
        if not frames.has_times:
            missing.append("images have no time stamps: they are ordered by name")
        result = partial(AdaptationResult, frames, None if error else out / CAMERA_FILE, missing)
        folders = (out / TEACHER_LABELS, out / PREPARED)
        if stopped := write_smoothed_labels(frames, *folders, training, quiet):
            return result(Outcome(None, stopped, 0))
        training, skipped = limit_samples(training, frames.frame_count), 0
        for number, half in enumerate(HALVES, 1):
            title = f"half {number} of {len(HALVES)}, "
            pattern = frames.glob(half)
            request = TrainingRequest(pattern, out / half, out / PREPARED, quiet, title=title)
            outcome = train(training, request)
            if outcome.interrupted:
                return result(outcome)
            skipped += outcome.skipped
        halves = _average(frames, out, training, quiet)
        if isinstance(error, StaticFootageError):
            reason = "the footage is static: both halves show the same"
            verdict = no_verdict(reason, frames.frame_count)
        else:
            initial = weights_path(training.initial_weights)
            judged = []
            for half, held_out in zip(HALVES, reversed(halves), strict=True):
                weights = (initial, held_out, out / WEIGHTS)
                images = frames.images(half)
                judged.append(count_masks(images, weights, out / PREPARED, training, quiet))
            verdict = decide_verdict(judged)
        return result(Outcome(out / WEIGHTS, None, skipped), verdict)


def limit_samples(training: ImageTraining, frames: int) -> ImageTraining:
    """Return the training of a half with at most two samples a frame and epoch. Ours.

    Few frames are learned by heart in the steps that many need.
    """
    samples = min(training.samples_per_epoch, max(frames, training.descent.batch))
    return training.model_copy(update={"samples_per_epoch": samples})


def write_smoothed_labels(
    frames: SampledFrames,
    labels: Path,
    prepared: Path,
    training: ImageTraining,
    quiet: bool = False,
) -> Signals | None:
    """Prepare all frames for training in ``prepared``, with road labels smoothed over time. Ours.

    The teacher's labels of the same ground vary from frame to frame. Their log odds are averaged
    along optical flow, forwards and backwards (``roadtorch.road.temporal_filter``); across a cut
    nothing is averaged.

    labels: folder of the teacher's labels, reused one by one; ``prepared`` is reused only if all
    of it is current. Returns the signal that interrupted it. Takes 1.5 MB of memory a frame.
    """
    images = frames.images()
    with stop_on_signals() as stop:
        recipe = ImageRecipe(training)
        items = prepare_folder(recipe, images, labels, stop, quiet)
        if stop.requested:
            return stop.signal or SIGTERM
    files = {
        item.file: image for image, item in zip(images, items, strict=True) if item.file is not None
    }
    targets = {label: prepared / label.relative_to(labels) for label in files}
    keys = [recipe.key(image) for image in files.values()]
    if all(read_cached(file, key) for file, key in zip(targets.values(), keys, strict=True)):
        return None
    width = LABEL_SMOOTHING.width
    greys = [
        flow_image(resize_as_prepared(frame, training.network, spatial_size(frame)), width)
        for frame in (image.read() for image in files.values())
    ]
    roads = (from_uint8(read_arrays(label, "maps")["maps"][NUM_CLASSES]) for label in files)
    smooth = smooth_log_odds(greys, [log_odds(road) for road in roads], LABEL_SMOOTHING)
    for (label, file), key, odds in zip(targets.items(), keys, smooth, strict=True):
        arrays = read_arrays(label)
        arrays["maps"][NUM_CLASSES] = to_uint8(odds.sigmoid())
        write_cached(file, key, arrays)
    return None


def _average(frames: SampledFrames, out: Path, training: ImageTraining, quiet: bool) -> list[Path]:
    """Write the average of the halves' calibrated networks, its card and its log.

    Returns the files of the calibrated networks, in the order of ``HALVES``.
    """
    files, rows = [out / half / CALIBRATED for half in HALVES], []
    for number, (half, file) in enumerate(zip(HALVES, files, strict=True), 1):
        learned = file.with_name(WEIGHTS)
        bias = fit_bias(frames.images(half), learned, out / PREPARED, training, quiet)
        write_biased(learned, file, bias)
        rows += [{**row, "round": number} for row in RunFolder(out / half).read_log()]
    network, states = load_network(files[0]), [load_network(file).state_dict() for file in files]
    mean = {
        name: torch.stack([state[name].float() for state in states]).mean(0).to(value)
        for name, value in states[0].items()
    }
    network.load_state_dict(mean)
    save_network(out / WEIGHTS, network, {**read_origin(files[0]), "images": frames.frame_count})
    if inherited := inherited_corrections(training):
        write_text((out / WEIGHTS).with_suffix(".md"), format_card(inherited))
    RunFolder(out).write_log(rows)
    return files


def write_biased(learned: Path, file: Path, bias: float) -> None:
    """Write a copy of a network with ``bias`` added to the log odds of road."""
    network = load_network(learned)
    assert isinstance(network, BackboneNetwork)
    with torch.no_grad():
        scores = network.head.scores.bias
        assert scores is not None
        scores[ROAD_OUTPUT] += bias
    save_network(file, network, read_origin(learned))


def _write_camera(frames: SampledFrames, file: Path, where: str) -> InputError | None:
    """Estimate the camera from frames and write its file; return the error if that fails."""
    sampled = evenly_spaced(frames.images(), MAX_FRAMES)
    try:
        estimate_camera((image.read() for image in sampled), where).write(file)
    except InputError as error:
        return error
    return None
