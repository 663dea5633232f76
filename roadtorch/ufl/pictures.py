"""What Figs. 3 and 4 of P1 show: bases, maps and regions as pictures."""

import math

import torch
from torch import Tensor

from roadtorch.ufl.hierarchy import Tree, paint_nodes
from roadtorch.ufl.maps import FeatureMaps
from roadtorch.ufl.road import Round, map_to_image


def dictionary_picture(
    dictionary: Tensor, order: Tensor, side: int, shape: tuple[int, ...]
) -> Tensor:
    """The bases (K,d) as small RGB pictures in one, by falling score (P1, Fig. 3): (3,h,w)."""
    tiles = dictionary[order].view(-1, 3, side, side)
    low, high = tiles.amin((1, 2, 3), keepdim=True), tiles.amax((1, 2, 3), keepdim=True)
    return mosaic((tiles - low) / torch.where(high > low, high - low, 1), shape)


def mosaic(tiles: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Tiles (k,C,h,w) side by side in reading order, on black: (C,rows·h,columns·w).

    As many in a row as bring the whole near to the shape, given as height and width.
    """
    from skimage.util import montage  # late: half a second that only these pictures need

    count, channels, height, width = tiles.shape
    columns = round(math.sqrt(count * height * shape[1] / (width * shape[0])))
    columns = min(max(1, columns), count)
    rows = -(-count // columns)
    pixels = tiles.movedim(1, -1).cpu().numpy()
    board = montage(pixels, [0] * channels, grid_shape=(rows, columns), channel_axis=-1)
    return torch.from_numpy(board).movedim(-1, 0).contiguous().to(tiles.device)


def map_pictures(
    found: FeatureMaps, mean_map: Tensor, tree: Tree, last: Round, side: int
) -> dict[str, Tensor]:
    """What Fig. 4 of P1 shows, by name, each at the size of the image; side: of a patch."""
    levels = (tree.node_of >= 0)[tree.regions.labels.long()].sum(0)
    nodes = paint_nodes(tree, last.choice.stability.clamp_min(0) * last.choice.selected)
    cues = {
        "best_map": found.maps[0],
        "mean_map": mean_map,
        "tree_levels": levels,
        "error": last.error,
        "pixel_stability": last.pixels,
        "node_stability": nodes,
    }
    return {name: map_to_image(cue.float(), side) for name, cue in cues.items()}
