"""The fused detectors: naive Bayes over layout, texture and, in ours, more (P2 section 5)."""

from collections.abc import Mapping
from typing import NamedTuple

from pydantic import Field
from torch import Tensor

from roadtorch.detector import THRESHOLD, Analysis, Decision, Entry
from roadtorch.detectors.layout import SHARE, WithNetwork
from roadtorch.exposure import brightened
from roadtorch.fusion import RoadSettings, log_odds, naive_bayes, road_place, segment_road
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.layout.labeller import LabellerSettings, decide_layout, segment_layout
from roadtorch.layout.opinion_pool import pooled
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import Weights, network_of
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
from roadtorch.working_size import at_working_size


class LearnedRoad(Settings):
    """How much the road is trusted that the network has learned: weights of its log odds."""

    weight: float = Field(default=1.0, ge=0, le=10, description="in the mean of each superpixel")
    detail: float = Field(default=0.5, ge=0, le=10, description="pixel by pixel, at the end")


class UntrainedSettings(Decision):
    """The fused detector without a network: each part with its own group of settings."""

    threshold: float = Field(default=0.39, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()
    texture: TextureSettings = TextureSettings()
    saturation: Saturation = Saturation()
    road: RoadSettings = RoadSettings()


class FusionSettings(UntrainedSettings):
    """The fused detector with a network that has seen other streets."""

    threshold: float = Field(default=0.325, ge=0, le=1, description=THRESHOLD)
    weights: Weights = Weights()
    share: float = Field(default=0.7, ge=0, le=1, description=SHARE)
    learned: LearnedRoad = LearnedRoad()


class PaperSettings(Decision):
    """P2 as it is written: CNN-7, colour plane fusion over superpixels, a uniform prior."""

    threshold: float = Field(default=0.258, ge=0, le=1, description=THRESHOLD)
    superpixels: Superpixels = Superpixels()
    weights: Weights = Weights()
    texture: TextureSettings = TextureSettings()


def _untrained(settings: UntrainedSettings) -> Analysis:
    def analyse(image: Tensor) -> Mapping[str, Tensor]:
        street = _look_at(image, settings)
        layout = street.layout.T
        road = street.road(layout[HORIZONTAL], settings.road)
        return {
            "likelihood": paint(road, street.labels),
            "layout": paint(layout, street.labels),
            "layout_labels": paint(decide_layout(layout.T, settings.labeller), street.labels),
            **street.cues,
        }

    return at_working_size(analyse, settings.working)


def _fusion(settings: FusionSettings) -> Analysis:
    network = network_of(settings.weights, "layout", PictureNetwork)

    def analyse(image: Tensor) -> Mapping[str, Tensor]:
        learned = network.cues(image)
        street = _look_at(image, settings)
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

    return WithNetwork(network, at_working_size(analyse, settings.working))


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

    def road(self, ground: Tensor, road: RoadSettings, further: Tensor | float = 0.0) -> Tensor:
        """p(road) of each segment (n,), the layout's ground (n,) and further log odds given."""
        return segment_road(self.segments, ground, self.near, self.even, road, further)


def _look_at(image: Tensor, settings: UntrainedSettings) -> Street:
    image = brightened(image, settings.labeller.exposure)
    labels = settings.superpixels.cut(image)
    segments = measure_segments(image, labels)
    fused, uniformity, clipped = unsaturated_uniformity(
        image, labels, settings.seed, settings.texture, settings.saturation
    )
    even = uniformity_likelihood(uniformity, settings.texture.even)
    near = distance_likelihood(seed_distance(segments, settings.seed), settings.road.reach)
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


def _paper(settings: PaperSettings) -> Analysis:
    network = network_of(settings.weights, "cnn-7", PatchNetwork)

    def analyse(image: Tensor) -> dict[str, Tensor]:
        layout = network.potentials(image)
        labels = settings.superpixels.cut(image)
        everywhere = labels >= 0
        fused, values = fused_uniformity(image, labels, everywhere, settings.seed, settings.texture)
        uniformity = paint(values, labels)
        return {
            # Eq. 4 with a uniform prior; the paper thresholds the product as it is.
            "likelihood": layout[HORIZONTAL] * uniformity,
            "layout": layout,
            "texture": uniformity_likelihood(uniformity, settings.texture.even),
            "uniformity": uniformity,
            "fused_plane": fused,
            "segments": labels,
        }

    return WithNetwork(network, at_working_size(analyse, settings.working))


ENTRIES = (
    Entry(
        "fusion",
        "naive Bayes of layout, texture and more: the best we know",
        FusionSettings,
        _fusion,
    ),
    Entry(
        "fusion:untrained",
        "the same without the network: nothing was trained",
        UntrainedSettings,
        _untrained,
    ),
    Entry(
        "fusion:paper",
        "layout of CNN-7 times uniformity, as the paper has it (P2)",
        PaperSettings,
        _paper,
    ),
)
