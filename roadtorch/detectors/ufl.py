"""Detectors that learn their features in the picture itself (P1)."""

from collections.abc import Mapping

from pydantic import Field
from torch import Tensor, nn

from roadtorch.detector import DetectorSettings, Entry, Isolated, Threshold
from roadtorch.imaging.resize import full_size
from roadtorch.road.seed_area import remove_isolated, seed_rectangle
from roadtorch.ufl.features import DictionarySettings
from roadtorch.ufl.hierarchy import (
    LEAST,
    NODES,
    Nodes,
    RegionTreeSettings,
    build_tree,
    threshold_regions,
    thresholds,
)
from roadtorch.ufl.maps import (
    LearnedFeatures,
    MapSettings,
    dictionary_picture,
    learn_features,
    mean_map,
    mosaic,
)
from roadtorch.ufl.preprocess import SIGMA, TARGET, Smoothing, WorkingShape, bicubic
from roadtorch.ufl.road import (
    DILATION,
    PLACE,
    WEIGHT,
    Place,
    StabilitySettings,
    enlarged_likelihood,
    find_road,
    map_pictures,
    map_to_image,
    mask_to_image,
    road_likelihood,
    stable_pixels,
    widened,
)

THRESHOLD = "road from this likelihood on; at 0.5 the mask is exactly the regions chosen"


class OriginalUflSettings(DetectorSettings):
    """P1 as its authors' program has it."""

    threshold: Threshold = Field(default=0.5, description=THRESHOLD)
    working: WorkingShape = WorkingShape()
    smoothing: Smoothing = Smoothing()
    dictionary: DictionarySettings = DictionarySettings()
    maps: MapSettings = MapSettings()
    tree: RegionTreeSettings = RegionTreeSettings()
    road: StabilitySettings = StabilitySettings()


class KittiSmoothing(Smoothing):
    """The blur of the paper's Table II."""

    sigma: float = Field(default=2.5, gt=0, le=50, description=SIGMA)


class KittiUflSettings(OriginalUflSettings):
    """P1 as its text has it for the KITTI road benchmark: a wider blur, the rest unchanged."""

    smoothing: KittiSmoothing = KittiSmoothing()


class BestSmoothing(Smoothing):
    """Equalisation of the detector ``ufl``."""

    target: float = Field(default=0.25, gt=0, le=10, description=TARGET)


class BestTree(RegionTreeSettings):
    """The tree of the detector ``ufl``."""

    least: int = Field(default=25, ge=1, le=10**6, description=LEAST)
    nodes: Nodes = Field(default="regions", description=NODES)


class BestStability(StabilitySettings):
    """Stability in the detector ``ufl``."""

    weight: float = Field(default=1.5, ge=0, le=1000, description=WEIGHT)
    place: Place = Field(default="ahead", description=PLACE)
    dilation: int = Field(default=2, ge=0, le=50, description=DILATION)


class UflSettings(OriginalUflSettings):
    """The best readings and settings we know for P1."""

    isolated: Isolated = "drop"
    smoothing: BestSmoothing = BestSmoothing()
    tree: BestTree = BestTree()
    road: BestStability = BestStability()


class Ufl(nn.Module):
    """Features learned in one picture, regions chosen from a tree of thresholds (P1)."""

    def __init__(self, settings: OriginalUflSettings) -> None:
        super().__init__()
        self.settings = settings

    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1], found at P1's size, brought back to its own."""
        height, width = image.shape[-2:]
        settings = self.settings
        small = bicubic(image, settings.working.size(height, width))
        learned = learn_features(small, settings.smoothing, settings.dictionary, settings.maps)
        cues = road_cues(learned, settings)
        likelihood = enlarged_likelihood(cues["likelihood"], (height, width))
        return full_size(cues, (height, width)).but(likelihood=likelihood)


def road_cues(learned: LearnedFeatures, settings: OriginalUflSettings) -> dict[str, Tensor]:
    """The likelihood (H,W) and the cues, from what was learned (P1, section II.C)."""
    side = settings.dictionary.side
    found = learned.maps
    mean = mean_map(found.maps, settings.maps.scale)
    regions = threshold_regions(mean, thresholds(settings.tree.levels, settings.tree.top))
    tree = build_tree(regions, settings.tree.least, settings.tree.nodes)
    rounds = find_road(found.maps, mean, tree, settings.road)
    masks = [_image_mask(step.road, settings) for step in rounds]
    pixels = map_to_image(stable_pixels(rounds[-1], mean), side)
    return {
        "likelihood": road_likelihood(masks[-1], pixels),
        "equalised": learned.even,
        "dictionary": dictionary_picture(learned.dictionary, found.order, side, tuple(mean.shape)),
        "selected_maps": mosaic(found.maps[:, None], tuple(mean.shape))[0],
        **map_pictures(found, mean, tree, rounds[-1], side),
        **{f"iteration_{number}": mask for number, mask in enumerate(masks, 1)},
    }


def _image_mask(road: Tensor, settings: OriginalUflSettings) -> Tensor:
    """The road of one iteration, bool, at the size of the image."""
    wide = widened(road, settings.road.dilation)
    mask = mask_to_image(wide, settings.dictionary.side)
    if settings.isolated == "keep":
        return mask
    return remove_isolated(mask, seed_rectangle(mask.shape, settings.seed_area))


TEXT = {
    "smoothing": {"target": 1.0},
    "maps": {"row_weights": "from_one", "scale": "none"},
    "tree": {"top": "left_out"},
    "road": {
        "place": "from_one",
        "centring": "basis",
        "error_range": "everywhere",
        "model": "best",
        "whole": "never",
    },
}
"""Where the text of P1 differs from its authors' program, all of it together."""

ENTRIES = (
    Entry(
        "ufl", "features learned from the picture, regions chosen (Zhang 2016)", UflSettings, Ufl
    ),
    Entry("ufl:kitti", "ufl:original with the blur of the paper's Table II", KittiUflSettings, Ufl),
    Entry("ufl:original", "the same as the authors' program has it", OriginalUflSettings, Ufl),
    Entry(
        "ufl:paper", "the same as the paper's text has it", OriginalUflSettings, Ufl, values=TEXT
    ),
)
