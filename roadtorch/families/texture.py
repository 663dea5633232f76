"""Detectors that rest on texture alone: colour plane fusion, grey uniformity, LBP (P2)."""

from typing import Annotated, Literal

import torch
from pydantic import AfterValidator, Field
from torch import Tensor

from roadtorch import geometry, texture
from roadtorch.color import PLANES, plane, planes
from roadtorch.detectors import Analysis, Entry
from roadtorch.errors import unknown_name
from roadtorch.families.decision import THRESHOLD, Decision
from roadtorch.geometry import SeedArea, seed_area
from roadtorch.settings import Settings
from roadtorch.superpixels import paint, segment_histogram
from roadtorch.working import Superpixels, at_working_size


def _known_plane(name: str) -> str:
    if name not in PLANES:
        raise ValueError(unknown_name("plane", name, PLANES))
    return name


class TextureSettings(Settings):
    """Colour plane fusion and the histograms of the fused plane."""

    planes: tuple[Annotated[str, AfterValidator(_known_plane)], ...] = Field(
        default=("R", "G", "B", "nr", "ng", "O1", "O2", "S", "V"),
        min_length=1,
        strict=False,
        description="the colour planes that are fused",
    )
    ridge: float = Field(
        default=3e-3, ge=0, le=1e6, description="share of the mean variance added to the diagonal"
    )
    bins: int = Field(default=64, ge=2, le=4096, description="levels of the histograms")
    tail: float = Field(
        default=0.005, ge=0, lt=0.5, description="share of pixels beyond the levels, on each side"
    )
    even: float = Field(
        default=0.35, gt=0, le=1, description="the uniformity U whose likelihood is 0.5"
    )


class Saturation(Settings):
    """Which pixels CPFv2 leaves out."""

    dark: float = Field(
        default=0.02, ge=0, le=1, description="saturated if no channel is above this (0 to 1)"
    )
    bright: float = Field(
        default=0.98, ge=0, le=1, description="saturated if a channel reaches this (0 to 1)"
    )
    least: float = Field(
        default=0.5, ge=0, le=1, description="share of unsaturated pixels a segment needs"
    )


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


PATTERNS = {"uniform": (texture.uniform_patterns, 10), "smallest": (texture.smallest_patterns, 256)}
"""By name: the function and how many codes it has."""


def _histograms(levels: Tensor, labels: Tensor, bins: int, usable: Tensor) -> Tensor:
    return segment_histogram(levels, labels, int(labels.max()) + 1, bins, usable)


def fused_uniformity(
    image: Tensor, labels: Tensor, usable: Tensor, seed: SeedArea, settings: TextureSettings
) -> tuple[Tensor, Tensor]:
    """P2 section 4 step by step: weights from the seed area, fused plane, U of each segment.

    image: (3,H,W); labels: int64 (H,W), n segments; usable: bool (H,W), the pixels that count,
    for the weights as for the histograms (where the seed area has too few, all of its pixels
    give the weights). Returns the fused plane (H,W) and U (n,).
    """
    stack = planes(image, settings.planes)
    area = seed_area(labels.shape[-2], labels.shape[-1], seed)
    samples = stack[:, *area][:, usable[area]]
    if samples.shape[1] <= len(stack):
        samples = stack[:, *area].flatten(1)
    fused = texture.fused_plane(stack, texture.minimum_variance_weights(samples.T, settings.ridge))
    low, high = texture.value_range(fused, usable, settings.tail)
    levels = texture.quantise(fused, settings.bins, low, high)
    return fused, texture.uniformity(_histograms(levels, labels, settings.bins, usable))


def unsaturated_uniformity(
    image: Tensor,
    labels: Tensor,
    seed: SeedArea,
    settings: TextureSettings,
    saturation: Saturation,
) -> tuple[Tensor, Tensor, Tensor]:
    """CPFv2: the same without saturated pixels; U = 0 where a segment has few others.

    Returns the fused plane (H,W), U (n,) and where the picture is saturated, bool (H,W).
    """
    clipped = texture.saturated(image, saturation.dark, saturation.bright)
    fused, values = fused_uniformity(image, labels, ~clipped, seed, settings)
    counts = _histograms(clipped.long(), labels, 2, torch.ones_like(labels))
    kept = counts[:, 0] >= saturation.least * counts.sum(1)
    return fused, values * kept, clipped


def _texture_cues(labels: Tensor, fused: Tensor, values: Tensor, even: float) -> dict[str, Tensor]:
    return {
        "likelihood": paint(texture.uniformity_likelihood(values, even), labels),
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
        labels = geometry.squares(image.shape[-2], image.shape[-1], settings.square)
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
        levels = texture.quantise(plane(image, "grey"), settings.bins, 0, 1)
        everywhere = torch.ones_like(labels)
        values = texture.uniformity(_histograms(levels, labels, settings.bins, everywhere))
        uniformity = paint(values, labels)
        likelihood = texture.uniformity_likelihood(uniformity, settings.even)
        return {"likelihood": likelihood, "uniformity": uniformity, "segments": labels}

    return at_working_size(analyse, settings.working)


def _lbp(settings: LbpSettings) -> Analysis:
    patterns_of, codes = PATTERNS[settings.patterns]

    def analyse(image: Tensor) -> dict[str, Tensor]:
        labels = settings.superpixels.cut(image)
        patterns = patterns_of(plane(image, "grey"))
        counts = _histograms(patterns, labels, codes, torch.ones_like(labels))
        area = seed_area(labels.shape[-2], labels.shape[-1], settings.seed)
        reference = torch.bincount(patterns[area].flatten(), minlength=codes).to(counts)
        likelihood = paint(texture.similarity(counts, reference), labels)
        return {"likelihood": likelihood, "patterns": patterns, "segments": labels}

    return at_working_size(analyse, settings.working)


ENTRIES = (
    Entry("cpf", "uniformity of fused colour planes over superpixels (P2)", CpfSettings, _cpf),
    Entry("cpf:v2", "the same without saturated pixels (P2)", CpfV2Settings, _cpf_v2),
    Entry("cpf:squares", "the same as cpf over squares (P2)", CpfSquaresSettings, _cpf_squares),
    Entry("grey-uniformity", "uniformity of the grey image (P2)", GreySettings, _grey_uniformity),
    Entry("lbp", "local binary patterns like those of the seed area (P2)", LbpSettings, _lbp),
)
