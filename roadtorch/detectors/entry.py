"""Entries of the catalogue: what a detector is made of, its settings and its analysis.

An analysis is an ``nn.Module`` that turns an image into cues, one of them ``likelihood``; those of
roadtorch are in the other modules of ``detectors``.
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import wraps
from typing import Annotated, Any, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from roadtorch.base.settings import Settings, build_settings, merge
from roadtorch.camera.views import Rectification
from roadtorch.imaging.resize import WorkingSize
from roadtorch.road.ego import Ego
from roadtorch.road.outlines import Outlines
from roadtorch.road.seed_area import SeedArea
from roadtorch.road.trust import Judgement

Threshold = Annotated[
    float, Field(ge=0, le=1, description="likelihood from which a pixel is road, 0 to 1")
]
Isolated = Annotated[
    Literal["drop", "keep"],
    Field(description="drop road regions that do not touch the seed area, if any does; or keep"),
]

TUNED_THRESHOLD = "likelihood from which a pixel is road; the default was chosen on CamVid's labels"
"""Description of a threshold that was chosen on labelled images: CamVid's three drives."""


class DetectorSettings(Settings):
    """Settings of every detector: how its likelihood becomes a mask.

    >>> from roadtorch import DetectorSettings, load_detector
    >>> isinstance(load_detector("cpf").settings, DetectorSettings)
    True
    """

    threshold: Threshold = 0.5
    isolated: Isolated = "keep"
    seed_area: SeedArea = Field(
        default=SeedArea(), description="area assumed to be road; connected road touches it"
    )
    ego: Ego = Field(
        default=Ego(), description="vehicle that carries the camera: likelihood 0, never seed"
    )
    rectification: Rectification | None = Field(
        default=None, description="lens whose distortion is removed before the analysis; or none"
    )


class WorkingSettings(DetectorSettings):
    """Settings of detectors that analyse the image at a working size and drop isolated road.

    ``Detector`` resizes the image for the analysis, and its maps back to full size.
    """

    isolated: Isolated = "drop"
    working: WorkingSize = WorkingSize()
    outlines: Outlines = "smooth"


@dataclass(frozen=True)
class DetectorGrid:
    """Grid of detectors of one family, one for each combination of options, listed as one.

    name: ``family:<option>:<option>[:preset]``, with placeholders. summary: one line. invalid:
    names of combinations that are not offered, with the reason.
    """

    name: str
    summary: str
    invalid: Mapping[str, str] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """Prefix of all names, including the colon."""
        return self.name.partition(":")[0] + ":"

    @property
    def wildcard(self) -> str:
        """Pattern that matches all detectors: ``family:*``, or ``family:*:preset``."""
        last = self.name.rpartition(":")[2]
        return f"{self.family}*" if last.startswith("<") else f"{self.family}*:{last}"

    def matches(self, pattern: str) -> bool:
        """Return whether a pattern names the family and the preset, if any."""
        begin, _, end = self.wildcard.partition("*")
        return pattern.startswith(begin) and pattern.endswith(end)


@dataclass(frozen=True)
class Entry:
    """Entry of the catalogue of detectors; the entry points of other packages name theirs.

    Attributes:
        name: ``family[:option[:option]]``.
        summary: one line for lists.
        settings: class of its settings.
        build: makes from them, usually as a class, the ``nn.Module`` whose ``forward(image)`` takes
            an image in [0, 1], shape (3, H, W), and returns cues by name, shape (H, W) or
            (C, H, W); one of them is ``likelihood``, in [0, 1], shape (H, W).
        grid: grid of detectors that it is part of.
        baseline: whether it ignores the image.
        defaults: its defaults where they differ from those of the class, nested.

    >>> from roadtorch import Entry
    >>> from roadtorch.detectors.catalogue import detector_entry
    >>> isinstance(detector_entry("cpf"), Entry)
    True
    """

    name: str
    summary: str
    settings: type[DetectorSettings]
    build: Callable[[Any], nn.Module]
    grid: DetectorGrid | None = None
    baseline: bool = False
    defaults: Mapping[str, object] = field(default_factory=dict)

    def make_settings(self, changes: Mapping[str, object]) -> DetectorSettings:
        """Return its settings with changes, nested; ConfigError as ``build_settings``."""
        return build_settings(self.settings, merge(self.defaults, changes))


# --- analyses -----------------------------------------------------------------------------

Judge = Callable[[Tensor, Mapping[str, Tensor]], Judgement]
"""Optional method ``judge`` of an analysis: predicts the trust in a mask, bool (h, w), from it and
the cues of that size, with ``likelihood`` and ``ego``."""


def use_inference_mode(
    run: Callable[..., Mapping[str, Tensor]],
) -> Callable[..., dict[str, Tensor]]:
    """Decorate an analysis to run in inference mode, on the CPU and if gradients are disabled.

    Saves a fifteenth of the time. The maps go through NumPy, which makes them ordinary tensors.
    """

    @wraps(run)
    def wrapped(*arguments: object) -> dict[str, Tensor]:
        if torch.compiler.is_exporting():
            return dict(run(*arguments))
        on_cpu = all(item.device.type == "cpu" for item in arguments if isinstance(item, Tensor))
        with torch.inference_mode() if on_cpu and not torch.is_grad_enabled() else nullcontext():
            maps = run(*arguments)
        return {
            name: torch.from_numpy(map.numpy()) if map.is_inference() else map
            for name, map in maps.items()
        }

    return wrapped


class Analysis(nn.Module):
    """Analysis without weights: a function of image and settings that returns the cues."""

    def __init__(self, run: Callable[[Tensor, Any], Mapping[str, Tensor]], settings: Any) -> None:
        super().__init__()
        self.run = run
        self.settings = settings

    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """Compute the cues of an image (3, H, W) in [0, 1]."""
        return self.run(image, self.settings)
