"""One-class colour classification of pixels: every classifier on every representation (P3)."""

from collections.abc import Iterator
from functools import cache
from typing import Any, Literal

import torch
from pydantic import Field, create_model
from torch import Tensor

from roadtorch.color import REPRESENTATIONS
from roadtorch.detector import ISOLATED, Analysis, Entry, Grid
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
from roadtorch.settings import Settings
from roadtorch.working_size import WorkingSize, at_working_size


def _name(classifier: Classifier, planes: str) -> str:
    return f"oneclass:{classifier.name}:{planes}"


GRID = Grid(
    "oneclass:<classifier>:<planes>",
    "colours like those ahead of the car, learned from the one picture (P3)",
    {
        _name(classifier, planes): reason
        for classifier in CLASSIFIERS.values()
        for planes, names in REPRESENTATIONS.items()
        if (reason := classifier.refuses(len(names)))
    },
)

PIXELS = 640 * 480
"""Of P3's pictures, as far as is known."""

FAR = 1000.0
"""Thresholds beyond which the cue ``distance`` is cut off: empty bins are infinitely far."""


class OneClassSettings(Settings):
    """Where samples come from, and what the classifier is told.

    P3 thresholds the likelihood and nothing else, so isolated regions are kept. Its pictures
    are taken to be of 640×480 pixels, and larger ones are reduced to as many.
    """

    threshold: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="road from this likelihood on; at 0.5, samples but for the rejected fraction",
    )
    isolated: Literal["drop", "keep"] = Field(default="keep", description=ISOLATED)
    working: WorkingSize = WorkingSize(pixels=PIXELS)
    seed: WideSeedArea = WideSeedArea()
    samples: SampleSettings = SampleSettings()
    classifier: ClassifierSettings = ClassifierSettings()
    random: int = Field(default=0, ge=0, le=2**63 - 1, description="seed of restarts and of noise")


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
    return create_model(
        f"{classifier.name}_settings",
        __base__=OneClassSettings,
        __doc__=own.__doc__,
        __module__=__name__,
        **fields,
    )


def _one_class(settings: OneClassSettings, classifier: Classifier, planes: str) -> Analysis:
    names = REPRESENTATIONS[planes]
    axes = axes_of(names)

    def analyse(image: Tensor) -> dict[str, Tensor]:
        generator = torch.Generator().manual_seed(settings.random)
        samples = road_samples(image, names, settings.samples, settings.seed)
        fitted = fit(classifier, samples, axes, settings.classifier, generator)
        palette = representation(image, names)
        distance = fitted.distance(palette.values.T)
        used = torch.zeros_like(palette.index, dtype=torch.bool)
        used[sample_area(palette.index.shape, settings.seed)] = True
        near = distance.clamp_max(FAR * fitted.threshold)
        return {
            "likelihood": fitted.squashed(distance)[palette.index],
            "distance": near[palette.index],
            "seed_area": used,
        }

    return at_working_size(analyse, settings.working)


def _entries() -> Iterator[Entry]:
    for classifier in CLASSIFIERS.values():
        for planes in REPRESENTATIONS:
            if _name(classifier, planes) not in GRID.refused:
                yield _entry(classifier, planes)


def _entry(classifier: Classifier, planes: str) -> Entry:
    return Entry(
        _name(classifier, planes),
        f"{classifier.summary}, in {planes} (P3)",
        settings_of(classifier),
        lambda settings: _one_class(settings, classifier, planes),
        GRID,
    )


ENTRIES = tuple(_entries())
"""The 310 detectors: 17 classifiers on 19 representations, but PCA on a single plane."""
