"""Contract checks for detectors, for tests of plug-ins.

    from roadtorch.testing import check_detector

    def test_my_detector_keeps_the_contract():
        check_detector(ENTRY)

They take seconds. roadtorch runs them on every detector of its own.
"""

import copy
import io
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from roadtorch.base.errors import ConfigError, InputError
from roadtorch.detectors.catalogue import build_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.entry import Entry

SIZES = ((16, 16), (17, 200), (61, 16), (48, 64), (241, 319))
"""Heights and widths of test images: smallest, long, small, and beyond the working size."""

MAX_PRECISION_LOSS = 1e-3
"""Largest mean difference between the likelihoods of a detector in float32 and float64."""

Violations = Iterator[str]
"""Violations of one rule of the contract; none for a valid detector."""


class ContractError(AssertionError):
    """A violation of the detector contract."""


def check_detector(entry: Entry, **settings: object) -> None:
    """Check a detector against every rule of the contract, ``CONTRACT_CHECKS``.

    Args:
        entry: the detector's registration.
        settings: settings other than the defaults, as for ``load_detector``.

    Raises:
        ContractError: naming each rule that the detector breaks.
    """
    if violations := contract_violations(entry, **settings):
        raise ContractError("; ".join(violations))


def contract_violations(entry: Entry, **settings: object) -> list[str]:
    """Return violations of the contract, the first of each check; empty for a valid detector."""
    checked = entry.make_settings(settings)
    detector, again = (build_detector(entry, checked) for _ in range(2))
    violations = list[str | None]()
    for check in CONTRACT_CHECKS:
        try:
            violations.append(next(check(detector, again), None))
        except (ConfigError, InputError) as error:  # what ``detect`` itself refuses
            violations.append(error.problem)
    return [f"{entry.name} {text}" for text in violations if text is not None]


def street(height: int, width: int, random_seed: int = 0) -> Tensor:
    """Return an image (3, H, W) of a noisy grey wedge under a pale sky, a minimal street."""
    generator = torch.Generator().manual_seed(random_seed)
    rows, columns = torch.linspace(0, 1, height)[:, None], torch.linspace(-1, 1, width)
    road = (rows > 0.45) & (columns.abs() < rows - 0.3)
    colours = torch.tensor([[0.7, 0.8, 0.95], [0.3, 0.45, 0.2], [0.45, 0.45, 0.47]])
    classes = torch.where(road, 2, (rows > 0.45).long().expand(height, width))
    noise = torch.randn(3, height, width, generator=generator) * 0.04
    return (colours[classes].permute(2, 0, 1) + noise).clamp(0, 1)


# --- checks -----------------------------------------------------------------------------


def check_sizes(detector: Detector, _: Detector) -> Violations:
    """Check images from 16×16 up: maps of their size, likelihoods in [0, 1], finite cues."""
    for height, width in SIZES:
        detection = detector.detect(street(height, width))
        yield from detection_violations(detection, (height, width), f"{width}×{height} pixels")


def check_featureless_images(detector: Detector, _: Detector) -> Violations:
    """Check black, white, uniform and grey images."""
    flat = torch.tensor([0.2, 0.5, 0.7]).view(3, 1, 1).expand(3, 48, 64)
    grey = street(48, 64).mean(0, keepdim=True).expand(3, 48, 64)
    images = {"black": 0 * flat, "white": flat**0, "flat": flat, "grey": grey}
    for name, image in images.items():
        yield from detection_violations(detector.detect(image), (48, 64), f"a {name} image")


def check_determinism(detector: Detector, again: Detector) -> Violations:
    """Check that results are equal to the bit when loaded twice, for any seed, on 1 or 2 threads.

    Also check that the image and torch's number of threads stay as they are.
    """
    image = street(240, 320)
    original, threads, detections = image.clone(), torch.get_num_threads(), []
    try:
        with torch.random.fork_rng(devices=[]):
            for number, loaded in ((1, detector), (2, again)):
                torch.manual_seed(number)
                torch.set_num_threads(number)
                detections.append(loaded.detect(image))
                if torch.get_num_threads() != number:
                    yield "changes the number of torch's threads"
    finally:
        torch.set_num_threads(threads)
    yield from detection_violations(detections[0], (240, 320), "320×240 pixels")
    if not _equal(*detections):
        yield "is not deterministic: two results for one image"
    if not torch.equal(image, original):
        yield "modifies its input image"


def check_batches(detector: Detector, _: Detector) -> Violations:
    """Check that ``forward`` gives the likelihoods of single images, (B, H, W), and takes B = 0."""
    images = torch.stack([street(48, 64, random_seed) for random_seed in range(2)])
    detections = detector(images)
    singles = torch.stack([detection.likelihood for detection in detections])
    if not torch.equal(detector.forward(images), singles):
        yield "gives other results in a batch"
    if detector.forward(images[:0]).shape != (0, 48, 64):
        yield "does not accept an empty batch"


def check_threshold(detector: Detector, _: Detector) -> Violations:
    """Check that no pixel below the threshold is road."""
    detection = detector.detect(street(96, 128))
    if detection.mask[detection.likelihood < detector.settings.threshold].any():
        yield "marks pixels below the threshold as road"


def check_copies(detector: Detector, _: Detector) -> Violations:
    """Check deepcopy, pickle, torch.save and state_dict: equal results, weights of their own."""
    image = street(48, 64)
    first = detector.detect(image)
    for method, duplicate in _copies(detector):
        if not _equal(first, duplicate.detect(image)):
            yield f"gives other results after {method}"
        weights = list(duplicate.parameters())
        for weight in weights:
            weight.data.add_(1)
        if weights and torch.equal(duplicate.detect(image).likelihood, first.likelihood):
            yield f"does not use its own weights after {method}"
    if not _equal(first, detector.detect(image)):
        yield "shares weights with its copies"


def check_precision(detector: Detector, _: Detector) -> Violations:
    """Check that a float64 detector takes the same images and returns nearly equal float32."""
    image = street(48, 64)
    detection = copy.deepcopy(detector).to(torch.float64).detect(image)
    yield from detection_violations(detection, (48, 64), "double precision")
    distance = float((detection.likelihood - detector.detect(image).likelihood).abs().mean())
    if distance >= MAX_PRECISION_LOSS:
        yield f"differs by {distance:.2g} in double precision"


def check_refusals(detector: Detector, _: Detector) -> Violations:
    """Check that InputError is raised for wrong values, shapes, types and sizes."""
    wrong: dict[str, Any] = {
        "not a number": torch.full((3, 32, 32), torch.nan),
        "endless": torch.full((3, 32, 32), torch.inf),
        "too bright": torch.full((3, 32, 32), 1.5),
        "negative": torch.full((3, 32, 32), -0.5),
        "grey": torch.zeros(1, 32, 32),
        "a batch": torch.zeros(1, 3, 32, 32),
        "15 pixels high": torch.zeros(3, 15, 32),
        "empty": torch.zeros(3, 32, 0),
        "whole numbers": torch.zeros(3, 32, 32, dtype=torch.int64),
        "a list": [[0.5]],
    }
    for name, image in wrong.items():
        try:
            detector.detect(image)
        except InputError:
            continue
        yield f"accepts an image that is {name}"


CONTRACT_CHECKS: tuple[Callable[[Detector, Detector], Violations], ...] = (
    check_sizes,
    check_featureless_images,
    check_determinism,
    check_batches,
    check_threshold,
    check_copies,
    check_precision,
    check_refusals,
)
"""The rules of the contract; each check takes a detector, and the same one loaded again."""


# --- helpers ----------------------------------------------------------------------------


def detection_violations(detection: Detection, size: tuple[int, int], image: str) -> Violations:
    """Yield errors of a detection; size: (height, width) of the image, which messages describe."""
    likelihood, mask, cues = detection.likelihood, detection.mask, detection.cues
    if (likelihood.dtype, mask.dtype) != (torch.float32, torch.bool):
        yield f"gives {likelihood.dtype} and {mask.dtype} for {image}"
    if not likelihood.shape == mask.shape == size:
        yield f"gives {tuple(likelihood.shape)} for {image}"
    for name, cue in cues.items():
        layers = (3,) if name == "layout" else cue.shape[:-2]
        if cue.shape != (*layers, *size) or len(layers) > 1:
            yield f"gives the cue {name} as {tuple(cue.shape)} for {image}"
        if cue.is_floating_point() and not cue.isfinite().all():
            yield f"gives a cue {name} that is not finite for {image}"
    if not 0 <= (detection.trust or 0) <= 1:
        yield f"gives the trust {detection.trust} for {image}"
    if "ego" in cues and (mask | (likelihood != 0))[cues["ego"]].any():
        yield f"marks the ego car as road for {image}"


def _copies(detector: Detector) -> Iterator[tuple[str, Detector]]:
    yield "copy.deepcopy", copy.deepcopy(detector)
    yield "pickle", pickle.loads(pickle.dumps(detector))
    saved = io.BytesIO()
    torch.save(detector, saved)
    saved.seek(0)
    yield "torch.save", torch.load(saved, weights_only=False)
    blank = copy.deepcopy(detector)
    for weight in blank.parameters():
        weight.data.zero_()
    blank.load_state_dict(detector.state_dict())
    yield "load_state_dict", blank


def _equal(first: Detection, second: Detection) -> bool:
    maps, copies = (
        {"likelihood": detection.likelihood, "mask": detection.mask, **detection.cues}
        for detection in (first, second)
    )
    is_equal = maps.keys() == copies.keys() and first.trust == second.trust
    return is_equal and all(torch.equal(maps[k], copies[k]) for k in maps)
