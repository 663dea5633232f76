"""Detectors that rest on texture alone: colour plane fusion, grey uniformity, LBP (P2)."""

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.color import plane
from roadtorch.detector import THRESHOLD, Analysis, Decision, Entry
from roadtorch.lbp import PATTERNS, similarity
from roadtorch.seed_area import SeedArea, seed_area
from roadtorch.segment_statistics import paint
from roadtorch.superpixels import Superpixels, squares
from roadtorch.texture import (
    Saturation,
    TextureSettings,
    fused_uniformity,
    quantise,
    segment_histograms,
    uniformity,
    uniformity_likelihood,
    unsaturated_uniformity,
)
from roadtorch.working_size import at_working_size


class CpfSettings(Decision):
    """Colour plane fusion over superpixels."""

    threshold: float = Field(default=0.54, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    texture: TextureSettings = TextureSettings()


class CpfV2Settings(Decision):
    """Colour plane fusion over superpixels, without saturated pixels."""

    threshold: float = Field(default=0.52, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    texture: TextureSettings = TextureSettings()
    saturation: Saturation = Saturation()


class CpfSquaresSettings(Decision):
    """Colour plane fusion over squares."""

    threshold: float = Field(default=0.52, ge=0, le=1, description=THRESHOLD)
    square: int = Field(
        default=16, ge=2, le=4096, description="side of the squares in pixels at working size"
    )
    texture: TextureSettings = TextureSettings()


class GreySettings(Decision):
    """Uniformity of the grey image over superpixels."""

    threshold: float = Field(default=0.58, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    bins: int = Field(default=64, ge=2, le=4096, description="levels of the histograms")
    even: float = Field(
        default=0.15, gt=0, le=1, description="the uniformity U whose likelihood is 0.5"
    )


class LbpSettings(Decision):
    """Local binary patterns over superpixels."""

    threshold: float = Field(default=0.97, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    patterns: Literal["uniform", "smallest"] = Field(
        default="uniform", description="runs of brighter neighbours, or smallest rotation"
    )


def _texture_cues(labels: Tensor, fused: Tensor, values: Tensor, even: float) -> dict[str, Tensor]:
    return {
        "likelihood": paint(uniformity_likelihood(values, even), labels),
        "uniformity": paint(values, labels),
        "fused_plane": fused,
        "segments": labels,
    }


def _cpf_over(
    labels: Tensor, image: Tensor, seed: SeedArea, settings: TextureSettings
) -> dict[str, Tensor]:
    everywhere = torch.ones_like(labels, dtype=torch.bool)
    fused, values = fused_uniformity(image, labels, everywhere, seed, settings)
    return _texture_cues(labels, fused, values, settings.even)


def _cpf(settings: CpfSettings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        return _cpf_over(settings.superpixels.cut(image), image, settings.seed, settings.texture)

    return at_working_size(analyse, settings.working)


def _cpf_squares(settings: CpfSquaresSettings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        labels = squares(image.shape[-2], image.shape[-1], settings.square)
        return _cpf_over(labels.to(image.device), image, settings.seed, settings.texture)

    return at_working_size(analyse, settings.working)


def _cpf_v2(settings: CpfV2Settings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        labels = settings.superpixels.cut(image)
        fused, values, clipped = unsaturated_uniformity(
            image, labels, settings.seed, settings.texture, settings.saturation
        )
        cues = _texture_cues(labels, fused, values, settings.texture.even)
        return {**cues, "saturated": clipped}

    return at_working_size(analyse, settings.working)


def _grey_uniformity(settings: GreySettings) -> Analysis:
    def analyse(image: Tensor) -> dict[str, Tensor]:
        labels = settings.superpixels.cut(image)
        levels = quantise(plane(image, "grey"), settings.bins, 0, 1)
        everywhere = torch.ones_like(labels)
        values = uniformity(segment_histograms(levels, labels, settings.bins, everywhere))
        painted = paint(values, labels)
        likelihood = uniformity_likelihood(painted, settings.even)
        return {"likelihood": likelihood, "uniformity": painted, "segments": labels}

    return at_working_size(analyse, settings.working)


def _lbp(settings: LbpSettings) -> Analysis:
    patterns_of, codes = PATTERNS[settings.patterns]

    def analyse(image: Tensor) -> dict[str, Tensor]:
        labels = settings.superpixels.cut(image)
        patterns = patterns_of(plane(image, "grey"))
        counts = segment_histograms(patterns, labels, codes, torch.ones_like(labels))
        area = seed_area(labels.shape[-2], labels.shape[-1], settings.seed)
        reference = torch.bincount(patterns[area].flatten(), minlength=codes).to(counts)
        likelihood = paint(similarity(counts, reference), labels)
        return {"likelihood": likelihood, "patterns": patterns, "segments": labels}

    return at_working_size(analyse, settings.working)


ENTRIES = (
    Entry("cpf", "uniformity of fused colour planes over superpixels (P2)", CpfSettings, _cpf),
    Entry("cpf:v2", "the same without saturated pixels (P2)", CpfV2Settings, _cpf_v2),
    Entry("cpf:squares", "the same as cpf over squares (P2)", CpfSquaresSettings, _cpf_squares),
    Entry("grey-uniformity", "uniformity of the grey image (P2)", GreySettings, _grey_uniformity),
    Entry("lbp", "local binary patterns like those of the seed area (P2)", LbpSettings, _lbp),
)
