"""Detectors with features learned from the image itself (P1)."""

from collections.abc import Mapping
from functools import partial

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.detectors.entry import Analysis, DetectorSettings, Entry, Threshold
from roadtorch.road.seed_area import remove_isolated, seed_rectangle
from roadtorch.ufl.feature_maps import (
    MapSettings,
    dictionary_image,
    learn_features,
    mean_map,
    mosaic,
)
from roadtorch.ufl.features import DictionarySettings
from roadtorch.ufl.hierarchy import (
    RegionTreeSettings,
    build_tree,
    region_thresholds,
    threshold_regions,
)
from roadtorch.ufl.preprocess import Smoothing, WorkingShape, resize_bicubic
from roadtorch.ufl.road import (
    SHARPNESS,
    StabilitySettings,
    dilate,
    figure_maps,
    find_road,
    map_to_image,
    mask_to_image,
    resize_likelihood,
    road_likelihood,
)

THRESHOLD_DESCRIPTION = "likelihood from which a pixel is road; at 0.5, exactly the regions chosen"


class UflSettings(DetectorSettings):
    """Settings of P1, with the defaults of its authors' program."""

    threshold: Threshold = Field(default=0.5, description=THRESHOLD_DESCRIPTION)
    working: WorkingShape = WorkingShape()
    smoothing: Smoothing = Smoothing()
    dictionary: DictionarySettings = DictionarySettings()
    maps: MapSettings = MapSettings()
    tree: RegionTreeSettings = RegionTreeSettings()
    road: StabilitySettings = StabilitySettings()


def ufl(image: Tensor, settings: UflSettings) -> Mapping[str, Tensor]:
    """Detect the road by features learned in the image and regions of a threshold tree (P1).

    Computed at P1's size, then resized to the image's.
    """
    height, width = image.shape[-2:]
    small = resize_bicubic(image, settings.working.size(height, width))
    learned = learn_features(small, settings.smoothing, settings.dictionary, settings.maps)
    features, side = learned.maps, settings.dictionary.side
    # P1, section II.C.
    mean = mean_map(features.maps, settings.maps.scale)
    regions = threshold_regions(mean, region_thresholds(settings.tree.levels, settings.tree.top))
    tree = build_tree(regions, settings.tree.min_area, settings.tree.nodes)
    rounds = find_road(features.maps, mean, tree, settings.road)
    masks = [mask_to_image(dilate(step.road, settings.road.dilation), side) for step in rounds]
    if settings.isolated == "drop":
        seed = seed_rectangle(masks[0].shape, settings.seed_area)
        masks = [remove_isolated(mask, seed) for mask in masks]
    stable = torch.sigmoid(SHARPNESS * rounds[-1].pixels).to(mean)
    pixels = map_to_image(stable.where(mean > 0, 0), side)  # 0 where no selected base responds
    likelihood = road_likelihood(masks[-1], pixels)
    return {
        "likelihood": resize_likelihood(likelihood, (height, width)),
        "equalised": learned.equalised,
        "dictionary": dictionary_image(learned.dictionary, features.order, side, learned.size),
        "selected_maps": mosaic(features.maps[:, None], learned.size)[0],
        **figure_maps(features, mean, tree, rounds[-1], side),
        **{f"iteration_{number}": mask for number, mask in enumerate(masks, 1)},
    }


PAPER_DEFAULTS = {
    "smoothing": {"target": 1.0},
    "maps": {"row_weights": "from_one", "scale": "none"},
    "tree": {"top": "left_out"},
    "road": {
        "position": "from_one",
        "centring": "basis",
        "error_range": "everywhere",
        "model": "best",
        "whole": "never",
    },
}
"""All settings in which the text of P1 differs from its authors' program."""

UFL = partial(Analysis, ufl)

ENTRIES = (
    Entry(
        "ufl",
        "features learned from the image, regions of a threshold tree (Zhang 2016)",
        UflSettings,
        UFL,
        # Chosen among the readings of the paper: docs/how/features.md.
        defaults={
            "isolated": "drop",
            "smoothing": {"target": 0.25},
            "tree": {"min_area": 25, "nodes": "regions"},
            "road": {"weight": 1.5, "position": "ahead", "dilation": 2},
        },
    ),
    Entry(
        "ufl:paper", "ufl as in the text of the paper", UflSettings, UFL, defaults=PAPER_DEFAULTS
    ),
    Entry("ufl:original", "ufl as in the authors' program", UflSettings, UFL),
)
