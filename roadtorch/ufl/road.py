"""Selection of road regions: position, reconstruction error, two loops (P1, eqs. 6 to 10)."""

from dataclasses import dataclass
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import resize_to_image
from roadtorch.road.bayes import TRIANGLE_APEX
from roadtorch.ufl.feature_maps import FeatureMaps
from roadtorch.ufl.hierarchy import (
    NodeChoice,
    RegionTree,
    node_area,
    node_stability,
    paint_nodes,
    select_nodes,
    selected_area,
)

Centring = Literal["road", "none", "basis"]

SHARPNESS = 2.0  # factor of a pixel's stability in the sigmoid of its likelihood
MASK_THRESHOLD = 0.5  # threshold at which a likelihood is exactly the mask
MIN_WIDTH = 0.03  # least width of the triangle ahead, in map widths; its apex would divide by 0


class StabilitySettings(Settings):
    """Settings of the regions' stability and of the loops that learn the road."""

    weight: float = Field(
        default=2.0, ge=0, le=1000, description="lambda, weight of the error in eq. 6"
    )
    rounds: int = Field(
        default=2, ge=1, le=100, description="iterations; in the first the error term is 0"
    )
    position: Literal["symmetric", "from_one", "ahead"] = Field(
        default="symmetric",
        description="position in eq. 6: from the middle row and column (program), rows and columns "
        "from 1 minus H/2 (text), or a triangle ahead",
    )
    apex: float = Field(
        default=TRIANGLE_APEX,
        ge=0,
        lt=1,
        description="apex of the triangle ahead, fraction of the height from the top",
    )
    base: float = Field(
        default=1.6, gt=0, le=10, description="base of that triangle on the bottom edge, in widths"
    )
    centring: Centring = Field(
        default="road",
        description="eq. 10: the road's mean is subtracted everywhere (program), nowhere (text), "
        "or for the basis alone",
    )
    variance: float = Field(
        default=0.95,
        gt=0,
        le=1,
        description="fraction of the road's variance in its principal components",
    )
    error_range: Literal["covered", "everywhere"] = Field(
        default="covered",
        description="errors are scaled to [0, 1] over the pixels with a mean map above 0 "
        "(program), or over all",
    )
    model: Literal["selected", "best"] = Field(
        default="selected",
        description="region of the tree that the road is learned from: the selected one of the "
        "greatest stability (program), or that with the greatest sum of it inside (listing)",
    )
    whole: Literal["if_undivided", "never"] = Field(
        default="if_undivided", description="whole map as road: if undivided (program), or never"
    )
    dilation: int = Field(
        default=3, ge=0, le=50, description="radius of the final dilation, pixels"
    )


def position_weights(rows: int, columns: int, variant: Literal["symmetric", "from_one"]) -> Tensor:
    """Return the first two terms of eq. 6, float64 (rows, columns): road is low and central.

    From -2 or less in the upper corners to nearly 2 at the middle of the bottom edge.
    """
    row = torch.arange(1, rows + 1, dtype=torch.float64)
    column = torch.arange(1, columns + 1, dtype=torch.float64)
    shift = 1 if variant == "symmetric" else 0
    half, middle = (rows + shift) / 2, (columns + shift) / 2
    return ((row - half) / half)[:, None] + 1 - (column - middle).abs() / half


def triangle_position_weights(rows: int, columns: int, apex: float, base: float) -> Tensor:
    """Return position weights of a triangle ahead, float64 (rows, columns) in [-1, 1]. Ours.

    1 on the triangle's axis, 0 on its sides, -1 beyond twice its width and above its apex. By eq. 6
    roads are as wide far away as nearby, which includes pavements.
    """
    row = (torch.arange(rows, dtype=torch.float64)[:, None] + 0.5) / rows
    column = (torch.arange(columns, dtype=torch.float64) + 0.5) / columns
    width = (base * (row - apex) / (1 - apex)).clamp_min(MIN_WIDTH)
    inside = (1 - 2 * (column - 0.5).abs() / width).clamp(-1, 1)
    return inside.where(row > apex, -1)


def road_basis(samples: Tensor, centring: Centring, fraction: float) -> tuple[Tensor, Tensor]:
    """Return the mean (m,) and the basis (m, k) of eq. 10: PCA of road features (N, m).

    The fewest eigenvectors with that ``fraction`` of the variance; none if it is 0.
    """
    mean = samples.mean(0)
    offset = mean if centring == "road" else torch.zeros_like(mean)
    centred = (samples if centring == "none" else samples - mean).double()
    values, vectors = torch.linalg.eigh(centred.T @ centred / max(1, len(samples) - 1))
    variance = values.clamp_min(0).flip(0).cumsum(0)
    if variance[-1] <= 0:
        return offset, samples.new_zeros(samples.shape[1], 0)
    count = int((variance < fraction * variance[-1]).sum()) + 1
    return offset, vectors.flip(1)[:, :count].to(samples)


def reconstruction_error(maps: Tensor, road: Tensor, centring: Centring, fraction: float) -> Tensor:
    """Return the error (H, W) ≥ 0 of reconstructing maps by the road's basis (eq. 10).

    The maps are the selected ones (m, H, W); ``road`` is bool (H, W), not empty.
    """
    mean, basis = road_basis(maps[:, road].T, centring, fraction)
    features = maps.flatten(1) - mean[:, None]
    residual = features - basis @ (basis.T @ features)
    return residual.square().sum(0).sqrt().view(road.shape)


def normalise_error(error: Tensor, covered: Tensor) -> Tensor:
    """Scale errors (H, W) to [0, 1] over the covered pixels; 0 elsewhere, and if all are equal."""
    if not covered.any():
        return torch.zeros_like(error)
    low, high = error[covered].aminmax()
    scaled = (error - low) / torch.where(high > low, high - low, 1)
    return scaled.where(covered, 0)


@dataclass(frozen=True, eq=False)
class Round:
    """One iteration of the two loops.

    Attributes:
        choice: the selected nodes.
        pixels: stability of each pixel (eq. 6), float64 (H, W).
        error: reconstruction error in [0, 1], shape (H, W).
        road: selected regions before dilation, bool (H, W).
        model: index of the node from which the next round learns; None without road.
    """

    choice: NodeChoice
    pixels: Tensor
    error: Tensor
    road: Tensor
    model: int | None


def find_road(
    maps: Tensor, mean_map: Tensor, tree: RegionTree, settings: StabilitySettings
) -> list[Round]:
    """Run the two loops: select nodes, learn the road from them, select again.

    maps: the selected feature maps, shape (m, H, W). mean_map: their mean in [0, 1], shape (H, W).
    tree: of the regions of the mean map. The last round is without road where it finds none.
    """
    rows, columns = mean_map.shape
    if settings.position == "ahead":
        position = triangle_position_weights(rows, columns, settings.apex, settings.base)
    else:
        position = position_weights(rows, columns, settings.position)
    covered = mean_map != 0 if settings.error_range == "covered" else torch.ones_like(mean_map) > 0
    error = torch.zeros_like(mean_map)
    rounds: list[Round] = []
    while True:
        pixels = position - settings.weight * error.cpu().double()
        choice = select_nodes(tree, node_stability(tree, pixels), settings.whole)
        road, model = selected_area(tree, choice.selected), model_node(choice, settings.model)
        rounds.append(Round(choice, pixels, error, road, model))
        if model is None or len(rounds) == settings.rounds:
            return rounds
        learned = node_area(tree, model).to(maps.device)
        error = reconstruction_error(maps, learned, settings.centring, settings.variance)
        error = normalise_error(error, covered)


def model_node(choice: NodeChoice, variant: Literal["selected", "best"]) -> int | None:
    """Return the node (index) from which the road is learned; None where none is selected."""
    if not choice.selected.any():
        return None
    if variant == "selected" or len(choice.selected) == 1:
        return int(choice.stability.where(choice.selected, -torch.inf).argmax())
    return int(choice.best[1:].argmax()) + 1


def dilate(mask: Tensor, radius: int) -> Tensor:
    """Dilate a mask, bool (H, W), by a square of ``radius`` pixels on each side."""
    return F.max_pool2d(mask[None].float(), 2 * radius + 1, 1, radius)[0] > 0


def mask_to_image(mask: Tensor, side: int) -> Tensor:
    """Convert a mask of patches, bool (H, W), to image size, (H+side-1, W+side-1).

    A patch stands for its middle pixel, or its four middle pixels where the side is even; the
    border is repeated.
    """
    return F.max_pool2d(_pad_border(mask.float(), side), 2 - side % 2, 1)[0] > 0


def map_to_image(values: Tensor, side: int) -> Tensor:
    """Convert values (H, W) of patches to image size, with means where masks have unions."""
    return F.avg_pool2d(_pad_border(values, side), 2 - side % 2, 1)[0]


def _pad_border(values: Tensor, side: int) -> Tensor:
    radius = side // 2
    return F.pad(values[None], (radius, radius, radius, radius), mode="replicate")


def road_likelihood(mask: Tensor, pixels: Tensor) -> Tensor:
    """Combine a mask and the stability of pixels in [0, 1) into a likelihood (H, W) in [0, 1].

    The mask dominates: at ``MASK_THRESHOLD`` the likelihood gives exactly the mask. Ours: of twelve
    candidates the best by MaxF on the development drives (docs/how/features.md).
    """
    return (mask.to(pixels.device) + pixels) / 2


def resize_likelihood(likelihood: Tensor, size: tuple[int, int]) -> Tensor:
    """Resize a likelihood of ``road_likelihood`` (h, w) so that its mask stays exact.

    The mask is resized as every mask is, the stability inside and outside of it smoothly. Resizing
    their sum would move the border inwards: it is 0.5 or more inside, and far less outside.
    """
    mask = likelihood >= MASK_THRESHOLD
    return road_likelihood(
        resize_to_image(mask, size), resize_to_image(2 * likelihood - mask.to(likelihood), size)
    )


def figure_maps(
    maps: FeatureMaps, mean_map: Tensor, tree: RegionTree, last: Round, side: int
) -> dict[str, Tensor]:
    """Return the maps of P1's Fig. 4 by name, at image size; ``side`` is the patch's."""
    levels = (tree.node_of >= 0)[tree.regions.labels.long()].sum(0)
    nodes = paint_nodes(tree, last.choice.stability.clamp_min(0) * last.choice.selected)
    cues = {
        "best_map": maps.maps[0],
        "mean_map": mean_map,
        "tree_levels": levels,
        "error": last.error,
        "pixel_stability": last.pixels,
        "node_stability": nodes,
    }
    return {name: map_to_image(cue.float(), side) for name, cue in cues.items()}
