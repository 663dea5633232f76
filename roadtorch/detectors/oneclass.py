"""One-class colour classification of pixels: every classifier on every representation (P3)."""

from collections.abc import Iterator
from functools import cache, partial
from itertools import product
from typing import Any

import torch
from pydantic import Field, create_model
from torch import Tensor

from roadtorch.detectors.detector import (
    Analysis,
    DetectorGrid,
    Entry,
    Isolated,
    Threshold,
    WorkingSettings,
)
from roadtorch.imaging.color import REPRESENTATIONS
from roadtorch.imaging.resize import WorkingSize
from roadtorch.oneclass import CLASSIFIERS
from roadtorch.oneclass.axes import axes_of
from roadtorch.oneclass.base import Classifier, ClassifierSettings, fit
from roadtorch.oneclass.histogram import HistogramSettings
from roadtorch.oneclass.samples import (
    AllSampleSettings,
    SampleSettings,
    WideSeedArea,
    representation,
    road_samples,
    sample_area,
)


def _name(classifier: Classifier, planes: str) -> str:
    return f"oneclass:{classifier.name}:{planes}"


GRID = DetectorGrid(
    "oneclass:<classifier>:<planes>",
    "colours like those ahead of the car, learned from the image (Álvarez 2014)",
    {
        _name(classifier, planes): reason
        for classifier in CLASSIFIERS.values()
        for planes, names in REPRESENTATIONS.items()
        if (reason := classifier.refuses(len(names)))
    },
)

PAPER = DetectorGrid(
    "oneclass:<classifier>:<planes>:paper",
    "faithful reimplementations where the default differs from the paper",
    {
        f"{_name(classifier, planes)}:paper": reason or "is already as in the paper"
        for classifier in CLASSIFIERS.values()
        for planes, names in REPRESENTATIONS.items()
        if (reason := classifier.refuses(len(names))) or not classifier.paper
    },
)

PIXELS = 640 * 480  # of P3's images, as far as is known

MAX_DISTANCE = 1000.0
"""Thresholds beyond which the cue ``distance`` is cut off: empty bins are infinitely far."""


class OneClassSettings(WorkingSettings):
    """Where samples come from, and what the classifier is told.

    P3 thresholds the likelihood and nothing else, so isolated regions are kept. Its images
    are taken to be of 640×480 pixels, and larger ones are reduced to as many.
    """

    threshold: Threshold = Field(
        default=0.5,
        description="road from this likelihood on; at 0.5, samples but for the rejected fraction",
    )
    isolated: Isolated = "keep"
    working: WorkingSize = WorkingSize(pixels=PIXELS)
    seed_area: WideSeedArea = WideSeedArea()
    samples: SampleSettings = SampleSettings()
    classifier: ClassifierSettings = ClassifierSettings()
    random_seed: int = Field(default=0, ge=0, le=2**63 - 1, description="of restarts and of noise")


@cache
def settings_of(classifier: Classifier) -> type[OneClassSettings]:
    """The settings of a detector with that classifier: the group ``classifier`` is its own.

    The histograms take every pixel of the seed area, the others one per superpixel
    (P3, section V).
    """
    own = classifier.settings
    every = issubclass(own, HistogramSettings)
    samples = AllSampleSettings if every else SampleSettings
    fields: dict[str, Any] = {"classifier": (own, own()), "samples": (samples, samples())}
    name, doc = f"{classifier.name}_settings", own.__doc__
    made = create_model(name, __base__=OneClassSettings, __doc__=doc, __module__=__name__, **fields)
    globals()[name] = made  # where pickle looks for it
    return made


def judged(
    image: Tensor, settings: OneClassSettings, classifier: Classifier, planes: str
) -> dict[str, Tensor]:
    """All pixels of an image (3,H,W) judged by a classifier of the colours of its seed area.

    Found on the CPU, with NumPy's help.
    """
    here, names = image.cpu(), REPRESENTATIONS[planes]
    generator = torch.Generator().manual_seed(settings.random_seed)
    samples = road_samples(here, names, settings.samples, settings.seed_area)
    fitted = fit(classifier, samples, axes_of(names), settings.classifier, generator)
    palette = representation(here, names)
    distance = fitted.distance(palette.values.T)
    used = torch.zeros_like(palette.index, dtype=torch.bool)
    used[sample_area(palette.index.shape, settings.seed_area)] = True
    near = distance.clamp_max(MAX_DISTANCE * fitted.threshold)
    cues = {
        "likelihood": fitted.squashed(distance)[palette.index],
        "distance": near[palette.index],
        "seed_area": used,
    }
    return {name: cue.to(image.device) for name, cue in cues.items()}


def _entries() -> Iterator[Entry]:
    for classifier, planes in product(CLASSIFIERS.values(), REPRESENTATIONS):
        name, kind = _name(classifier, planes), settings_of(classifier)
        summary = f"{classifier.summary}, in {planes} (Álvarez 2014)"
        build = partial(Analysis, partial(judged, classifier=classifier, planes=planes))
        if name not in GRID.invalid:
            yield Entry(name, summary, kind, build, GRID)
        if f"{name}:paper" not in PAPER.invalid:
            letter, values = f"{summary}, as in the paper", {"classifier": classifier.paper}
            yield Entry(f"{name}:paper", letter, kind, build, PAPER, values=values)


ENTRIES = tuple(_entries())
"""17 classifiers on 19 representations, but PCA on a single plane: 310. And of the six whose
defaults are ours P3's own."""
