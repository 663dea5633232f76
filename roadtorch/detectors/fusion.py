"""Fusion: a network and the image's appearance, or naive Bayes of several cues (P2 section 5)."""

from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from roadtorch.base.settings import Settings
from roadtorch.detectors.entry import (
    TUNED_THRESHOLD,
    Analysis,
    Entry,
    Threshold,
    WorkingSettings,
    use_inference_mode,
)
from roadtorch.detectors.texture import texture_cues
from roadtorch.imaging.resize import WorkingSize
from roadtorch.imaging.segments import paint_segments
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES
from roadtorch.layout.labeller import HorizonSettings, decide_layout, label_segments
from roadtorch.layout.network_cues import compute_cues
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import (
    DEFAULT_WEIGHTS,
    WeightsFile,
    load_configured_network,
    load_image_network,
)
from roadtorch.road.appearance import fuse_appearance
from roadtorch.road.bayes import (
    PRIORS,
    likelihood_product,
    log_odds,
    road_position_prior,
    segment_road,
)
from roadtorch.road.ego import any_pixel, extrapolate_over_ego, find_ego_car
from roadtorch.road.outlines import Outlines
from roadtorch.road.seed_area import (
    distance_likelihood,
    find_seed_area,
    seed_distance,
    seed_rectangle,
    segments_inside,
)
from roadtorch.road.texture import (
    Saturation,
    TextureSettings,
    uniformity_likelihood,
    unsaturated_uniformity,
)
from roadtorch.road.trust import Judgement, TrustSettings, estimate_trust, trust_features


class RoadCalibration(Settings):
    """Calibration of the likelihood across cameras: Platt scaling (``train/calibrate.py``)."""

    centre: float = Field(
        default=0.0, ge=-20, le=20, description="log odds at which the likelihood becomes 0.5"
    )
    temperature: float = Field(
        default=1.0, gt=0, le=100, description="temperature that divides the centred log odds"
    )


class AppearanceSettings(Settings):
    """Fusion of the network's road with the appearance learned in the image."""

    weight: float = Field(
        default=1.0,
        ge=0,
        le=10,
        description="the appearance's weight is this times the network's mean doubt 1 - |2p - 1|, "
        "at most 0.5",
    )


class FusionSettings(WorkingSettings):
    """Settings of a network's road, fused with its appearance and refined at edges."""

    working: WorkingSize = WorkingSize(pixels=352 * 264)
    outlines: Outlines = "guided"
    weights: WeightsFile = WeightsFile()
    mirrored: bool = Field(
        default=False,
        description="also run the network on the mirrored image; outputs are averaged",
    )
    appearance: AppearanceSettings = AppearanceSettings()
    calibration: RoadCalibration = RoadCalibration()
    trust: TrustSettings = TrustSettings()


class UntrainedFusionSettings(WorkingSettings):
    """Settings of naive Bayes without a network."""

    threshold: Threshold = Field(default=0.39, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    labeller: HorizonSettings = HorizonSettings()


LocationPrior = Annotated[
    Literal["uniform", "rows", "triangle"], Field(description="location prior of the road (eq. 4)")
]


class PaperFusionSettings(WorkingSettings):
    """Settings of P2 as published: CNN-7, colour plane fusion over superpixels, a uniform prior.

    P2 combines CNN-7 with CPF, shows CPFv2 as well (Fig. 6a), and tests eq. 4 with a uniform prior
    only. The other two priors are ours.
    """

    threshold: Threshold = Field(default=0.171, description=TUNED_THRESHOLD)
    superpixels: Superpixels = Superpixels()
    weights: WeightsFile = WeightsFile()
    texture: TextureSettings = TextureSettings()
    descriptor: Literal["cpf", "cpf:v2"] = Field(
        default="cpf", description="colour plane fusion with, or without (v2), saturated pixels"
    )
    saturation: Saturation = Saturation()
    prior: LocationPrior = "uniform"


class BayesFusionSettings(PaperFusionSettings):
    """Settings of P2's equation 4 with the network of ``fusion`` in CNN-7's place."""

    threshold: Threshold = Field(default=0.1841, description=TUNED_THRESHOLD)
    prior: LocationPrior = "rows"


@use_inference_mode
def untrained_fusion(image: Tensor, settings: UntrainedFusionSettings) -> Mapping[str, Tensor]:
    """Compute the cues of an image (3, H, W) by naive Bayes without a network. Ours, after P2."""
    image, segments, layout = label_segments(image, settings.labeller, settings.superpixels)
    labels, options = segments.labels, TextureSettings(ridge=3e-3)  # chosen on CamVid. Ours
    seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
    fused, uniformity, clipped = unsaturated_uniformity(image, labels, seed, options, Saturation())
    texture = uniformity_likelihood(uniformity, options.midpoint)
    distance = distance_likelihood(seed_distance(segments, segments_inside(labels, seed)))
    road = segment_road(segments, layout[:, HORIZONTAL], distance, texture)
    position = road_position_prior(segments.row, segments.column)
    return {
        "likelihood": paint_segments(road, labels),
        "layout": paint_segments(layout.T, labels),
        "layout_labels": paint_segments(decide_layout(layout), labels),
        "seed_area": seed,
        "texture": paint_segments(texture, labels),
        "uniformity": paint_segments(uniformity, labels),
        "fused_plane": fused,
        "saturated": clipped,
        "distance": paint_segments(distance, labels),
        "position": paint_segments(position, labels),
        "segments": labels,
    }


class Fusion(nn.Module):
    """Road of a network, fused with its appearance in the image, calibrated.

    P2's texture and our distance from the seed area and position, which ``fusion:untrained`` uses,
    gain too little for their time here (``train.cues`` at 0ee65af).
    """

    def __init__(self, settings: FusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = load_image_network(settings.weights, DEFAULT_WEIGHTS)

    @use_inference_mode
    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """Compute the cues of an image (3, H, W) in [0, 1]; in an exported graph, of a batch."""
        maps = self.predict(image)
        ego = find_ego_car(maps["ego"])
        layout, road, fused = (maps[name] for name in ("layout", "road", "fused_road"))
        if any_pixel(ego):
            stack = torch.cat([layout, torch.stack([road, fused], -3)], -3)
            layout, roads = extrapolate_over_ego(stack, ego).split([NUM_CLASSES, 2], -3)
            road, fused = roads.unbind(-3)
        odds = log_odds(fused)
        return {
            "likelihood": calibrated_likelihood(odds, self.settings.calibration),
            "layout": layout,
            "layout_labels": decide_layout(layout.movedim(-3, -1)),
            "learned_road": road,
            "appearance": maps["appearance"],
            "seed_area": find_seed_area(odds, self.settings.seed_area.fraction),
            "ego": ego,
        }

    def predict(self, image: Tensor) -> Mapping[str, Tensor]:
        """Compute the cues of an image (3, H, W), where set the mean with those of its mirror."""
        fuse = partial(fuse_appearance, weight=self.settings.appearance.weight)
        maps = compute_cues(self.network, image, fuse)
        if not self.settings.mirrored:
            return maps
        mirrored = compute_cues(self.network, image.flip(-1), fuse)
        return {name: (maps[name] + mirrored[name].flip(-1)) / 2 for name in maps}

    def judge(self, mask: Tensor, cues: Mapping[str, Tensor]) -> Judgement:
        """Predict the trust in a mask, bool (H, W); ``likelihood`` is one of the cues."""
        features = trust_features(cues["likelihood"], mask, cues["ego"])
        return estimate_trust(features, mask.flatten(-2).any(-1), self.settings.trust)


def calibrated_likelihood(odds: Tensor, calibration: RoadCalibration) -> Tensor:
    """Convert log odds of any shape to calibrated likelihoods in [0, 1]."""
    return ((odds - calibration.centre) / calibration.temperature).sigmoid()


class PaperFusion(nn.Module):
    """Product of prior, layout of CNN-7 and uniformity, P2 eq. 4."""

    def __init__(self, settings: PaperFusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = load_configured_network(settings.weights, "cnn-7-paper", PatchNetwork)

    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """Compute the cues of an image (3, H, W) in [0, 1]."""
        layout = self.network.potentials(image)
        product = texture_product(image, self.settings, layout[HORIZONTAL], "uniformity")
        return {"layout": layout, **product}


class BayesFusion(nn.Module):
    """Product of prior, road of the network of ``fusion`` and CPF's texture likelihood, P2 eq. 4.

    Ours: what the equation gains with a good network. Road in place of horizontal, because the
    network tells them apart.
    """

    def __init__(self, settings: BayesFusionSettings) -> None:
        super().__init__()
        self.settings = settings
        self.network = load_image_network(settings.weights, DEFAULT_WEIGHTS)

    @use_inference_mode
    def forward(self, image: Tensor) -> dict[str, Tensor]:
        """Compute the cues of an image (3, H, W) in [0, 1]."""
        maps = compute_cues(self.network, image)
        product = texture_product(image, self.settings, maps["road"], "texture")
        return {"layout": maps["layout"], "learned_road": maps["road"], **product}


def texture_product(
    image: Tensor, settings: PaperFusionSettings, learned: Tensor, cue: str
) -> dict[str, Tensor]:
    """Compute P2 eq. 4: prior times a network's likelihood (H, W) times a cue of the texture.

    Returns the product as ``likelihood``, and the cues of the texture (P2 section 4).
    """
    labels = settings.superpixels.cut(image)
    seed = seed_rectangle(labels.shape, settings.seed_area).to(image.device)
    saturation = settings.saturation if settings.descriptor == "cpf:v2" else None
    cues = texture_cues(image, labels, seed, settings.texture, saturation)
    prior = PRIORS[settings.prior](*labels.shape).to(image)
    return {"likelihood": likelihood_product(prior, [learned, cues[cue]]), **cues}


ENTRIES = (
    Entry(
        "fusion",
        "network trained on rendered worlds and machine labels, refined at image edges",
        FusionSettings,
        Fusion,
    ),
    Entry(
        "fusion:large",
        "fusion averaged with that of the mirrored image: more accurate, slower",
        FusionSettings,
        Fusion,
        defaults={"mirrored": True},
    ),
    Entry(
        "fusion:scratch",
        "fusion with a network trained from random weights: no human label of any kind",
        FusionSettings,
        Fusion,
        defaults={"weights": {"file": "scratch-free"}},
    ),
    Entry(
        "fusion:untrained",
        "layout, texture and more fused, without a network",
        UntrainedFusionSettings,
        partial(Analysis, untrained_fusion),
    ),
    Entry(
        "fusion:bayes",
        "network of fusion times uniformity and rows: eq. 4 of Álvarez 2012 with a good network",
        BayesFusionSettings,
        BayesFusion,
    ),
    Entry(
        "fusion:paper",
        "layout of CNN-7 times uniformity, faithful reimplementation (Álvarez 2012)",
        PaperFusionSettings,
        PaperFusion,
    ),
)
