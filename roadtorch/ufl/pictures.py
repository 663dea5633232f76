"""What Fig. 3 of P1 shows: bases and maps as small pictures in one."""

import math

import torch
from torch import Tensor


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
    count, channels, height, width = tiles.shape
    columns = round(math.sqrt(count * height * shape[1] / (width * shape[0])))
    columns = min(max(1, columns), count)
    rows = -(-count // columns)
    board = tiles.new_zeros(rows * columns, channels, height, width)
    board[:count] = tiles
    board = board.view(rows, columns, channels, height, width).permute(2, 0, 3, 1, 4)
    return board.reshape(channels, rows * height, columns * width)
