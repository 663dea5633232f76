"""The baselines: detectors that never look at the picture."""

from collections.abc import Callable
from functools import partial

from torch import Tensor

from roadtorch.detector import Analysis, DetectorSettings, Entry
from roadtorch.road.fusion import prior_rows, prior_triangle, prior_uniform

Prior = Callable[[int, int], Tensor]


def located(image: Tensor, settings: DetectorSettings, prior: Prior) -> dict[str, Tensor]:
    """A location prior as an answer: ``prior(height, width)``, whatever the image (3,H,W) shows."""
    return {"likelihood": prior(*image.shape[-2:]).to(image)}


def _baseline(name: str, summary: str, prior: Prior) -> Entry:
    build = partial(Analysis, partial(located, prior=prior))
    return Entry(name, summary, DetectorSettings, build, baseline=True)


ENTRIES = (
    _baseline("prior:uniform", "0.5 everywhere", prior_uniform),
    _baseline("prior:rows", "row / height", prior_rows),
    _baseline("prior:triangle", "a triangle ahead of the car", prior_triangle),
)
