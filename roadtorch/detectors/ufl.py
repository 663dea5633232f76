"""Detectors that learn their features in the picture itself (P1)."""

from collections.abc import Mapping
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from roadtorch.detector import ISOLATED, Analysis, Entry
from roadtorch.seed_area import SeedArea, remove_isolated, seed_area
from roadtorch.settings import Settings
from roadtorch.ufl.features import DictionarySettings
from roadtorch.ufl.hierarchy import (
    LEAST,
    NODES,
    Nodes,
    Tree,
    TreeSettings,
    build_tree,
    paint_nodes,
    threshold_regions,
    thresholds,
)
from roadtorch.ufl.learned import Learned, learn_features
from roadtorch.ufl.maps import FeatureMaps, MapSettings, mean_map
from roadtorch.ufl.pictures import dictionary_picture, mosaic
from roadtorch.ufl.preprocess import TARGET, Smoothing, WorkingShape, bicubic
from roadtorch.ufl.road import (
    DILATION,
    PLACE,
    WEIGHT,
    Place,
    RoadSettings,
    Round,
    find_road,
    map_to_image,
    mask_to_image,
    widened,
)
from roadtorch.working_size import FullSize

THRESHOLD = "road from this likelihood on; at 0.5 the mask is exactly the regions chosen"

SEED = "the area that road must touch, where isolated road is dropped"

SHARPNESS = 2.0
"""How fast the likelihood rises with the stability of a pixel, around 0."""


class OriginalSettings(Settings):
    """P1 as its authors' program has it."""

    threshold: float = Field(default=0.5, ge=0, le=1, description=THRESHOLD)
    isolated: Literal["drop", "keep"] = Field(default="keep", description=ISOLATED)
    seed: SeedArea = Field(default=SeedArea(), description=SEED)
    working: WorkingShape = WorkingShape()
    smoothing: Smoothing = Smoothing()
    dictionary: DictionarySettings = DictionarySettings()
    maps: MapSettings = MapSettings()
    tree: TreeSettings = TreeSettings()
    road: RoadSettings = RoadSettings()


class BestSmoothing(Smoothing):
    """Equalisation of the detector ``ufl``."""

    target: float = Field(default=0.25, gt=0, le=10, description=TARGET)


class BestTree(TreeSettings):
    """The tree of the detector ``ufl``."""

    least: int = Field(default=25, ge=1, le=10**6, description=LEAST)
    nodes: Nodes = Field(default="regions", description=NODES)


class BestRoad(RoadSettings):
    """Stability in the detector ``ufl``."""

    weight: float = Field(default=1.5, ge=0, le=1000, description=WEIGHT)
    place: Place = Field(default="ahead", description=PLACE)
    dilation: int = Field(default=2, ge=0, le=50, description=DILATION)


class UflSettings(OriginalSettings):
    """The best readings and settings we know for P1."""

    isolated: Literal["drop", "keep"] = Field(default="drop", description=ISOLATED)
    smoothing: BestSmoothing = BestSmoothing()
    tree: BestTree = BestTree()
    road: BestRoad = BestRoad()


def _ufl(settings: OriginalSettings) -> Analysis:
    def analyse(image: Tensor) -> Mapping[str, Tensor]:
        height, width = image.shape[-2:]
        small = bicubic(image, settings.working.size(height, width))
        learned = learn_features(small, settings.smoothing, settings.dictionary, settings.maps)
        return FullSize(road_cues(learned, settings), (height, width))

    return analyse


def road_cues(learned: Learned, settings: OriginalSettings) -> dict[str, Tensor]:
    """The likelihood (H,W) and the cues, from what was learned (P1, section II.C)."""
    side = settings.dictionary.side
    found = learned.maps
    mean = mean_map(found.maps, settings.maps.scale)
    regions = threshold_regions(mean, thresholds(settings.tree.levels, settings.tree.top))
    tree = build_tree(regions, settings.tree.least, settings.tree.nodes)
    rounds = find_road(found.maps, mean, tree, settings.road)
    masks = [_image_mask(step.road, settings) for step in rounds]
    pixels = map_to_image(_stable_pixels(rounds[-1], mean), side)
    return {
        "likelihood": _likelihood(masks[-1], pixels),
        "equalised": learned.even,
        "dictionary": dictionary_picture(learned.dictionary, found.order, side, tuple(mean.shape)),
        "selected_maps": mosaic(found.maps[:, None], tuple(mean.shape))[0],
        **_map_cues(found, mean, tree, rounds[-1], side),
        **{f"iteration_{number}": mask for number, mask in enumerate(masks, 1)},
    }


def _image_mask(road: Tensor, settings: OriginalSettings) -> Tensor:
    """The road of one iteration, bool, at the size of the image."""
    wide = widened(road, settings.road.dilation)
    mask = mask_to_image(wide, settings.dictionary.side)
    if settings.isolated == "keep":
        return mask
    return remove_isolated(mask, *seed_area(mask.shape[0], mask.shape[1], settings.seed))


def _stable_pixels(last: Round, mean: Tensor) -> Tensor:
    """(H,W) in [0,1) from the stability of pixels; 0 where no selected base responds."""
    stable = torch.sigmoid(SHARPNESS * last.pixels).to(mean)
    return stable.where(mean > 0, 0)


def _likelihood(mask: Tensor, pixels: Tensor) -> Tensor:
    """(H,W) in [0,1]: the mask first, the stability of pixels in [0,1) inside and outside of it.

    At 0.5 it separates road from the rest exactly as the mask does. Ours: of twelve candidates
    the one with the best MaxF on the development drives (``train/study_ufl.py likelihoods``).
    """
    return (mask + pixels) / 2


def _map_cues(
    found: FeatureMaps, mean: Tensor, tree: Tree, last: Round, side: int
) -> dict[str, Tensor]:
    """What Fig. 4 of P1 shows, at the size of the image."""
    levels = (tree.node_of >= 0)[tree.regions.labels.long()].sum(0)
    nodes = paint_nodes(tree, last.choice.stability.clamp_min(0) * last.choice.selected)
    cues = {
        "best_map": found.maps[0],
        "mean_map": mean,
        "tree_levels": levels,
        "error": last.error,
        "pixel_stability": last.pixels,
        "node_stability": nodes,
    }
    return {name: map_to_image(cue.float(), side) for name, cue in cues.items()}


ENTRIES = (
    Entry("ufl", "features learned from the picture, regions chosen (P1)", UflSettings, _ufl),
    Entry("ufl:original", "the same as the authors' program has it", OriginalSettings, _ufl),
)
