"""Baselines: the two detectors that P1 compares itself with, and priors that ignore the image."""

from functools import partial

import torch
from torch import Tensor

from roadtorch.detectors.entry import Analysis, DetectorSettings, Entry, Isolated, WorkingSettings
from roadtorch.imaging.color import color_plane
from roadtorch.imaging.resize import WorkingSize, resize_to_image
from roadtorch.road.bayes import PRIORS, Prior
from roadtorch.road.seed_area import seed_rectangle
from roadtorch.ufl.feature_maps import MapSettings, learn_features
from roadtorch.ufl.features import DictionarySettings, assign_patches
from roadtorch.ufl.preprocess import Smoothing, WorkingShape, resize_bicubic
from roadtorch.ufl.region_cut import (
    CutSettings,
    PeakSettings,
    cluster_pixels,
    connected_regions,
    cut_road,
)
from roadtorch.ufl.road import map_to_image, mask_to_image
from roadtorch.ufl.vanishing import (
    BorderSettings,
    GaborBank,
    VotingSettings,
    dominant_orientation,
    find_borders,
    gabor_responses,
    road_between,
    vote_vanishing_point,
)

KONG_PIXELS = 240 * 180
"""Size of the images of Kong et al., 240x180."""


class VanishingPointSettings(WorkingSettings):
    """Settings of Kong et al.'s road between two borders that meet in the vanishing point."""

    isolated: Isolated = "keep"
    working: WorkingSize = WorkingSize(pixels=KONG_PIXELS)
    gabor: GaborBank = GaborBank()
    voting: VotingSettings = VotingSettings()
    borders: BorderSettings = BorderSettings()


def vanishing_point_road(image: Tensor, settings: VanishingPointSettings) -> dict[str, Tensor]:
    """Detect the road between two borders from a vanishing point voted by texture (Kong 2010).

    ``likelihood`` is 1 between the borders and 0 elsewhere; 0 everywhere if there are no votes.
    """
    responses = gabor_responses(color_plane(image, "grey"), settings.gabor)
    orientation, confidence = dominant_orientation(responses)
    point = vote_vanishing_point(orientation, confidence, settings.voting)
    likelihood = torch.zeros_like(confidence)
    if point is not None:
        borders = find_borders(image, orientation, point, settings.borders)
        likelihood = road_between(borders, (image.shape[1], image.shape[2])).to(image)
    return {"likelihood": likelihood, "orientation": orientation / 180, "confidence": confidence}


class KmeansRoadSettings(DetectorSettings):
    """Settings of Xia et al.'s features, clusters and graph cut."""

    working: WorkingShape = WorkingShape()
    smoothing: Smoothing = Smoothing()
    dictionary: DictionarySettings = DictionarySettings()
    peaks: PeakSettings = PeakSettings()
    cut: CutSettings = CutSettings()


ALL_MAPS = MapSettings(encoder="patch", fraction=1.0)
"""Eq. 3 of P1 on every map: Xia et al., without P1's eqs. 4 and 5."""


def kmeans_road(image: Tensor, settings: KmeansRoadSettings) -> dict[str, Tensor]:
    """Detect the road, likelihood 1 or 0, by K-means features and a graph cut (Xia et al. 2015)."""
    height, width = image.shape[-2:]
    small = resize_bicubic(image, settings.working.size(height, width))
    learned = learn_features(small, settings.smoothing, settings.dictionary, ALL_MAPS)
    bases, size, side = learned.dictionary, learned.size, settings.dictionary.side
    clusters = cluster_pixels(learned.maps.maps, settings.peaks)
    regions = connected_regions(clusters)
    words = assign_patches(learned.patches, bases).view(size).cpu()
    seed = seed_rectangle(size, settings.seed_area)
    road = mask_to_image(cut_road(regions, words, len(bases), seed, settings.cut), side)
    levels = clusters / max(1, settings.peaks.clusters - 1)
    likelihood = resize_to_image(road, (height, width)).to(image)
    return {"likelihood": likelihood, "clusters": map_to_image(levels.to(image), side)}


def location_prior(image: Tensor, settings: DetectorSettings, prior: Prior) -> dict[str, Tensor]:
    """Return a location prior as likelihood, whatever the image (3, H, W) shows."""
    return {"likelihood": prior(*image.shape[-2:]).to(image)}


PRIOR_SUMMARIES = (
    "blind baseline: 0.5 everywhere",
    "blind baseline: the lower the row, the likelier road",
    "blind baseline: a triangle ahead of the car",
)

ENTRIES = (
    Entry(
        "kmeans-road",
        "clustered K-means features, separated by a graph cut (Xia et al.)",
        KmeansRoadSettings,
        partial(Analysis, kmeans_road),
    ),
    Entry(
        "vanishing-point",
        "area between borders from a voted vanishing point (Kong et al.)",
        VanishingPointSettings,
        partial(Analysis, vanishing_point_road),
    ),
    *(
        Entry(f"prior:{name}", summary, DetectorSettings, build, baseline=True)
        for (name, prior), summary in zip(PRIORS.items(), PRIOR_SUMMARIES, strict=True)
        for build in [partial(Analysis, partial(location_prior, prior=prior))]
    ),
)
