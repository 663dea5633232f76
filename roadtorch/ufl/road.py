"""Which regions are road: place, reconstruction error, and the two loops (P1, eqs. 6 to 10)."""

from dataclasses import dataclass
from typing import Literal

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings
from roadtorch.imaging.resize import at_image_size
from roadtorch.road.fusion import TRIANGLE_APEX
from roadtorch.ufl.hierarchy import (
    NodeChoice,
    Tree,
    node_area,
    node_stability,
    paint_nodes,
    select_nodes,
    selected_area,
)
from roadtorch.ufl.maps import FeatureMaps

Centring = Literal["road", "none", "basis"]

SHARPNESS = 2.0
"""How fast the likelihood rises with the stability of a pixel, around 0."""

AS_CHOSEN = 0.5
"""The threshold at which a likelihood is exactly the mask."""

MIN_WIDTH = 0.03
"""Least width of the triangle ahead, in widths of the map: none at its apex would divide by 0."""


class StabilitySettings(Settings):
    """Stability of regions, and how often the road is learned anew."""

    weight: float = Field(
        default=2.0, ge=0, le=1000, description="lambda, the error's weight against place (eq. 6)"
    )
    rounds: int = Field(default=2, ge=1, le=100, description="iterations; the first has no error")
    place: Literal["symmetric", "from_one", "ahead"] = Field(
        default="symmetric",
        description="eq. 6: rows and columns about the middle (program), or less H/2 from 1 "
        "(text), or how far inside a triangle ahead",
    )
    apex: float = Field(
        default=TRIANGLE_APEX,
        ge=0,
        lt=1,
        description="top of the triangle ahead, in heights from the top",
    )
    base: float = Field(
        default=1.6, gt=0, le=10, description="its base on the bottom edge, in widths"
    )
    centring: Centring = Field(
        default="road",
        description="eq. 10: the road's mean taken off everywhere (program), nowhere (text), "
        "or for the basis alone",
    )
    kept: float = Field(
        default=0.95, gt=0, le=1, description="share of the road's variance that is kept"
    )
    error_range: Literal["covered", "everywhere"] = Field(
        default="covered",
        description="errors are scaled to [0,1] over the pixels whose mean map is not 0 (program), "
        "or over all",
    )
    model: Literal["selected", "best"] = Field(
        default="selected",
        description="the road is learned from the selected node with the greatest S (program), "
        "or the node with the greatest best sum (listing)",
    )
    whole: Literal["if_undivided", "never"] = Field(
        default="if_undivided", description="when the whole map may be road (program, text)"
    )
    dilation: int = Field(
        default=3, ge=0, le=50, description="pixels by which the road is widened at the end"
    )


def place_weights(rows: int, columns: int, kind: Literal["symmetric", "from_one"]) -> Tensor:
    """The first two terms of eq. 6, float64 (rows,columns): low and in the middle is road.

    From -2 or less in the upper corners up to nearly 2 at the middle of the bottom edge.
    """
    row = torch.arange(1, rows + 1, dtype=torch.float64)
    column = torch.arange(1, columns + 1, dtype=torch.float64)
    shift = 1 if kind == "symmetric" else 0
    half, middle = (rows + shift) / 2, (columns + shift) / 2
    return ((row - half) / half)[:, None] + 1 - (column - middle).abs() / half


def place_ahead(rows: int, columns: int, apex: float, base: float) -> Tensor:
    """Ours, in place of ``place_weights``: float64 (rows,columns) in [-1,1].

    1 on the middle line of a triangle ahead of the car, 0 on its sides, -1 beyond twice its
    width and above its apex. Roads narrow with distance; eq. 6 lets them be as wide far away
    as near, and so takes in pavements.
    """
    row = (torch.arange(rows, dtype=torch.float64)[:, None] + 0.5) / rows
    column = (torch.arange(columns, dtype=torch.float64) + 0.5) / columns
    width = (base * (row - apex) / (1 - apex)).clamp_min(MIN_WIDTH)
    inside = (1 - 2 * (column - 0.5).abs() / width).clamp(-1, 1)
    return inside.where(row > apex, -1)


def road_basis(samples: Tensor, centring: Centring, kept: float) -> tuple[Tensor, Tensor]:
    """PCA of road features (N,m): the mean to take off (m,) and the basis (m,k) of eq. 10.

    The fewest eigenvectors that keep the share ``kept`` of the variance; none where there
    is no variance.
    """
    mean = samples.mean(0)
    offset = mean if centring == "road" else torch.zeros_like(mean)
    centred = (samples if centring == "none" else samples - mean).double()
    scatter = centred.T @ centred / max(1, len(samples) - 1)
    values, vectors = torch.linalg.eigh(scatter)
    share = values.clamp_min(0).flip(0).cumsum(0)
    if share[-1] <= 0:
        return offset, samples.new_zeros(samples.shape[1], 0)
    enough = int((share < kept * share[-1]).sum()) + 1
    return offset, vectors.flip(1)[:, :enough].to(samples)


def reconstruction_error(maps: Tensor, road: Tensor, centring: Centring, kept: float) -> Tensor:
    """Eq. 10: how badly road explains each pixel, (H,W) ≥ 0.

    maps: (m,H,W), the selected maps; road: bool (H,W), not empty.
    """
    mean, basis = road_basis(maps[:, road].T, centring, kept)
    features = maps.flatten(1) - mean[:, None]
    rest = features - basis @ (basis.T @ features)
    return rest.square().sum(0).sqrt().view(road.shape)


def normalised_error(error: Tensor, covered: Tensor) -> Tensor:
    """Errors (H,W) scaled to [0,1] over the covered pixels, bool (H,W); 0 elsewhere.

    0 everywhere, where all errors are equal.
    """
    if not covered.any():
        return torch.zeros_like(error)
    low, high = error[covered].aminmax()
    scaled = (error - low) / torch.where(high > low, high - low, 1)
    return scaled.where(covered, 0)


@dataclass(frozen=True)
class Round:
    """One iteration of the two loops.

    choice: the nodes. pixels: float64 (H,W), the stability of eq. 6. error: (H,W) in [0,1].
    road: bool (H,W), the selected regions, not widened.
    model: index of the node from which the next iteration learns, None if there is no road.
    """

    choice: NodeChoice
    pixels: Tensor
    error: Tensor
    road: Tensor
    model: int | None


def find_road(
    maps: Tensor, mean_map: Tensor, tree: Tree, settings: StabilitySettings
) -> list[Round]:
    """The two loops: select nodes, learn the road from them, select again.

    maps: (m,H,W); mean_map: (H,W). Ends early when a round finds no road, which is the
    result then.
    """
    rows, columns = mean_map.shape
    if settings.place == "ahead":
        place = place_ahead(rows, columns, settings.apex, settings.base)
    else:
        place = place_weights(rows, columns, settings.place)
    covered = mean_map != 0 if settings.error_range == "covered" else torch.ones_like(mean_map) > 0
    error = torch.zeros_like(mean_map)
    rounds: list[Round] = []
    while True:
        pixels = place - settings.weight * error.cpu().double()
        choice = select_nodes(tree, node_stability(tree, pixels), settings.whole)
        road, model = selected_area(tree, choice.selected), model_node(choice, settings.model)
        rounds.append(Round(choice, pixels, error, road, model))
        if model is None or len(rounds) == settings.rounds:
            return rounds
        learned = node_area(tree, model).to(maps.device)
        error = reconstruction_error(maps, learned, settings.centring, settings.kept)
        error = normalised_error(error, covered)


def model_node(choice: NodeChoice, kind: Literal["selected", "best"]) -> int | None:
    """The node (index) from which the road is learned; None where none is selected."""
    if not choice.selected.any():
        return None
    if kind == "selected" or len(choice.selected) == 1:
        return int(choice.stability.where(choice.selected, -torch.inf).argmax())
    return int(choice.best[1:].argmax()) + 1


def widened(mask: Tensor, reach: int) -> Tensor:
    """A mask bool (H,W), every region of it wider by ``reach`` pixels in a square."""
    return F.max_pool2d(mask[None].float(), 2 * reach + 1, 1, reach)[0] > 0


def mask_to_image(mask: Tensor, side: int) -> Tensor:
    """A mask bool (H,W) of patches at the size of the image, (H+side-1,W+side-1).

    A patch stands for the pixel in its middle, for four of them where its side is even; the
    border is repeated.
    """
    pooled = F.max_pool2d(_bordered(mask.float(), side), 2 - side % 2, 1)
    return pooled[0] > 0


def map_to_image(values: Tensor, side: int) -> Tensor:
    """Values (H,W) of patches at the size of the image: the mean where a mask is the union."""
    return F.avg_pool2d(_bordered(values, side), 2 - side % 2, 1)[0]


def _bordered(values: Tensor, side: int) -> Tensor:
    reach = side // 2
    return F.pad(values[None], (reach, reach, reach, reach), mode="replicate")


def road_likelihood(mask: Tensor, pixels: Tensor) -> Tensor:
    """(H,W) in [0,1]: the mask first, the stability of pixels in [0,1) inside and outside of it.

    At ``AS_CHOSEN`` it separates road from the rest exactly as the mask does. Ours: of twelve
    candidates the best by MaxF on the development drives (docs/research/ufl.md).
    """
    return (mask.to(pixels.device) + pixels) / 2


def enlarged_likelihood(likelihood: Tensor, size: tuple[int, int]) -> Tensor:
    """A likelihood of ``road_likelihood`` (h,w) at another size (H,W), the mask still exact in it.

    The mask is enlarged as every mask is, pixel by pixel; the stability inside and outside of it
    smoothly. To enlarge their sum smoothly would move the mask's border, inwards, for inside of
    it likelihoods begin at 0.5 and outside end well below.
    """
    mask = likelihood >= AS_CHOSEN
    return road_likelihood(
        at_image_size(mask, size), at_image_size(2 * likelihood - mask.to(likelihood), size)
    )


def map_images(
    maps: FeatureMaps, mean_map: Tensor, tree: Tree, last: Round, side: int
) -> dict[str, Tensor]:
    """What Fig. 4 of P1 shows, by name, each at the size of the image; side: of a patch."""
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
