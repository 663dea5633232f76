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

from roadtorch.detector import Detection, Detector, Entry
from roadtorch.errors import InputError

SIZES = ((16, 16), (17, 200), (61, 16), (48, 64), (240, 320), (241, 319))
"""Heights and widths of pictures: least, long, small, of the working size, and beyond it."""

CLOSE = 1e-3
"""How far a likelihood may be on average from that of the same detector in double precision."""


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
    found = []
    for promise in PROMISES:
        try:
            promise(detector, again)
        except BrokenPromiseError as broken:
            found.append(str(broken))
    return found


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


def any_size_gives_maps_of_that_size(detector: Detector, _: Detector) -> None:
    """Any picture from 16×16 up: maps of its size, likelihoods in [0,1], finite cues."""
    for height, width in SIZES:
        detection = detector.detect(street(height, width))
        check_detection(detector, detection, (height, width), f"{width}×{height} pixels")


def nothing_to_see_gives_proper_maps(detector: Detector, _: Detector) -> None:
    """Black, white, flat and grey pictures."""
    pictures = {
        "black": torch.zeros(3, 48, 64),
        "white": torch.ones(3, 48, 64),
        "flat": torch.tensor([0.2, 0.5, 0.7]).view(3, 1, 1).expand(3, 48, 64),
        "grey": street(48, 64).mean(0, keepdim=True).expand(3, 48, 64),
    }
    for kind, image in pictures.items():
        check_detection(detector, detector.detect(image), (48, 64), f"a {kind} picture")


def the_same_image_gives_the_same_bytes(detector: Detector, again: Detector) -> None:
    """Loaded once or twice, whatever torch's own generator does, on one of torch's threads or two.

    The image is left as it was, and so is the number of threads.
    """
    image = street(240, 320)
    before, threads, said = image.clone(), torch.get_num_threads(), []
    try:
        with torch.random.fork_rng(devices=[]):
            for number, one in ((1, detector), (2, again)):
                torch.manual_seed(number)
                torch.set_num_threads(number)
                said.append(one.detect(image))
                kept = torch.get_num_threads() == number
                _expect(detector, kept, "changes the number of torch's threads")
            _expect(detector, _equal(*said), "says two things of one image")
    finally:
        torch.set_num_threads(threads)
    _expect(detector, torch.equal(image, before), "changes the image that it is given")


def a_batch_is_its_images_one_by_one(detector: Detector, _: Detector) -> None:
    """Calling a detector gives likelihoods (B,H,W), of an empty batch as well."""
    images = torch.stack([street(48, 64, random_seed) for random_seed in range(2)])
    singles = torch.stack([detector.detect(image).likelihood for image in images])
    _expect(detector, torch.equal(detector(images), singles), "says other things in a batch")
    _expect(detector, detector(images[:0]).shape == (0, 48, 64), "takes no empty batch")


def the_mask_follows_the_threshold(detector: Detector, _: Detector) -> None:
    """No pixel below the threshold is road."""
    detection = detector.detect(street(96, 128))
    below = detection.likelihood < detector.settings.threshold
    _expect(detector, not detection.mask[below].any(), "calls road what is below the threshold")


def copies_say_the_same_and_are_their_own(detector: Detector, _: Detector) -> None:
    """copy.deepcopy, pickle, torch.save and state_dict; a changed copy changes nothing else."""
    image = street(48, 64)
    said = detector.detect(image)
    for way, made in _copies(detector):
        _expect(detector, _equal(said, made.detect(image)), f"says other things after {way}")
        weights = list(made.parameters())
        for weight in weights:
            weight.data.add_(1)
        if weights:
            changed = not torch.equal(made.detect(image).likelihood, said.likelihood)
            _expect(detector, changed, f"does not use its own weights after {way}")
            same = torch.equal(detector.detect(image).likelihood, said.likelihood)
            _expect(detector, same, f"shares weights with what {way} made")


def another_precision_says_nearly_the_same(detector: Detector, _: Detector) -> None:
    """``detector.to(torch.float64)`` takes the same images and gives float32 again."""
    image = street(48, 64)
    precise = copy.deepcopy(detector).to(torch.float64)
    detection = precise.detect(image)
    check_detection(precise, detection, (48, 64), "double precision")
    distance = float((detection.likelihood - detector.detect(image).likelihood).abs().mean())
    _expect(detector, distance < CLOSE, f"moves by {distance:.2g} in double precision")


def what_is_no_image_is_refused(detector: Detector, _: Detector) -> None:
    """InputError for values beyond [0,1], wrong shapes and types, too small a picture."""
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
        _expect(detector, False, f"takes an image that is {kind}")


PROMISES: tuple[Callable[[Detector, Detector], None], ...] = (
    any_size_gives_maps_of_that_size,
    nothing_to_see_gives_proper_maps,
    the_same_image_gives_the_same_bytes,
    a_batch_is_its_images_one_by_one,
    the_mask_follows_the_threshold,
    copies_say_the_same_and_are_their_own,
    another_precision_says_nearly_the_same,
    what_is_no_image_is_refused,
)
"""Each looks at a detector, and at the same one loaded again; BrokenPromiseError."""


# --- how they are checked ---------------------------------------------------------------


def check_detection(
    detector: Detector, detection: Detection, size: tuple[int, int], what: str
) -> None:
    """Types, shapes and ranges of what a detector says of a picture of that height and width.

    what: the picture, in words. Raises BrokenPromiseError.
    """
    likelihood, mask, cues = detection.likelihood, detection.mask, detection.cues
    types = (likelihood.dtype, mask.dtype) == (torch.float32, torch.bool)
    _expect(detector, types, f"gives {likelihood.dtype} and {mask.dtype} for {what}")
    fits = tuple(likelihood.shape) == tuple(mask.shape) == size
    _expect(detector, fits, f"gives {tuple(likelihood.shape)} for {what}")
    inside = bool((likelihood >= 0).all() and (likelihood <= 1).all())
    _expect(detector, inside, f"leaves [0, 1] for {what}")
    for name, cue in cues.items():
        fits = cue.shape[-2:] == size and cue.ndim in (2, 3)
        _expect(detector, fits, f"gives the cue {name} as {tuple(cue.shape)} for {what}")
        finite = not cue.is_floating_point() or bool(cue.isfinite().all())
        _expect(detector, finite, f"gives a cue {name} that is not finite for {what}")
    if "layout" in cues:
        fits = cues["layout"].shape == (3, *size)
        _expect(detector, fits, f"gives a layout of {tuple(cues['layout'].shape)} for {what}")
    trusted = detection.trust is None or 0 <= detection.trust <= 1
    _expect(detector, trusted, f"gives the trust {detection.trust} for {what}")
    if "ego" in cues:
        free = not mask[cues["ego"]].any() and not likelihood[cues["ego"]].any()
        _expect(detector, free, f"calls the ego car road for {what}")


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


def _equal(one: Detection, other: Detection) -> bool:
    same = torch.equal(one.likelihood, other.likelihood) and torch.equal(one.mask, other.mask)
    return (
        same
        and one.cues.keys() == other.cues.keys()
        and all(torch.equal(one.cues[name], other.cues[name]) for name in one.cues)
    )


def _expect(detector: Detector, kept: bool, what: str) -> None:
    if not kept:
        raise BrokenPromiseError(f"{detector.name} {what}")
