"""Local binary patterns, the texture that P2 compares colour plane fusion with (section 6.2)."""

import torch
from torch import Tensor
from torch.nn import functional

from roadtorch.road.texture import shares

CORNER = 0.5**0.5
"""Row and column of the diagonal neighbours on the circle of radius 1."""

SMALLEST_ROTATION = tuple(
    min((code >> turn | code << (8 - turn)) & 255 for turn in range(8)) for code in range(256)
)
"""For each pattern of eight bits in a circle, the smallest number that a rotation gives."""


def uniform_patterns(grey: Tensor) -> Tensor:
    """Rotation-invariant uniform local binary patterns (8 neighbours, radius 1): int64 (H,W).

    0…8: that many neighbours, in one run, are at least as bright as the centre; 9: several
    runs. LBP^riu2 of Ojala et al., PAMI 2002; "uniform" in scikit-image. The picture is
    continued beyond its edge by its outermost pixels.
    """
    bits = _brighter(grey)
    changes = (bits != bits.roll(1, 0)).sum(0)
    return torch.where(changes <= 2, bits.sum(0), 9)


def smallest_patterns(grey: Tensor) -> Tensor:
    """Rotation-invariant local binary patterns (8 neighbours, radius 1): int64 (H,W), 0…255.

    The smallest number among the rotations of the eight bits, 36 different ones. LBP^ri of
    Ojala et al., PAMI 2002; "ror" in scikit-image. Edges as in ``uniform_patterns``.
    """
    code = torch.zeros_like(grey, dtype=torch.int64)
    for place, bit in enumerate(_brighter(grey)):
        code |= bit.to(torch.int64) << place
    return torch.tensor(SMALLEST_ROTATION, device=grey.device)[code]


def _brighter(grey: Tensor) -> Tensor:
    """Whether each of 8 neighbours on the unit circle is at least as bright: bool (8,H,W).

    From the right, anticlockwise. Differences to the centre are interpolated, not values:
    flat areas then give exactly 0.
    """
    height, width = grey.shape
    padded = functional.pad(grey[None, None], (1, 1, 1, 1), mode="replicate")[0, 0]

    def difference(row: int, column: int) -> Tensor:
        return padded[1 + row : 1 + row + height, 1 + column : 1 + column + width] - grey

    ring = [(0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1), (1, 0), (1, 1)]
    around = torch.stack([difference(*place) for place in ring])
    straight, diagonal = around[0::2], around[1::2]
    sides = straight + straight.roll(-1, 0)
    between = CORNER * CORNER * diagonal + CORNER * (1 - CORNER) * sides
    return torch.stack([straight, between], 1).flatten(0, 1) >= 0


def similarity(histogram: Tensor, reference: Tensor) -> Tensor:
    """How alike counts (…,L) and a reference (L,) are: (…), 1 alike, 0 nothing in common.

    1 - χ²/2 with χ² = Σ (p-q)²/(p+q). Ojala et al. take a log-likelihood, which here also
    rewards regions more even than the reference (AUC below one half); χ², the histogram
    intersection and the Kullback-Leibler divergence came out within 0.01 of one another.
    0 where a histogram is empty.
    """
    one, two = shares(histogram), shares(reference)
    total = one + two
    squares = (one - two).square() / total.clamp_min(torch.finfo(total.dtype).tiny)
    return ((total - squares).sum(-1) / 2).clamp(0, 1)


PATTERNS = {"uniform": (uniform_patterns, 10), "smallest": (smallest_patterns, 256)}
"""By name: the function and how many codes it has."""
