"""What every detector keeps to, as a check that authors of plug-ins can run on theirs.

    from roadtorch.testing import check_detector

    def test_it_is_a_detector():
        check_detector(ENTRY)

It takes seconds. The same promises are tested on every detector that comes with roadtorch.
"""

import copy
import io
import pickle
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.detectors.detector import Detection, Detector, Entry

SIZES = ((16, 16), (17, 200), (61, 16), (48, 64), (241, 319))
"""Heights and widths of images: least, long, small, and beyond the working size."""

CLOSE = 1e-3
"""How far a likelihood may be on average from that of the same detector in double precision."""

Problems = Iterator[str]
"""How a promise is broken, one way after the other: none for a proper detector."""


class BrokenPromiseError(AssertionError):
    """A detector that does not keep to the contract: which promise, and how it is broken."""


def check_detector(entry: Entry, **settings: Any) -> None:
    """Check a detector against every promise in ``PROMISES``; settings as for ``load_detector``.

    Raises BrokenPromiseError with what `broken_promises` tells.
    """
    if broken := broken_promises(entry, **settings):
        raise BrokenPromiseError("; ".join(broken))


def broken_promises(entry: Entry, **settings: Any) -> list[str]:
    """How a detector breaks its promises, the first way of each; empty for a proper one."""
    checked = entry.configured(settings)
    detector, again = (Detector(entry, checked).eval() for _ in range(2))
    broken = [next(promise(detector, again), None) for promise in PROMISES]
    return [f"{entry.name} {error}" for error in broken if error is not None]


def street(height: int, width: int, random_seed: int = 0) -> Tensor:
    """An image (3,H,W) of a noisy grey wedge under a pale sky: enough of a street for a check."""
    generator = torch.Generator().manual_seed(random_seed)
    rows = torch.linspace(0, 1, height).view(-1, 1)
    columns = torch.linspace(-1, 1, width).view(1, -1)
    road = (rows > 0.45) & (columns.abs() < rows - 0.3)
    colours = torch.tensor([[0.7, 0.8, 0.95], [0.3, 0.45, 0.2], [0.45, 0.45, 0.47]])
    classes = torch.where(road, 2, (rows > 0.45).long().expand(height, width))
    noise = torch.randn(3, height, width, generator=generator) * 0.04
    return (colours[classes].permute(2, 0, 1) + noise).clamp(0, 1)


# --- promises ---------------------------------------------------------------------------


def any_size_gives_maps_of_that_size(detector: Detector, _: Detector) -> Problems:
    """Any image from 16×16 up: maps of its size, likelihoods in [0,1], finite cues."""
    for height, width in SIZES:
        detection = detector.detect(street(height, width))
        yield from flaws(detection, (height, width), f"{width}×{height} pixels")


def nothing_to_see_gives_proper_maps(detector: Detector, _: Detector) -> Problems:
    """Black, white, flat and grey images."""
    flat = torch.tensor([0.2, 0.5, 0.7]).view(3, 1, 1).expand(3, 48, 64)
    grey = street(48, 64).mean(0, keepdim=True).expand(3, 48, 64)
    images = {"black": 0 * flat, "white": flat**0, "flat": flat, "grey": grey}
    for kind, image in images.items():
        yield from flaws(detector.detect(image), (48, 64), f"a {kind} image")


def the_same_image_gives_the_same_bytes(detector: Detector, again: Detector) -> Problems:
    """Loaded once or twice, whatever torch's own generator does, on one of torch's threads or two.

    The image is left as it was, and so is the number of threads.
    """
    image = street(240, 320)
    before, threads, detections = image.clone(), torch.get_num_threads(), []
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
    yield from flaws(detections[0], (240, 320), "320×240 pixels")
    if not _equal(*detections):
        yield "says two things of one image"
    if not torch.equal(image, before):
        yield "changes the image that it is given"


def a_batch_is_its_images_one_by_one(detector: Detector, _: Detector) -> Problems:
    """``forward`` gives likelihoods (B,H,W), of an empty batch as well; a call, Detections."""
    images = torch.stack([street(48, 64, random_seed) for random_seed in range(2)])
    detections = detector(images)
    singles = torch.stack([detection.likelihood for detection in detections])
    if not torch.equal(detector.forward(images), singles):
        yield "says other things in a batch"
    if detector.forward(images[:0]).shape != (0, 48, 64):
        yield "takes no empty batch"


def the_mask_follows_the_threshold(detector: Detector, _: Detector) -> Problems:
    """No pixel below the threshold is road."""
    detection = detector.detect(street(96, 128))
    if detection.mask[detection.likelihood < detector.settings.threshold].any():
        yield "calls road what is below the threshold"


def copies_say_the_same_and_are_their_own(detector: Detector, _: Detector) -> Problems:
    """copy.deepcopy, pickle, torch.save and state_dict; a changed copy changes nothing else."""
    image = street(48, 64)
    first = detector.detect(image)
    for way, made in _copies(detector):
        if not _equal(first, made.detect(image)):
            yield f"says other things after {way}"
        weights = list(made.parameters())
        for weight in weights:
            weight.data.add_(1)
        if weights and torch.equal(made.detect(image).likelihood, first.likelihood):
            yield f"does not use its own weights after {way}"
    if not _equal(first, detector.detect(image)):
        yield "shares weights with its copies"


def another_precision_says_nearly_the_same(detector: Detector, _: Detector) -> Problems:
    """``detector.to(torch.float64)`` takes the same images and gives float32 again."""
    image = street(48, 64)
    detection = copy.deepcopy(detector).to(torch.float64).detect(image)
    yield from flaws(detection, (48, 64), "double precision")
    distance = float((detection.likelihood - detector.detect(image).likelihood).abs().mean())
    if distance >= CLOSE:
        yield f"moves by {distance:.2g} in double precision"


def what_is_no_image_is_refused(detector: Detector, _: Detector) -> Problems:
    """InputError for values beyond [0,1], wrong shapes and types, too small an image."""
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
    for kind, image in wrong.items():
        try:
            detector.detect(image)
        except InputError:
            continue
        yield f"takes an image that is {kind}"


PROMISES: tuple[Callable[[Detector, Detector], Problems], ...] = (
    any_size_gives_maps_of_that_size,
    nothing_to_see_gives_proper_maps,
    the_same_image_gives_the_same_bytes,
    a_batch_is_its_images_one_by_one,
    the_mask_follows_the_threshold,
    copies_say_the_same_and_are_their_own,
    another_precision_says_nearly_the_same,
    what_is_no_image_is_refused,
)
"""Each looks at a detector, and at the same one loaded again."""


# --- how they are checked ---------------------------------------------------------------


def flaws(detection: Detection, size: tuple[int, int], image: str) -> Problems:
    """What is wrong with types, shapes and ranges of a detection of an image of (height, width).

    image: what it shows, in words.
    """
    likelihood, mask, cues = detection.likelihood, detection.mask, detection.cues
    if (likelihood.dtype, mask.dtype) != (torch.float32, torch.bool):
        yield f"gives {likelihood.dtype} and {mask.dtype} for {image}"
    if not likelihood.shape == mask.shape == size:
        yield f"gives {tuple(likelihood.shape)} for {image}"
    if not ((likelihood >= 0) & (likelihood <= 1)).all():
        yield f"leaves [0, 1] for {image}"
    for name, cue in cues.items():
        layers = (3,) if name == "layout" else cue.shape[:-2]
        if cue.shape != (*layers, *size) or len(layers) > 1:
            yield f"gives the cue {name} as {tuple(cue.shape)} for {image}"
        if cue.is_floating_point() and not cue.isfinite().all():
            yield f"gives a cue {name} that is not finite for {image}"
    if not 0 <= (detection.trust or 0) <= 1:
        yield f"gives the trust {detection.trust} for {image}"
    if "ego" in cues and (mask | (likelihood != 0))[cues["ego"]].any():
        yield f"calls the ego car road for {image}"


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
    maps, others = (
        {"likelihood": each.likelihood, "mask": each.mask, **each.cues} for each in (first, second)
    )
    return maps.keys() == others.keys() and all(torch.equal(maps[k], others[k]) for k in maps)
