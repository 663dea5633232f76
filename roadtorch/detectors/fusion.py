"""The fused detectors: naive Bayes over layout, texture and, in ours, more (P2 section 5)."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Literal, NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn

from roadtorch.analysis import lean
from roadtorch.detector import TUNED, Entry, Threshold, WorkingSettings
from roadtorch.ego import continued, ego_found, is_anywhere
from roadtorch.exposure import brightened
from roadtorch.fusion import (
    SegmentRoadSettings,
    fused_log_odds,
    likelihood_product,
    log_odds,
    road_place,
    segment_road,
)
from roadtorch.layout.classes import CLASSES, HORIZONTAL
from roadtorch.layout.labeller import LabellerSettings, decide_layout, segment_layout
from roadtorch.layout.opinion_pool import Share, pooled
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import FOR_PICTURES, WeightsFile, network_of
from roadtorch.otsu import centred_odds
from roadtorch.priors import prior_rows, prior_triangle, prior_uniform
from roadtorch.seed_area import likely_seed, seed_rectangle, seed_segments
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
from roadtorch.trust import Judgement, TrustSettings, judgement, signs_of
from roadtorch.working_size import WorkingSize


class LearnedRoad(Settings):
    """How much the road is trusted that the network has learned: weights of its log odds."""

    weight: float = Field(default=1.0, ge=0, le=10, description="in the mean of each superpixel")
    detail: float = Field(default=0.5, ge=0, le=10, description="pixel by pixel, at the end")


class RoadCalibration(Settings):
    """What makes 0.5 mean as likely road as not on any camera, in log odds.

    See ``centred_odds``.
    """

    centre: float = Field(default=-0.75, ge=-20, le=20, description="what parts road in most")
    own: float = Field(
        default=0.25, ge=0, le=1, description="share of what parts this very picture (Otsu)"
    )
    temperature: float = Field(default=1.0, gt=0, le=100, description="divides the log odds")


class UntrainedFusionSettings(WorkingSettings):
    """The fused detector without a network: each part with its own group of settings."""

    threshold: Threshold = Field(default=0.39, description=TUNED)
    superpixels: Superpixels = Superpixels()
    labeller: LabellerSettings = LabellerSettings()
    texture: TextureSettings = TextureSettings()
    saturation: Saturation = Saturation()
    road: SegmentRoadSettings = SegmentRoadSettings()


class FusionSettings(UntrainedFusionSettings):
    """The fused detector with a network that has seen other streets.

    It thinks at 240x180, with as many superpixels as the one without a network has at 320x240:
    scores are the same within .001, and it takes three quarters of the time (docs/performance.md).
    """

    threshold: Threshold = 0.5
    working: WorkingSize = WorkingSize(pixels=240 * 180)
    superpixels: Superpixels = Superpixels(pixels=144)
    weights: WeightsFile = WeightsFile()
    share: Share = 0.8
    learned: LearnedRoad = LearnedRoad(weight=0.5)
    calibration: RoadCalibration = RoadCalibration()
    trust: TrustSettings = TrustSettings()


class ResearchFusionSettings(FusionSettings):
    """The same with weights for research and private use, learned from more pictures.

    They have seen more and are trusted more (``train/choose_pool.py``).
    """

    weights: WeightsFile = WeightsFile(file="layout")
    learned: LearnedRoad = LearnedRoad(weight=1.0)


class PaperFusionSettings(WorkingSettings):
    """P2 as it is written: CNN-7, colour plane fusion over superpixels, a uniform prior.

    P2 combines CNN-7 with CPF, and shows CPFv2 beside it (Fig. 6a); it names the prior of eq. 4
    and tests a uniform one alone. The other two priors are our floors.
    """

    threshold: Threshold = Field(default=0.258, description=TUNED)
    superpixels: Superpixels = Superpixels()
    weights: WeightsFile = WeightsFile()
    texture: TextureSettings = TextureSettings()
    descriptor: Literal["cpf", "cpf:v2"] = Field(
        default="cpf", description="colour plane fusion, or the same without saturated pixels"
    )
    saturation: Saturation = Saturation()
    prior: Literal["uniform", "rows", "triangle"] = Field(
        default="uniform", description="where road is likely before the picture is seen (eq. 4)"
    )


PRIORS: Mapping[str, Callable[[int, int], Tensor]] = {
    "uniform": prior_uniform,
    "rows": prior_rows,
    "triangle": prior_triangle,
}


class UntrainedFusion(nn.Module):
    """Naive Bayes of what one picture shows by itself. Ours, after P2."""

    def __init__(self, settings: UntrainedFusionSettings) -> None:
        super().__init__()
        self.settings = settings

    @lean
    def forward(self, image: Tensor) -> Mapping[str, Tensor | Callable[[], Tensor]]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings = self.settings
        street = look_at(image, settings)
        rectangle = seed_rectangle(street.labels.shape, settings.seed_area).to(image.device)
        sources = seed_segments(street.labels, rectangle)
        ground = street.layout[:, HORIZONTAL]
        nearby = seen_from(street, rectangle, sources, settings)
        road = segment_road(street.segments, ground, nearby.near, nearby.even, settings.road)
        labels = decide_layout(street.layout, settings.labeller)
        return {
            "likelihood": paint(road, street.labels),
            "layout": partial(paint, street.layout.T, street.labels),
            "layout_labels": partial(paint, labels, street.labels),
            "seed_area": rectangle,
            **nearby.cues,
        }


class Fusion(nn.Module):
    """The same with what a network has learned from other streets: the best we know.

    The network says where the ego car is, and the ground above is continued over it before
    anything is measured; the seed area is where place, layout and network see road.
    """

    def __init__(self, settings: FusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = network_of(settings.weights, FOR_PICTURES, PictureNetwork)

    @lean
    def forward(self, image: Tensor) -> Mapping[str, Tensor | Callable[[], Tensor]]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings = self.settings
        learned = self.learned(image)
        ego = ego_found(learned["ego"])
        if is_anywhere(ego):
            known = torch.cat([image, learned["layout"], learned["road"][None]])
            image, layout, road = continued(known, ego).split([3, CLASSES, 1])
            learned = {"layout": layout, "road": road[0]}
        street = look_at(image, settings)
        segments, labels = street.segments, street.labels
        taught = segment_mean([*learned["layout"], learned["road"]], labels, segments.pixels)
        layout = pooled(street.layout.T, taught[:CLASSES], settings.share)
        known = log_odds(taught[CLASSES])
        sources = seed_found(segments, layout[HORIZONTAL], known, settings)
        seed = sources[labels]
        nearby = seen_from(street, seed, sources.nonzero()[:, 0], settings)
        road = segment_road(
            segments,
            layout[HORIZONTAL],
            nearby.near,
            nearby.even,
            settings.road,
            settings.learned.weight * known,
        )
        odds = fused_log_odds([paint(road, labels), learned["road"]], [1, settings.learned.detail])
        decided = decide_layout(layout.T, settings.labeller)
        return {
            "likelihood": calibrated(odds, settings.calibration),
            "layout": partial(
                pooled_layout, street.layout, labels, learned["layout"], settings.share
            ),
            "layout_labels": partial(paint, decided, labels),
            "learned_road": learned["road"],
            "seed_area": seed,
            "ego": ego,
            **nearby.cues,
        }

    def learned(self, image: Tensor) -> Mapping[str, Tensor]:
        """What is known from other streets of an image (3,H,W): ``layout``, ``road``, ``ego``."""
        return self.network.cues(image)

    def judge(self, mask: Tensor, found: Mapping[str, Tensor]) -> Judgement:
        """How far a mask bool (H,W) of what was found can be trusted."""
        signs = signs_of(found["likelihood"], mask, found)
        return judgement(signs, bool(mask.any()), self.settings.trust)


def pooled_layout(seen: Tensor, labels: Tensor, learned: Tensor, share: float) -> Tensor:
    """Potentials (3,H,W): those of the segments (n,3) of labels (H,W), pooled with learned ones."""
    return pooled(paint(seen.T, labels), learned, share)


def seed_found(
    segments: Segments, ground: Tensor, known: Tensor, settings: FusionSettings
) -> Tensor:
    """Which of n segments are the seed area, bool (n,): by ground, place and learned road.

    ground: potentials (n,); known: the learned road's log odds (n,). As large as the settings'
    rectangle.
    """
    place = road_place(segments.row, segments.column, settings.road.place)
    weights = [settings.road.exponents.layout, settings.road.place.weight]
    evidence = known + fused_log_odds([ground, place], weights)
    return likely_seed(evidence, segments.row, segments.size, settings.seed_area.share)


def calibrated(odds: Tensor, calibration: RoadCalibration) -> Tensor:
    """Likelihoods (H,W) in [0,1] of one picture's log odds (H,W), 0.5 where they part road."""
    centred = centred_odds(odds, calibration.centre, calibration.own)
    return (centred / calibration.temperature).sigmoid()


class Street(NamedTuple):
    """One picture's segments at working size and their layout (n,3) by the labeller."""

    image: Tensor
    segments: Segments
    layout: Tensor

    @property
    def labels(self) -> Tensor:
        """int64 (H,W)."""
        return self.segments.labels


def look_at(image: Tensor, settings: UntrainedFusionSettings) -> Street:
    """Segments and layout of an image (3,H,W) at working size, brightened where it is dark."""
    image = brightened(image, settings.labeller.exposure)
    segments = measure_segments(image, settings.superpixels.cut(image))
    return Street(image, segments, segment_layout(segments, settings.labeller))


class Nearby(NamedTuple):
    """How like the seed area segments are: likelihoods (n,) by distance and by texture."""

    near: Tensor
    even: Tensor
    cues: Mapping[str, Tensor | Callable[[], Tensor]]


def seen_from(
    street: Street, seed: Tensor, sources: Tensor, settings: UntrainedFusionSettings
) -> Nearby:
    """Texture and distance of a street's segments, seen from its seed area.

    seed: bool (H,W); sources: numbers (k,) of its segments.
    """
    segments, labels, road = street.segments, street.labels, settings.road
    fused, uniformity, clipped = unsaturated_uniformity(
        street.image, labels, seed, settings.texture, settings.saturation
    )
    even = uniformity_likelihood(uniformity, settings.texture.even)
    near = distance_likelihood(seed_distance(segments, sources), road.reach)
    place = road_place(segments.row, segments.column, road.place)
    cues: dict[str, Tensor | Callable[[], Tensor]] = {
        "texture": partial(paint, even, labels),
        "uniformity": partial(paint, uniformity, labels),
        "fused_plane": fused,
        "saturated": clipped,
        "distance": partial(paint, near, labels),
        "place": partial(paint, place, labels),
        "segments": labels,
    }
    return Nearby(near, even, cues)


class PaperFusion(nn.Module):
    """Prior times layout of CNN-7 times uniformity, P2 eq. 4."""

    def __init__(self, settings: PaperFusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = network_of(settings.weights, "cnn-7", PatchNetwork)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings = self.settings
        layout = self.network.potentials(image)
        labels = settings.superpixels.cut(image)
        seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
        fused, values = described(image, labels, seed, settings)
        uniformity = paint(values, labels)
        prior = PRIORS[settings.prior](*labels.shape).to(image)
        return {
            # The paper thresholds the product as it is.
            "likelihood": likelihood_product(prior, [layout[HORIZONTAL], uniformity]),
            "layout": layout,
            "texture": uniformity_likelihood(uniformity, settings.texture.even),
            "uniformity": uniformity,
            "fused_plane": fused,
            "segments": labels,
        }


def described(
    image: Tensor, labels: Tensor, seed: Tensor, settings: PaperFusionSettings
) -> tuple[Tensor, Tensor]:
    """The fused plane (H,W) and U (n,) of segments (H,W), by the descriptor of the settings."""
    if settings.descriptor == "cpf":
        return fused_uniformity(image, labels, labels >= 0, seed, settings.texture)
    return unsaturated_uniformity(image, labels, seed, settings.texture, settings.saturation)[:2]


ENTRIES = (
    Entry(
        "fusion",
        "naive Bayes of layout, texture and more: the best we know",
        FusionSettings,
        Fusion,
    ),
    Entry(
        "fusion:research",
        "the same with weights for research and private use",
        ResearchFusionSettings,
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
        "layout of CNN-7 times uniformity, as the paper has it (Álvarez 2012)",
        PaperFusionSettings,
        PaperFusion,
    ),
)
