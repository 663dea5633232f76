"""The fused detectors: naive Bayes over layout, texture and, in ours, more (P2 section 5)."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from roadtorch.base.settings import Settings
from roadtorch.detectors.detector import (
    TUNED_THRESHOLD,
    Analysis,
    Entry,
    Outlines,
    Threshold,
    WorkingSettings,
    use_inference_mode,
)
from roadtorch.imaging.color import brightened
from roadtorch.imaging.resize import WorkingSize, side, whole
from roadtorch.imaging.segments import Segments, measure_segments, paint, segment_mean
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import CLASSES, HORIZONTAL, Share, pooled
from roadtorch.layout.labeller import EXPOSURE, HorizonSettings, decide_layout, segment_layout
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import (
    FOR_IMAGES,
    WeightsFile,
    WholeImageNetwork,
    image_network_of,
    network_of,
)
from roadtorch.road.ego import continued, ego_found, is_anywhere
from roadtorch.road.fusion import (
    PRIORS,
    RULES,
    fused_log_odds,
    likelihood_product,
    log_odds,
    road_place,
    seed_log_odds,
    segment_road,
)
from roadtorch.road.seed_area import (
    distance_likelihood,
    likely_seed,
    likely_seed_area,
    seed_distance,
    seed_rectangle,
    seed_segments,
)
from roadtorch.road.texture import (
    Saturation,
    TextureSettings,
    fused_uniformity,
    uniformity_likelihood,
    unsaturated_uniformity,
)
from roadtorch.road.trust import Judgement, TrustSettings, judgement, signs_of


class RoadCalibration(Settings):
    """What makes 0.5 mean as likely road as not on any camera, and other values what they say.

    Platt scaling (``train/calibrate.py``).
    """

    centre: float = Field(
        default=0.0, ge=-20, le=20, description="log odds that part road in most images"
    )
    temperature: float = Field(
        default=1.0, gt=0, le=100, description="by which log odds are divided then"
    )


class SecondNetwork(Settings):
    """Another network beside the first: it began elsewhere, so that it errs elsewhere.

    Road and layout are the mean of both; the ego car is the first one's, which may have adapted.
    """

    file: str = Field(
        default="",
        description="its weights, or the name of shipped ones, such as rendered-free; empty: none",
    )
    share: float = Field(default=0.4, gt=0, lt=1, description="of it in the mean of both")


class FusionSettings(WorkingSettings):
    """The road as a network has learned it from other streets, along the image's own outlines."""

    threshold: Threshold = 0.5
    working: WorkingSize = WorkingSize(pixels=256 * 192)
    outlines: Outlines = "guided"
    weights: WeightsFile = WeightsFile()
    cuts: tuple[Annotated[float, Field(gt=0, le=0.9)], ...] = Field(
        strict=False,
        default=(),
        max_length=8,
        description="shares of the height that are cut off at the top for further looks, from "
        "closer by, at what is left; the mean of all looks counts",
    )
    second: SecondNetwork = SecondNetwork()
    calibration: RoadCalibration = RoadCalibration()
    trust: TrustSettings = TrustSettings()


class UntrainedFusionSettings(WorkingSettings):
    """The fused detector without a network."""

    threshold: Threshold = Field(default=0.39, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: HorizonSettings = HorizonSettings()


class LearnedRoad(Settings):
    """How much the road is trusted that the network has learned: weights of its log odds."""

    weight: float = Field(default=1.0, ge=0, le=10, description="in the mean of each superpixel")
    detail: float = Field(default=0.5, ge=0, le=10, description="pixel by pixel, at the end")


class ScratchFusionSettings(UntrainedFusionSettings):
    """The fused detector with a network that began with random weights.

    It works at 240x180, with as many superpixels as the one without a network has at 320x240:
    scores are the same within .001, and it takes three quarters of the time (docs/performance.md).
    """

    threshold: Threshold = 0.5
    working: WorkingSize = WorkingSize(pixels=240 * 180)
    outlines: Outlines = "guided"
    superpixels: Superpixels = Superpixels(pixels=144)
    weights: WeightsFile = WeightsFile()
    share: Share = 0.8
    learned: LearnedRoad = LearnedRoad()
    calibration: RoadCalibration = RoadCalibration(centre=-0.75)
    trust: TrustSettings = TrustSettings()


class PaperFusionSettings(WorkingSettings):
    """P2 as it is written: CNN-7, colour plane fusion over superpixels, a uniform prior.

    P2 combines CNN-7 with CPF, and shows CPFv2 beside it (Fig. 6a); it names the prior of eq. 4
    and tests a uniform one alone. The other two priors are baselines of ours.
    """

    threshold: Threshold = Field(default=0.131, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    weights: WeightsFile = WeightsFile()
    texture: TextureSettings = TextureSettings()
    descriptor: Literal["cpf", "cpf:v2"] = Field(
        default="cpf", description="colour plane fusion, or the same without saturated pixels"
    )
    saturation: Saturation = Saturation()
    prior: Literal["uniform", "rows", "triangle"] = Field(
        default="uniform", description="where road is likely before the image is seen (eq. 4)"
    )


FROM_SCRATCH = "layout-free"
"""The shipped weights of a network that began with random ones."""


@use_inference_mode
def untrained(image: Tensor, settings: UntrainedFusionSettings) -> Mapping[str, Tensor]:
    """Naive Bayes of what one image (3,H,W) shows by itself. Ours, after P2."""
    image = brightened(image, EXPOSURE)
    segments = measure_segments(image, settings.superpixels.cut(image))
    labels, layout = segments.labels, segment_layout(segments, settings.labeller.rules)
    seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
    near, even, cues = seen_from(image, segments, seed, seed_segments(labels, seed))
    return {
        "likelihood": paint(segment_road(segments, layout[:, HORIZONTAL], near, even), labels),
        "layout": paint(layout.T, labels),
        "layout_labels": paint(decide_layout(layout), labels),
        "seed_area": seed,
        **cues,
    }


class Fusion(nn.Module):
    """The road that a network has learned from other streets: the best we know.

    P2 fuses what was learned off line with what the image shows by itself. With a network that
    sees 192x256 pixels texture, distance from the seed area, place and look no longer pay for
    their time (docs/research/p2.md); ``fusion:scratch``, whose network knows less, and
    ``fusion:untrained`` have them.
    """

    def __init__(self, settings: FusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = image_network_of(settings.weights, FOR_IMAGES)
        file = settings.second.file
        self.second = image_network_of(WeightsFile(file=file), file) if file else None

    @use_inference_mode
    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]; in an exported graph of a batch (N,3,H,W)."""
        learned = self.learned(image)
        ego = ego_found(learned["ego"])
        layout, road = learned["layout"], learned["road"]
        if is_anywhere(ego):
            known = torch.cat([layout, road[..., None, :, :]], -3)
            layout, road = continued(known, ego).split([CLASSES, 1], -3)
            road = road.squeeze(-3)
        odds = log_odds(road)
        return {
            "likelihood": calibrated(odds, self.settings.calibration),
            "layout": layout,
            "layout_labels": decide_layout(layout.movedim(-3, -1)),
            "learned_road": road,
            "seed_area": likely_seed_area(odds, self.settings.seed_area.share),
            "ego": ego,
        }

    def learned(self, image: Tensor) -> Mapping[str, Tensor]:
        """What is known from other streets of an image (3,H,W): ``layout``, ``road``, ``ego``."""
        learned = seen_closer(self.network, image, self.settings.cuts)
        if self.second is None:
            return learned
        other = seen_closer(self.second, image, self.settings.cuts)
        share = self.settings.second.share
        pooled = {
            name: torch.lerp(learned[name], other[name], share) for name in ("layout", "road")
        }
        return {**learned, **pooled}

    def judge(self, mask: Tensor, cues: Mapping[str, Tensor]) -> Judgement:
        """How far a mask bool (H,W) can be trusted; the likelihood is one of the cues."""
        signs = signs_of(cues["likelihood"], mask, cues)
        return judgement(signs, mask.flatten(-2).any(-1), self.settings.trust)


def seen_closer(
    network: WholeImageNetwork, image: Tensor, cuts: Sequence[float]
) -> Mapping[str, Tensor]:
    """``cues`` of an image (…,3,H,W), and of what is left of it below each cut; their mean."""
    total, height = network.cues(image), image.shape[-2]
    looks = image.new_ones(height, 1)
    for cut in cuts:
        rows = whole(side(height) * (1 - cut), 1)
        lower = image.index_select(-2, torch.arange(height - rows, height, device=image.device))
        above, maps = (0, 0, height - rows, 0), network.cues(lower)
        total = {name: total[name] + functional.pad(maps[name], above) for name in total}
        looks = looks + functional.pad(looks.new_ones(rows, 1), above)
    return {name: maps / looks for name, maps in total.items()} if cuts else total


def calibrated(odds: Tensor, calibration: RoadCalibration) -> Tensor:
    """Likelihoods in [0,1] of log odds, of any shape."""
    return ((odds - calibration.centre) / calibration.temperature).sigmoid()


class ScratchFusion(nn.Module):
    """Naive Bayes of what the image shows and what a network has learned from other streets.

    The network says where the ego car is, and the ground above is continued over it before
    anything is measured; the seed area is where place, layout and network see road.
    """

    def __init__(self, settings: ScratchFusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = image_network_of(settings.weights, FROM_SCRATCH)

    @use_inference_mode
    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings = self.settings
        learned = self.network.cues(image)
        ego = ego_found(learned["ego"])
        if is_anywhere(ego):
            known = torch.cat([image, learned["layout"], learned["road"][None]])
            image, layout, road = continued(known, ego).split([3, CLASSES, 1])
            learned = {"layout": layout, "road": road[0]}
        image = brightened(image, EXPOSURE)
        segments = measure_segments(image, settings.superpixels.cut(image))
        labels, own = segments.labels, segment_layout(segments, settings.labeller.rules)
        taught = segment_mean([*learned["layout"], learned["road"]], labels, segments.pixels)
        layout = pooled(own.T, taught[:CLASSES], settings.share)
        known = log_odds(taught[CLASSES])
        evidence = known + seed_log_odds(segments, layout[HORIZONTAL])
        share = settings.seed_area.share
        sources = likely_seed(evidence, segments.row, segments.size, share)
        seed = sources[labels]
        near, even, cues = seen_from(image, segments, seed, sources.nonzero()[:, 0])
        further = settings.learned.weight * known
        road = segment_road(segments, layout[HORIZONTAL], near, even, further)
        odds = fused_log_odds([paint(road, labels), learned["road"]], [1, settings.learned.detail])
        return {
            "likelihood": calibrated(odds, settings.calibration),
            "layout": pooled(paint(own.T, labels), learned["layout"], settings.share),
            "layout_labels": paint(decide_layout(layout.T), labels),
            "learned_road": learned["road"],
            "seed_area": seed,
            "ego": ego,
            **cues,
        }

    judge = Fusion.judge


def seen_from(
    image: Tensor, segments: Segments, seed: Tensor, sources: Tensor
) -> tuple[Tensor, Tensor, Mapping[str, Tensor]]:
    """How like the seed area segments are: likelihoods (n,) by distance and by texture, and cues.

    image: (3,H,W) as it was measured; seed: bool (H,W); sources: numbers (k,) of its segments.
    """
    labels, settings = segments.labels, TextureSettings()
    fused, uniformity, clipped = unsaturated_uniformity(image, labels, seed, settings, Saturation())
    even = uniformity_likelihood(uniformity, settings.even)
    near = distance_likelihood(seed_distance(segments, sources), RULES.reach)
    cues = {
        "texture": paint(even, labels),
        "uniformity": paint(uniformity, labels),
        "fused_plane": fused,
        "saturated": clipped,
        "distance": paint(near, labels),
        "place": paint(road_place(segments.row, segments.column), labels),
        "segments": labels,
    }
    return near, even, cues


class PaperFusion(nn.Module):
    """Prior times layout of CNN-7 times uniformity, P2 eq. 4."""

    def __init__(self, settings: PaperFusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = network_of(settings.weights, "cnn-7-paper", PatchNetwork)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        settings, texture = self.settings, self.settings.texture
        layout = self.network.potentials(image)
        labels = settings.superpixels.cut(image)
        seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
        if settings.descriptor == "cpf":
            fused, values = fused_uniformity(image, labels, labels >= 0, seed, texture)
        else:
            fused, values, _ = unsaturated_uniformity(
                image, labels, seed, texture, settings.saturation
            )
        uniformity = paint(values, labels)
        prior = PRIORS[settings.prior](*labels.shape).to(image)
        return {
            # The paper thresholds the product as it is.
            "likelihood": likelihood_product(prior, [layout[HORIZONTAL], uniformity]),
            "layout": layout,
            "texture": uniformity_likelihood(uniformity, texture.even),
            "uniformity": uniformity,
            "fused_plane": fused,
            "segments": labels,
        }


ENTRIES = (
    Entry(
        "fusion",
        "network trained on rendered worlds and machine labels, refined at image edges",
        FusionSettings,
        Fusion,
    ),
    Entry(
        "fusion:large",
        "two networks, each also run on an enlarged lower crop: more accurate, slower",
        FusionSettings,
        Fusion,
        values={
            "cuts": (0.3,),
            "second": {"file": "rendered-free"},
            "working": {"pixels": 352 * 256},
        },
    ),
    Entry(
        "fusion:scratch",
        "layout, texture and more fused with a network trained without any human label",
        ScratchFusionSettings,
        ScratchFusion,
    ),
    Entry(
        "fusion:untrained",
        "layout, texture and more fused, without a network",
        UntrainedFusionSettings,
        partial(Analysis, untrained),
    ),
    Entry(
        "fusion:paper",
        "layout of CNN-7 times uniformity, faithful reimplementation (Álvarez 2012)",
        PaperFusionSettings,
        PaperFusion,
    ),
)
