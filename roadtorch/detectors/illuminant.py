"""Detector by illuminant invariance (Álvarez and López 2011), the baseline of P1 to P3."""

from functools import partial

from pydantic import Field
from torch import Tensor

from roadtorch.detectors.entry import Analysis, Entry, WorkingSettings, use_inference_mode
from roadtorch.road.illuminant import (
    histogram_likelihood,
    invariant_angle,
    invariant_plane,
    log_chromaticity,
    projection_entropies,
)
from roadtorch.road.seed_area import seed_rectangle


class IlluminantSettings(WorkingSettings):
    """Settings of the road's histogram in the illuminant-invariant plane."""

    invariant_angle: float | None = Field(
        default=None,
        ge=0,
        lt=180,
        description="the camera's invariant direction in degrees (roadtorch camera estimates it);"
        " without it, the direction of least entropy in each image",
    )


@use_inference_mode
def illuminant_invariant(image: Tensor, settings: IlluminantSettings) -> dict[str, Tensor]:
    """Compute p(invariant value | road) by the seed area's histogram (Álvarez and López 2011)."""
    chromaticity = log_chromaticity(image)
    angle = settings.invariant_angle
    if angle is None:
        angle = invariant_angle(projection_entropies(chromaticity))
    plane = invariant_plane(chromaticity, angle)
    seed = seed_rectangle(plane.shape, settings.seed_area).to(image.device)
    return {"likelihood": histogram_likelihood(plane, seed), "invariant_plane": plane}


ENTRIES = (
    Entry(
        "illuminant-invariant",
        "histogram of the seed area in a shadow-free plane (Álvarez and López 2011)",
        IlluminantSettings,
        partial(Analysis, illuminant_invariant),
    ),
)
