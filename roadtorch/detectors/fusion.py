"""The fused detectors: naive Bayes over layout, texture and, in ours, more (P2 section 5)."""

from collections.abc import Mapping
from typing import NamedTuple

from pydantic import Field
from torch import Tensor, nn

from roadtorch.detector import TUNED, Entry, Threshold, WorkingSettings
from roadtorch.exposure import brightened
from roadtorch.fusion import (
    SegmentRoadSettings,
    log_odds,
    naive_bayes,
    road_place,
    segment_road,
)
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.labeller import LabellerSettings, decide_layout, segment_layout
from roadtorch.layout.opinion_pool import Share, pooled
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import WeightsFile, network_of
from roadtorch.seed_distance import distance_likelihood, seed_distance
from roadtorch.segment_features import Segments, measure_segments
from roadtorch.segment_statistics import paint, segment_mean
from roadtorch.settings import Settings
from roadtorch.superpixels import Superpixels
from roadtorch.texture import (
    Saturation,
    TextureSettings,
    fused_uniformity,
    uniformity_likelihood,
    unsaturated_uniformity,
)


class LearnedRoad(Settings):
    """How much the road is trusted that the network has learned: weights of its log odds."""

    weight: float = Field(default=1.0, ge=0, le=10, description="in the mean of each superpixel")
    detail: float = Field(default=0.5, ge=0, le=10, description="pixel by pixel, at the end")


class UntrainedFusionSettings(WorkingSettings):
    """The fused detector without a network: each part with its own group of settings."""

    threshold: Threshold = Field(default=0.39, description=TUNED)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()
    texture: TextureSettings = TextureSettings()
    saturation: Saturation = Saturation()
    road: SegmentRoadSettings = SegmentRoadSettings()


class FusionSettings(UntrainedFusionSettings):
    """The fused detector with a network that has seen other streets."""

    threshold: Threshold = Field(default=0.325, description=TUNED)
    weights: WeightsFile = WeightsFile()
    share: Share = 0.7
    learned: LearnedRoad = LearnedRoad()


class PaperFusionSettings(WorkingSettings):
    """P2 as it is written: CNN-7, colour plane fusion over superpixels, a uniform prior."""

    threshold: Threshold = Field(default=0.258, description=TUNED)
    superpixels: Superpixels = Superpixels()
    weights: WeightsFile = WeightsFile()
    texture: TextureSettings = TextureSettings()


class UntrainedFusion(nn.Module):
    """Naive Bayes of what one picture shows by itself. Ours, after P2."""

    def __init__(self, settings: UntrainedFusionSettings) -> None:
        super().__init__()
        self.settings = settings

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        street = look_at(image, self.settings)
        layout = street.layout.T
        road = street.road(layout[HORIZONTAL], self.settings.road)
        labels = decide_layout(street.layout, self.settings.labeller)
        return {
            "likelihood": paint(road, street.labels),
            "layout": paint(layout, street.labels),
            "layout_labels": paint(labels, street.labels),
            **street.cues,
        }


class Fusion(nn.Module):
    """The same with what a network has learned from other streets: the best we know."""

    def __init__(self, settings: FusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = network_of(settings.weights, "layout", PictureNetwork)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings = self.settings
        learned = self.network.cues(image)
        street = look_at(image, settings)
        labels, count = street.labels, len(street.layout)
        layout = pooled(
            street.layout.T, segment_mean(learned["layout"], labels, count), settings.share
        )
        known = segment_mean(learned["road"][None], labels, count)[0]
        further = settings.learned.weight * log_odds(known)
        road = paint(street.road(layout[HORIZONTAL], settings.road, further), labels)
        return {
            "likelihood": naive_bayes(road, [learned["road"]], [settings.learned.detail]),
            "layout": pooled(paint(street.layout.T, labels), learned["layout"], settings.share),
            "layout_labels": paint(decide_layout(layout.T, settings.labeller), labels),
            "learned_road": learned["road"],
            **street.cues,
        }


class Street(NamedTuple):
    """What one picture shows by itself, at working size; n segments.

    layout: (n,3) by the labeller. near, even: likelihoods (n,) by distance and texture.
    """

    segments: Segments
    layout: Tensor
    near: Tensor
    even: Tensor
    cues: Mapping[str, Tensor]

    @property
    def labels(self) -> Tensor:
        """int64 (H,W)."""
        return self.segments.labels

    def road(
        self, ground: Tensor, road: SegmentRoadSettings, further: Tensor | float = 0.0
    ) -> Tensor:
        """p(road) of each segment (n,), the layout's ground (n,) and further log odds given."""
        return segment_road(self.segments, ground, self.near, self.even, road, further)


def look_at(image: Tensor, settings: UntrainedFusionSettings) -> Street:
    """Layout, texture, distance and place of an image (3,H,W) at working size."""
    image = brightened(image, settings.labeller.exposure)
    labels = settings.superpixels.cut(image)
    segments = measure_segments(image, labels)
    fused, uniformity, clipped = unsaturated_uniformity(
        image, labels, settings.seed_area, settings.texture, settings.saturation
    )
    even = uniformity_likelihood(uniformity, settings.texture.even)
    near = distance_likelihood(seed_distance(segments, settings.seed_area), settings.road.reach)
    place = road_place(segments.row, segments.column, settings.road.place)
    cues = {
        "texture": paint(even, labels),
        "uniformity": paint(uniformity, labels),
        "fused_plane": fused,
        "saturated": clipped,
        "distance": paint(near, labels),
        "place": paint(place, labels),
        "segments": labels,
    }
    return Street(segments, segment_layout(segments, settings.labeller), near, even, cues)


class PaperFusion(nn.Module):
    """Layout of CNN-7 times uniformity, P2 eq. 4 with a uniform prior."""

    def __init__(self, settings: PaperFusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = network_of(settings.weights, "cnn-7", PatchNetwork)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings = self.settings
        layout = self.network.potentials(image)
        labels = settings.superpixels.cut(image)
        fused, values = fused_uniformity(
            image, labels, labels >= 0, settings.seed_area, settings.texture
        )
        uniformity = paint(values, labels)
        return {
            # The paper thresholds the product as it is.
            "likelihood": layout[HORIZONTAL] * uniformity,
            "layout": layout,
            "texture": uniformity_likelihood(uniformity, settings.texture.even),
            "uniformity": uniformity,
            "fused_plane": fused,
            "segments": labels,
        }


ENTRIES = (
    Entry(
        "fusion",
        "naive Bayes of layout, texture and more: the best we know",
        FusionSettings,
        Fusion,
    ),
    Entry(
        "fusion:untrained",
        "the same without the network: nothing was trained",
        UntrainedFusionSettings,
        UntrainedFusion,
    ),
    Entry(
        "fusion:paper",
        "layout of CNN-7 times uniformity, as the paper has it (P2)",
        PaperFusionSettings,
        PaperFusion,
    ),
)
