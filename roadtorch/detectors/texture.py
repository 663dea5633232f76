"""Detectors that rest on texture alone: colour plane fusion, grey uniformity, LBP (P2)."""

from functools import partial
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.detector import TUNED, Analysis, Entry, Threshold, WorkingSettings, lean
from roadtorch.imaging.color import plane
from roadtorch.road.seed_area import seed_area, seed_rectangle
from roadtorch.road.texture import (
    PATTERNS,
    Saturation,
    TextureSettings,
    fused_uniformity,
    quantise,
    segment_histograms,
    similarity,
    uniformity,
    uniformity_likelihood,
    unsaturated_uniformity,
)
from roadtorch.superpixels.segments import paint
from roadtorch.superpixels.slic import Superpixels, squares


class CpfSettings(WorkingSettings):
    """Colour plane fusion over superpixels."""

    threshold: Threshold = Field(default=0.54, description=TUNED)
    superpixels: Superpixels = Superpixels()
    texture: TextureSettings = TextureSettings()


class CpfV2Settings(WorkingSettings):
    """Colour plane fusion over superpixels, without saturated pixels."""

    threshold: Threshold = Field(default=0.52, description=TUNED)
    superpixels: Superpixels = Superpixels()
    texture: TextureSettings = TextureSettings()
    saturation: Saturation = Saturation()


class CpfSquaresSettings(WorkingSettings):
    """Colour plane fusion over squares."""

    threshold: Threshold = Field(default=0.52, description=TUNED)
    square: int = Field(
        default=16, ge=2, le=4096, description="side of the squares in pixels at working size"
    )
    texture: TextureSettings = TextureSettings()


class GreyUniformitySettings(WorkingSettings):
    """Uniformity of the grey image over superpixels."""

    threshold: Threshold = Field(default=0.58, description=TUNED)
    superpixels: Superpixels = Superpixels()
    bins: int = Field(default=64, ge=2, le=4096, description="levels of the histograms")
    even: float = Field(
        default=0.15, gt=0, le=1, description="the uniformity U whose likelihood is 0.5"
    )


class LbpSettings(WorkingSettings):
    """Local binary patterns over superpixels."""

    threshold: Threshold = Field(default=0.97, description=TUNED)
    superpixels: Superpixels = Superpixels()
    patterns: Literal["uniform", "smallest"] = Field(
        default="uniform", description="runs of brighter neighbours, or smallest rotation"
    )


@lean
def cpf(image: Tensor, settings: CpfSettings) -> dict[str, Tensor]:
    """Colour plane fusion: U of the fused plane over superpixels (P2, section 4)."""
    return _cues_over(settings.superpixels.cut(image), image, settings)


@lean
def cpf_squares(image: Tensor, settings: CpfSquaresSettings) -> dict[str, Tensor]:
    """Colour plane fusion over squares, which P2 compares superpixels with."""
    labels = squares(image.shape[-2], image.shape[-1], settings.square)
    return _cues_over(labels.to(image.device), image, settings)


def _cues_over(
    labels: Tensor, image: Tensor, settings: CpfSettings | CpfSquaresSettings
) -> dict[str, Tensor]:
    everywhere = torch.ones_like(labels, dtype=torch.bool)
    seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
    fused, values = fused_uniformity(image, labels, everywhere, seed, settings.texture)
    return _texture_cues(labels, fused, values, settings.texture.even)


@lean
def cpf_v2(image: Tensor, settings: CpfV2Settings) -> dict[str, Tensor]:
    """Colour plane fusion without saturated pixels (P2, section 6.2)."""
    labels = settings.superpixels.cut(image)
    seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
    fused, values, clipped = unsaturated_uniformity(
        image, labels, seed, settings.texture, settings.saturation
    )
    cues = _texture_cues(labels, fused, values, settings.texture.even)
    return {**cues, "saturated": clipped}


def _texture_cues(labels: Tensor, fused: Tensor, values: Tensor, even: float) -> dict[str, Tensor]:
    return {
        "likelihood": paint(uniformity_likelihood(values, even), labels),
        "uniformity": paint(values, labels),
        "fused_plane": fused,
        "segments": labels,
    }


@lean
def grey_uniformity(image: Tensor, settings: GreyUniformitySettings) -> dict[str, Tensor]:
    """U of the grey image over superpixels, P2's baseline without fusion."""
    labels = settings.superpixels.cut(image)
    levels = quantise(plane(image, "grey"), settings.bins, 0, 1)
    painted = paint(uniformity(segment_histograms(levels, labels, settings.bins)), labels)
    likelihood = uniformity_likelihood(painted, settings.even)
    return {"likelihood": likelihood, "uniformity": painted, "segments": labels}


@lean
def lbp(image: Tensor, settings: LbpSettings) -> dict[str, Tensor]:
    """Local binary patterns like those of the seed area, P2's texture baseline."""
    patterns_of, codes = PATTERNS[settings.patterns]
    labels = settings.superpixels.cut(image)
    patterns = patterns_of(plane(image, "grey"))
    counts = segment_histograms(patterns, labels, codes)
    area = seed_area(labels.shape[-2], labels.shape[-1], settings.seed_area)
    reference = torch.bincount(patterns[area].flatten(), minlength=codes).to(counts)
    likelihood = paint(similarity(counts, reference), labels)
    return {"likelihood": likelihood, "patterns": patterns, "segments": labels}


ENTRIES = (
    Entry(
        "cpf",
        "uniformity of fused colour planes over superpixels (Álvarez 2012)",
        CpfSettings,
        partial(Analysis, cpf),
    ),
    Entry(
        "cpf:v2",
        "the same without saturated pixels (Álvarez 2012)",
        CpfV2Settings,
        partial(Analysis, cpf_v2),
    ),
    Entry(
        "cpf:squares",
        "the same as cpf over squares (Álvarez 2012)",
        CpfSquaresSettings,
        partial(Analysis, cpf_squares),
    ),
    Entry(
        "grey-uniformity",
        "uniformity of the grey image (Álvarez 2012)",
        GreyUniformitySettings,
        partial(Analysis, grey_uniformity),
    ),
    Entry(
        "lbp",
        "local binary patterns like those of the seed area (Álvarez 2012)",
        LbpSettings,
        partial(Analysis, lbp),
    ),
)
