"""The baselines: detectors that never look at the picture."""

from collections.abc import Callable
from functools import partial

from torch import Tensor, nn

from roadtorch.detector import DetectorSettings, Entry
from roadtorch.road.fusion import prior_rows, prior_triangle, prior_uniform


class Prior(nn.Module):
    """A location prior as an answer: ``prior(height, width)``, whatever the picture shows."""

    def __init__(self, settings: DetectorSettings, prior: Callable[[int, int], Tensor]) -> None:
        super().__init__()
        self.prior = prior

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """``likelihood`` (H,W) for an image (3,H,W)."""
        return {"likelihood": self.prior(*image.shape[-2:]).to(image)}


def _baseline(name: str, summary: str, prior: Callable[[int, int], Tensor]) -> Entry:
    return Entry(name, summary, DetectorSettings, partial(Prior, prior=prior), baseline=True)


ENTRIES = (
    _baseline("prior:uniform", "0.5 everywhere", prior_uniform),
    _baseline("prior:rows", "row / height", prior_rows),
    _baseline("prior:triangle", "a triangle ahead of the car", prior_triangle),
)
