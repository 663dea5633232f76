"""Detectors by texture alone: colour plane fusion, grey uniformity, LBP (P2)."""

from functools import partial

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.detectors.entry import (
    TUNED_THRESHOLD,
    Analysis,
    Entry,
    Threshold,
    WorkingSettings,
    use_inference_mode,
)
from roadtorch.imaging.color import color_plane
from roadtorch.imaging.segments import paint_segments, segment_histogram
from roadtorch.imaging.slic import Superpixels, square_grid
from roadtorch.road.seed_area import seed_area, seed_rectangle
from roadtorch.road.texture import (
    PATTERN_COUNT,
    Saturation,
    TextureSettings,
    fused_uniformity,
    quantise_plane,
    similarity,
    uniform_patterns,
    uniformity,
    uniformity_likelihood,
    unsaturated_uniformity,
)


class CpfSettings(WorkingSettings):
    """Settings of colour plane fusion over superpixels."""

    threshold: Threshold = Field(default=0.58, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    texture: TextureSettings = TextureSettings()


class CpfV2Settings(CpfSettings):
    """Settings of colour plane fusion over superpixels, without saturated pixels."""

    threshold: Threshold = Field(default=0.57, description=TUNED_THRESHOLD)
    saturation: Saturation = Saturation()


class CpfSquaresSettings(WorkingSettings):
    """Settings of colour plane fusion over squares."""

    threshold: Threshold = Field(default=0.58, description=TUNED_THRESHOLD)
    square: int = Field(
        default=16, ge=2, le=4096, description="side of the squares, in pixels at the working size"
    )
    texture: TextureSettings = TextureSettings()


class GreyUniformitySettings(WorkingSettings):
    """Settings of the uniformity of the grey image over superpixels."""

    threshold: Threshold = Field(default=0.58, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    bins: int = Field(
        default=64, ge=2, le=4096, description="bins of a superpixel's histogram of levels 0 to 1"
    )
    midpoint: float = Field(
        default=0.15, gt=0, le=1, description="uniformity U whose likelihood is 0.5"
    )


class LbpSettings(WorkingSettings):
    """Settings of local binary patterns over superpixels."""

    threshold: Threshold = Field(default=0.97, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()


def texture_cues(
    image: Tensor,
    labels: Tensor,
    seed: Tensor,
    settings: TextureSettings,
    limits: Saturation | None,
) -> dict[str, Tensor]:
    """Compute colour plane fusion over segments, and its likelihood as ``texture`` (P2 section 4).

    labels: int64 (H, W). seed: seed area, bool (H, W). limits: of saturated pixels, which are left
    out (section 6.2); None: all pixels count.
    """
    more = dict[str, Tensor]()
    if limits is None:
        fused, values = fused_uniformity(image, labels, labels >= 0, seed, settings)
    else:
        fused, values, more["saturated"] = unsaturated_uniformity(
            image, labels, seed, settings, limits
        )
    painted = paint_segments(values, labels)
    texture = uniformity_likelihood(painted, settings.midpoint)
    cues = {"uniformity": painted, "fused_plane": fused, "segments": labels, **more}
    return {"texture": texture, **cues}


@use_inference_mode
def cpf(image: Tensor, settings: CpfSettings | CpfSquaresSettings) -> dict[str, Tensor]:
    """Compute the uniformity of the fused plane over superpixels or squares (P2, section 4)."""
    if isinstance(settings, CpfSquaresSettings):
        labels = square_grid(image.shape[-2], image.shape[-1], settings.square).to(image.device)
    else:
        labels = settings.superpixels.cut(image)
    seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
    saturation = settings.saturation if isinstance(settings, CpfV2Settings) else None
    cues = texture_cues(image, labels, seed, settings.texture, saturation)
    return {"likelihood": cues.pop("texture"), **cues}


@use_inference_mode
def grey_uniformity(image: Tensor, settings: GreyUniformitySettings) -> dict[str, Tensor]:
    """Compute the uniformity of the grey image over superpixels, P2's baseline without fusion."""
    labels = settings.superpixels.cut(image)
    levels = quantise_plane(color_plane(image, "grey"), settings.bins, 0, 1)
    counts = segment_histogram(levels, labels, int(labels.max()) + 1, settings.bins)
    painted = paint_segments(uniformity(counts), labels)
    likelihood = uniformity_likelihood(painted, settings.midpoint)
    return {"likelihood": likelihood, "uniformity": painted, "segments": labels}


@use_inference_mode
def lbp(image: Tensor, settings: LbpSettings) -> dict[str, Tensor]:
    """Compare local binary patterns with those of the seed area, P2's texture baseline."""
    labels = settings.superpixels.cut(image)
    patterns = uniform_patterns(color_plane(image, "grey"))
    counts = segment_histogram(patterns, labels, int(labels.max()) + 1, PATTERN_COUNT)
    area = seed_area(labels.shape[-2], labels.shape[-1], settings.seed_area)
    reference = torch.bincount(patterns[area].flatten(), minlength=PATTERN_COUNT).to(counts)
    likelihood = paint_segments(similarity(counts, reference), labels)
    return {"likelihood": likelihood, "patterns": patterns, "segments": labels}


CPF = partial(Analysis, cpf)

ENTRIES = (
    Entry(
        "cpf", "uniformity of fused colour planes over superpixels (Álvarez 2012)", CpfSettings, CPF
    ),
    Entry("cpf:v2", "cpf without saturated pixels (Álvarez 2012)", CpfV2Settings, CPF),
    Entry(
        "cpf:squares",
        "cpf over squares instead of superpixels (Álvarez 2012)",
        CpfSquaresSettings,
        CPF,
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
