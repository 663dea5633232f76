"""One-class colour classification of pixels: all classifiers on all representations (P3)."""

from collections.abc import Iterator
from functools import cache, partial
from itertools import product
from typing import Any

import torch
from pydantic import Field, create_model
from torch import Tensor

from roadtorch.detectors.entry import (
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
from roadtorch.oneclass.axes import make_axes
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


ONECLASS_GRID = DetectorGrid(
    "oneclass:<classifier>:<planes>",
    "colours like those ahead of the car, learned from the image (Álvarez 2014)",
    {
        _name(classifier, planes): reason
        for classifier in CLASSIFIERS.values()
        for planes, names in REPRESENTATIONS.items()
        if (reason := classifier.refusal(len(names)))
    },
)

PAPER_GRID = DetectorGrid(
    "oneclass:<classifier>:<planes>:paper",
    "faithful reimplementations where the default differs from the paper",
    {
        f"{_name(classifier, planes)}:paper": reason or "is already as in the paper"
        for classifier in CLASSIFIERS.values()
        for planes, names in REPRESENTATIONS.items()
        if (reason := classifier.refusal(len(names))) or not classifier.paper
    },
)

P3_PIXELS = 640 * 480  # of P3's images, as far as is known

MAX_SCALED_DISTANCE = 1000.0
"""Limit of the cue ``distance`` in multiples of the threshold, as empty bins are infinitely far."""


class OneClassSettings(WorkingSettings):
    """Settings of samples and classifier.

    As in P3, isolated regions are kept. Its images are assumed to have 640×480 pixels.
    """

    threshold: Threshold = Field(
        default=0.5,
        description="likelihood from which a pixel is road; at 0.5, all but the rejected samples",
    )
    isolated: Isolated = "keep"
    working: WorkingSize = WorkingSize(pixels=P3_PIXELS)
    seed_area: WideSeedArea = WideSeedArea()  # pyright: ignore[reportIncompatibleVariableOverride]  # frozen
    samples: SampleSettings = SampleSettings()
    classifier: ClassifierSettings = ClassifierSettings()
    random_seed: int = Field(
        default=0, ge=0, le=2**63 - 1, description="seed of random restarts and noise"
    )


@cache
def classifier_settings(classifier: Classifier) -> type[OneClassSettings]:
    """Create the settings class of a detector with that classifier.

    Histograms learn from each pixel of the seed area, others from superpixels (P3, section V).
    """
    group = classifier.settings
    every = issubclass(group, HistogramSettings)
    samples = AllSampleSettings if every else SampleSettings
    fields: dict[str, Any] = {"classifier": (group, group()), "samples": (samples, samples())}
    name, doc = f"{classifier.name}_settings", group.__doc__
    model = create_model(
        name, __base__=OneClassSettings, __doc__=doc, __module__=__name__, **fields
    )
    globals()[name] = model  # where pickle looks for it
    return model


def classify_pixels(
    image: Tensor, settings: OneClassSettings, classifier: Classifier, planes: str
) -> dict[str, Tensor]:
    """Classify all pixels of an image (3, H, W) by the colours of its seed area; on the CPU."""
    pixels, names = image.cpu(), REPRESENTATIONS[planes]
    generator = torch.Generator().manual_seed(settings.random_seed)
    samples = road_samples(pixels, names, settings.samples, settings.seed_area)
    fitted = fit(classifier, samples, make_axes(names), settings.classifier, generator)
    palette = representation(pixels, names)
    distance = fitted.distance(palette.values.T)
    seed = torch.zeros_like(palette.indices, dtype=torch.bool)
    seed[sample_area(palette.indices.shape, settings.seed_area)] = True
    clipped = distance.clamp_max(MAX_SCALED_DISTANCE * fitted.threshold)
    cues = {
        "likelihood": fitted.to_likelihood(distance)[palette.indices],
        "distance": clipped[palette.indices],
        "seed_area": seed,
    }
    return {name: cue.to(image.device) for name, cue in cues.items()}


def _entries() -> Iterator[Entry]:
    for classifier, planes in product(CLASSIFIERS.values(), REPRESENTATIONS):
        name, settings = _name(classifier, planes), classifier_settings(classifier)
        summary = f"{classifier.summary}, in {planes} (Álvarez 2014)"
        build = partial(Analysis, partial(classify_pixels, classifier=classifier, planes=planes))
        if name not in ONECLASS_GRID.invalid:
            yield Entry(name, summary, settings, build, ONECLASS_GRID)
        if f"{name}:paper" not in PAPER_GRID.invalid:
            summary, defaults = f"{summary}, as in the paper", {"classifier": classifier.paper}
            yield Entry(f"{name}:paper", summary, settings, build, PAPER_GRID, defaults=defaults)


ENTRIES = tuple(_entries())
"""17 classifiers on 19 representations, except PCA on a single plane: 310; and again, as in the
paper, the six whose defaults are ours."""
