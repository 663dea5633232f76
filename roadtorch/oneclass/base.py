"""The contract of the one-class classifiers (P3, section III-B).

A classifier is described by a ``Classifier``: a model of settings, a function that fits it
to samples of road, and one that tells how far pixels are from what it has learned. All the
rest is here, once: checks, chunks, thresholds, likelihoods, saving.

Every classifier answers with a distance ≥ 0: lower is more road-like, infinite is allowed.
A density p answers with √(2 ln(peak/p)), where peak is no less than its largest value; for
one Gaussian that is the Mahalanobis distance. The score is minus the distance. P3 asks for
a likelihood in [0,1] but writes down distances for most classifiers; here all of them have

    likelihood = 1 / (1 + √(distance / t))

with t the distance that a given fraction of the training samples exceeds. It is strictly
decreasing and 0.5 lies at the threshold; its log-odds are -½ ln(distance/t). Unlike
exp(-distance) it neither underflows nor crowds the far pixels on a few of the 65,536 levels
that a 16-bit map can hold; without the root, a tight threshold still does.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from pydantic import Field
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as as_safetensors
from torch import Tensor, nn

from roadtorch.errors import ConfigError, InputError, WeightsError
from roadtorch.io.atomic import atomic
from roadtorch.io.bounded import regular_size
from roadtorch.layout.weights import tensors_hash
from roadtorch.oneclass.axes import Axes, Hue, arranged, arranged_axes, mean_hues
from roadtorch.oneclass.state import (
    LEARNED,
    About,
    about_as_bytes,
    check_classifier,
    check_parts,
    read_about,
)
from roadtorch.settings import Settings

CHUNK = 700_000
"""Floats of the largest tensor while pixels are scored: 2.8 MB, which stays in the cache."""

HASH = "sha256"
"""The key of a file's metadata that states the hash of its tensors."""

PROBES = 16
"""Samples around which the distance of one quantum is measured."""

ROUNDING = 1e-3
"""A threshold below this share of one quantum's distance comes from rounding alone."""

OWN = ("about", "hues", "threshold")
"""The other names in a state."""

State = Mapping[str, Tensor]
"""What a classifier has learned, by name."""


class ClassifierSettings(Settings):
    """What every one-class classifier can be told."""

    rejected: float = Field(
        default=0.025,
        ge=0,
        le=1,
        description="fraction of the training samples beyond the threshold; the paper has 0.025 "
        "for the Gaussians and nothing for the others",
    )
    hue: Hue = Field(
        default="unrolled",
        description="hue along the circle from the mean hue, as a plain number (as the paper's "
        "results suggest), or as a point on a circle",
    )


@dataclass(frozen=True)
class Learned:
    """What fitting gives.

    state: the tensors that the distance needs, of any number, type and shape.
    floats: the largest tensor made while a pixel is scored, in float32; sets the chunks.
    training: distances of the training samples, any number of them, where these are not
        simply scored (leave-one-out, lengths of edges).
    threshold: the distance of the boundary, where the classifier has one of its own.
    """

    state: State
    floats: int
    training: Tensor | None = None
    threshold: float | None = None


def any_dimensions(dimensions: int) -> str:
    """The ``refuses`` of a classifier that works in any number of dimensions."""
    return ""


@dataclass(frozen=True)
class Classifier:
    """One classifier on offer.

    name, summary: for lists. settings: the model of its settings.
    fit: samples float64 (m,d), m ≥ 1, all finite; their axes, hue already an ordinary
        number; settings; a generator. It must cope with one sample, identical samples,
        constant planes and fewer samples than dimensions.
    distance: state and pixels float32 (d,n) to (n,), ≥ 0; called chunk by chunk. What it
        says of values that are not finite does not matter.
    refuses: why it cannot work with so many planes; empty where it can.
    """

    name: str
    summary: str
    settings: type[ClassifierSettings]
    fit: Callable[[Tensor, Axes, Any, torch.Generator], Learned]
    distance: Callable[[State, Tensor], Tensor]
    refuses: Callable[[int], str] = any_dimensions


class Fitted(nn.Module):
    """A classifier that has seen samples; made by ``fit``, ``load`` or ``restored``.

    All it knows is in buffers, so that ``state_dict`` and ``load_state_dict`` carry it
    whole. It takes over the state of the same classifier on the same planes, whatever its
    settings were; for any other, WeightsError, and it stays as it was.
    """

    about: Tensor
    hues: Tensor
    threshold: Tensor
    axes: Axes
    hue: Hue
    floats: int

    def __init__(self, classifier: Classifier, axes: Axes, hue: Hue, learned: Learned) -> None:
        super().__init__()
        self.classifier = classifier
        self.axes, self.hue, self.floats = axes, hue, learned.floats
        shapes = tuple((name, tuple(value.shape)) for name, value in learned.state.items())
        about = bytearray(about_as_bytes(About(classifier.name, axes, hue, learned.floats, shapes)))
        self.register_buffer("about", torch.frombuffer(about, dtype=torch.uint8))
        self.register_buffer("hues", torch.zeros(len(axes)))
        self.register_buffer("threshold", torch.tensor(math.nan))
        self.learned = nn.Module()
        for name, value in learned.state.items():
            self.learned.register_buffer(name, value.detach().contiguous())

    @property
    def state(self) -> State:
        """What was learned, by name."""
        return dict(self.learned.named_buffers())

    @torch.no_grad()
    def distance(self, pixels: Tensor) -> Tensor:
        """How far pixels (n,d) are from what was learned: float32 (n,), ≥ 0.

        Infinite for pixels with a value that is not finite. Fastest where pixels are a view
        of planes, ``planes.flatten(1).T``. Memory grows with the result alone, which many pixels
        take twice.
        Raises InputError for another number of planes than that of the samples.
        """
        _check_table("pixels", pixels, len(self.axes))
        planes = pixels.T.to(torch.float32)
        return self._in_chunks(planes, lambda part: arranged(part, self.axes, self.hue, self.hues))

    def _in_chunks(self, planes: Tensor, arrange: Callable[[Tensor], Tensor]) -> Tensor:
        found, state = [], self.state
        block, length = (max(1, CHUNK // max(1, each)) for each in (len(planes), self.floats))
        for part in planes.split(block, 1):
            # A sum is finite where all its parts are (values near 1e38 do not occur).
            broken = None if math.isfinite(float(part.sum())) else ~part.sum(0).isfinite()
            seen = arrange(part if broken is None else torch.where(broken, 0, part))
            pieces = [self.classifier.distance(state, piece) for piece in seen.split(length, 1)]
            if broken is not None:
                pieces = [torch.cat(pieces).masked_fill_(broken, math.inf)]
            found += pieces
        return found[0] if len(found) == 1 else torch.cat(found)

    def score(self, pixels: Tensor) -> Tensor:
        """Minus the distance of pixels (n,d): higher is more road-like, ≤ 0, float32 (n,)."""
        return self.distance(pixels).neg_()

    def likelihood(self, pixels: Tensor) -> Tensor:
        """1 / (1 + √(distance/t)) of pixels (n,d): float32 (n,) in [0,1], 0.5 at the threshold."""
        return self.squashed(self.distance(pixels))

    def squashed(self, distance: Tensor) -> Tensor:
        """The likelihood that belongs to a distance, any shape."""
        return (distance / self.threshold).sqrt_().add_(1).reciprocal_()

    def forward(self, pixels: Tensor) -> Tensor:
        """The same as ``likelihood``."""
        return self.likelihood(pixels)

    def accepts(self, pixels: Tensor) -> Tensor:
        """Whether pixels (n,d) are within the threshold: bool (n,)."""
        return self.distance(pixels) <= self.threshold

    def _load_from_state_dict(
        self, state_dict: dict[str, Any], prefix: str, *rest: Any, **more: Any
    ) -> None:
        """Take the shapes of another state of the same classifier, then its values."""
        own = {
            key[len(prefix) :]: value for key, value in state_dict.items() if key.startswith(prefix)
        }
        about = read_about(own.get("about"))
        self._check_planes(about)
        check_parts(about, own)
        for name in OWN:
            self.register_buffer(name, torch.empty_like(own[name]))
        self.learned = nn.Module()
        for name, _ in about.shapes:
            self.learned.register_buffer(name, torch.empty_like(own[LEARNED + name]))
        super()._load_from_state_dict(state_dict, prefix, *rest, **more)
        self.axes, self.hue, self.floats = about.axes, about.hue, about.floats

    def _check_planes(self, about: About) -> None:
        check_classifier(about, self.classifier.name)
        if about.axes != self.axes:
            what = f"was learned on the planes {', '.join(about.axes.names)}"
            remedy = f"give one learned on {', '.join(self.axes.names)}"
            raise WeightsError("state", what, remedy)

    def extra_repr(self) -> str:
        """Its name and planes, for ``print``."""
        return f"{self.classifier.name!r}, {'+'.join(self.axes.names)}"


# --- fitting ----------------------------------------------------------------------------


def fit(
    classifier: Classifier,
    samples: Tensor,
    axes: Axes,
    settings: ClassifierSettings | None = None,
    generator: torch.Generator | None = None,
) -> Fitted:
    """Fit a classifier to samples (m,d), floating point, in the units of the axes.

    Samples with a value that is not finite are left out. Without settings the classifier's
    defaults hold; without a generator, one seeded with 0. Raises InputError when the shape
    is wrong or no sample is left, ConfigError when the classifier refuses so many planes.
    """
    settings = classifier.settings() if settings is None else settings
    generator = torch.Generator().manual_seed(0) if generator is None else generator
    if reason := classifier.refuses(len(axes)):
        raise ConfigError(classifier.name, reason, "choose other planes or another classifier")
    samples = _checked_samples(samples, axes)
    hues = mean_hues(samples.T, axes)
    inner = arranged_axes(axes, settings.hue)
    seen = arranged(samples.T, axes, settings.hue, hues)
    learned = classifier.fit(seen.T.double(), inner, settings, generator)
    fitted = Fitted(classifier, axes, settings.hue, learned)
    fitted.hues.copy_(hues)
    fitted.threshold.fill_(_threshold(fitted, seen, inner, learned, settings.rejected))
    return fitted


def _check_table(where: str, values: Tensor, dimensions: int) -> None:
    if not isinstance(values, Tensor) or not values.is_floating_point():
        given = values.dtype if isinstance(values, Tensor) else type(values).__name__
        raise InputError(where, f"are {given}", "give a floating point tensor")
    if values.ndim != 2 or values.shape[1] != dimensions:
        what = f"have the shape {tuple(values.shape)}"
        raise InputError(where, what, f"give (number, {dimensions}), one column per plane")


def _checked_samples(samples: Tensor, axes: Axes) -> Tensor:
    """The finite samples as float32, the type in which pixels are scored."""
    _check_table("samples", samples, len(axes))
    samples = samples.detach().to(torch.float32)
    if not math.isfinite(float(samples.sum())):
        samples = samples[samples.isfinite().all(1)]
    if not len(samples):
        raise InputError("samples", "none has finite values", "give at least one sample of road")
    return samples


def rejecting_distance(distances: np.ndarray, rejected: float) -> float:
    """The distance beyond which a fraction of the training distances (m,) lies.

    Midway between the k-th and the next in increasing order, k = ⌊(1-rejected)·m + ½⌋; the
    first or the last where there is none beside it.
    """
    ordered, count = np.sort(distances), len(distances)
    kept = math.floor((1 - rejected) * count + 0.5)
    beside = ordered[max(0, kept - 1) : kept + 1]
    return float(beside.mean(dtype=np.float64))


def _threshold(
    fitted: Fitted, seen: Tensor, axes: Axes, learned: Learned, rejected: float
) -> float:
    """The boundary of the training samples; one quantum's distance where that says nothing.

    Samples of one colour are all at distance 0. Then everything within about one quantum
    of that colour is accepted.
    """
    near = _one_quantum_away(seen, axes)
    known = learned.threshold is not None or learned.training is not None
    # In one go: for few samples a call costs more than what it computes.
    asked = near if known else torch.cat([seen, near], 1)
    distances = fitted._in_chunks(asked, lambda part: part).numpy()
    training, steps = np.split(distances, [-near.shape[1]])
    found = learned.threshold
    if found is None:
        training = training if learned.training is None else learned.training.numpy()
        found = rejecting_distance(training, rejected)
    steps = np.sort(steps[np.isfinite(steps) & (steps > 0)])
    reach = float(steps[(len(steps) - 1) // 2]) if len(steps) else 1.0
    return found if math.isfinite(found) and found > ROUNDING * reach else reach


def _one_quantum_away(seen: Tensor, axes: Axes) -> Tensor:
    """A few of the samples (d,m), each moved by one quantum up and down every plane: (d,k)."""
    chosen = seen[:, :: math.ceil(seen.shape[1] / PROBES)]
    return (chosen[..., None] + _moves(axes)).flatten(1)


@cache
@torch.inference_mode(False)  # kept for callers in any mode
def _moves(axes: Axes) -> Tensor:
    """One quantum up and down every plane, float32 (d,1,2d)."""
    steps = torch.diag(axes.quantum).float()
    return torch.cat([steps, -steps], 1)[:, None]


# --- saving -----------------------------------------------------------------------------


def restored(classifier: Classifier, state: Mapping[str, Tensor]) -> Fitted:
    """A fitted classifier from its ``state_dict``.

    Raises WeightsError when the state is that of another classifier, of none, or incomplete.
    """
    about = read_about(state.get("about"))
    check_classifier(about, classifier.name)
    inner = {key[len(LEARNED) :]: value for key, value in state.items() if key.startswith(LEARNED)}
    fitted = Fitted(classifier, about.axes, about.hue, Learned(inner, about.floats))
    fitted.load_state_dict(dict(state))
    return fitted


def save(fitted: Fitted, path: str | Path) -> None:
    """Write a fitted classifier as a safetensors file, whole or not at all.

    Raises InputError when the folder cannot be written.
    """
    state = fitted.state_dict()
    data = as_safetensors(state, {HASH: tensors_hash(state)})
    with atomic(path) as temporary:
        temporary.write_bytes(data)


def load(classifier: Classifier, path: str | Path) -> Fitted:
    """Read what ``save`` wrote; WeightsError if it is damaged or another classifier's.

    A state may hold anything that a classifier learns, so that only its hash tells damage.
    """
    try:
        regular_size(path)
        with safe_open(path, "pt") as file:
            stated = (file.metadata() or {}).get(HASH)
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except OSError as problem:
        what = f"cannot be read: {problem.strerror or problem}"
        raise WeightsError(path, what, "give a file that save wrote") from None
    except SafetensorError as problem:
        raise WeightsError(path, f"is damaged: {problem}", "fit and save it again") from None
    try:
        fitted = restored(classifier, state)
    except WeightsError as problem:
        raise WeightsError(path, problem.what, problem.remedy) from None
    if stated != tensors_hash(state):
        what = "is damaged, or of an earlier version: it does not state the hash of its tensors"
        raise WeightsError(path, what, "fit and save it again")
    return fitted
