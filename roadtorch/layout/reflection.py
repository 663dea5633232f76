"""What lies past the border of a picture, so that every pixel has its patch: its reflection.

Reflected at the outermost pixels, as often as it takes; a picture of one row is repeated.
"""

import torch
from torch import Tensor


def reflected(pixels: Tensor, patch: int) -> Tensor:
    """Pixels (…,H,W) with a frame, so that each has its patch: patch/2 before, one less behind."""
    for axis in (-2, -1):
        index = bounced(pixels.shape[axis], patch // 2, patch - patch // 2 - 1)
        pixels = pixels.index_select(axis, index.to(pixels.device))
    return pixels


def bounced(length: int, before: int, behind: int) -> Tensor:
    """-before … length+behind-1, thrown back at 0 and length-1 like a ball between walls."""
    place = torch.arange(-before, length + behind)
    last = torch.full_like(place, length - 1)  # a tensor, as is the length in an exported graph
    period = (2 * last).clamp_min(1)
    place = place.remainder(period)
    return torch.minimum(torch.minimum(place, period - place), last)


def with_columns(pixels: Tensor, rows: Tensor, before: int, behind: int) -> Tensor:
    """Some rows (r,) of pixels (C,H,W) with columns before and behind: (r,Q,C), channels last.

    Only the columns of the frame are looked up one by one, which is slow.
    """
    width = pixels.shape[2]
    inside = pixels.index_select(1, rows).permute(1, 2, 0).contiguous()
    columns = bounced(width, before, behind).to(pixels.device)
    left, right = columns[:before], columns[before + width :]
    return torch.cat([inside.index_select(1, left), inside, inside.index_select(1, right)], 1)
