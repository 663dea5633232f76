"""The floors: detectors that never look at the picture."""

from collections.abc import Callable

from pydantic import Field
from torch import Tensor

from roadtorch.detector import Analysis, Entry
from roadtorch.priors import prior_rows, prior_triangle, prior_uniform
from roadtorch.settings import Settings


class PriorSettings(Settings):
    """Settings of the floors that never look at the picture."""

    threshold: float = Field(default=0.5, ge=0, le=1, description="road from this likelihood on")


def _prior(make: Callable[[int, int], Tensor]) -> Callable[[PriorSettings], Analysis]:
    """A detector that answers with a location prior."""
    return lambda settings: lambda image: {"likelihood": make(*image.shape[-2:]).to(image)}


ENTRIES = (
    Entry("prior:uniform", "0.5 everywhere", PriorSettings, _prior(prior_uniform), floor=True),
    Entry("prior:rows", "row / height", PriorSettings, _prior(prior_rows), floor=True),
    Entry(
        "prior:triangle",
        "a triangle ahead of the car",
        PriorSettings,
        _prior(prior_triangle),
        floor=True,
    ),
)
