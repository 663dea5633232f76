"""A patch network at every pixel of a picture, in the shapes that matrix kernels are made for.

2×2 subsampling that is begun at each of its four places gives four pictures of half the size,
"fragments" (Giusti et al., "Fast Image Scanning with Deep Max-Pooling Convolutional Neural
Networks", ICIP 2013). What follows is an ordinary convolution of each: its neighbours lie side
by side, where those of the dilated form on the whole picture lie apart.

A processor multiplies 16 numbers at a time, one for each kernel of a layer. Four or three
kernels leave most of them idle. So the same kernels are laid side by side for several
neighbouring places (``side_by_side``): more multiplications, some of them with 0, in less time.

Past its border a picture is reflected at the outermost pixels, as often as it takes; a picture of
one row is repeated.

Maps are (rows, columns, channels) in memory. They are made band by band: large tensors that come
and go cost more time at the operating system, page by page, than all that is done with them but
the convolutions.
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

ACROSS = 4
"""Neighbours in a row that the first layer answers at once: 4 of 4 kernels are 16."""

BLOCK = 2
"""Rows and columns that the last layer answers at once: 4 pixels of 3 classes are 12."""

BAND = 2**17
"""Places of a band: what its maps take stays with the process, for the next band."""

WHOLE = torch.complex128
"""Four float32 as one number of the same bytes: where they are copied, they are moved as one."""

Pooling = Literal["mean", "max"]


class Layer(NamedTuple):
    """A convolution: weight (K,C,s,s), bias (K,)."""

    weight: Tensor
    bias: Tensor


class Layers(NamedTuple):
    """A patch network: three convolutions, tanh behind the first two, subsampling behind tanh.

    patch: pixels of its side. subsamplings: 1 or 2, the stages that are followed by it.
    """

    first: Layer
    second: Layer
    last: Layer
    patch: int
    pooling: Pooling
    subsamplings: int

    def scores(self, pixels: Tensor) -> Tensor:
        """Scores (K,H,W) of the patch around each of the pixels (C,H,W), reflected past the border.

        What the layers say patch by patch, but for rounding.
        """
        stride = 2**self.subsamplings
        height, width = (_up_to(side, BLOCK * stride) for side in pixels.shape[1:])
        scores = pixels.new_empty(len(self.last.bias), height, width)
        last = self.last if self.subsamplings == 1 else after(self.last, self.pooling)
        ready = self._replace(
            first=side_by_side(self.first, 1, ACROSS),
            second=after(self.second, self.pooling),
            last=side_by_side(last, BLOCK, BLOCK),
        )
        maps = ready.first_fragments(pixels, height, width)
        rows = self.second.weight.shape[2] - 1 + (self.last.weight.shape[2] - 1) * stride // 2
        beyond = rows + self.subsamplings - 1
        for (row, column), fragment in _places(maps):
            into = scores[:, row::2, column::2]
            for top, end in _bands(height // 2, fragment.shape[1], BLOCK * stride // 2):
                ready.finish(fragment[top : end + beyond], into[:, top:end])
        return scores[:, : pixels.shape[1], : pixels.shape[2]]

    def first_fragments(self, pixels: Tensor, height: int, width: int) -> Tensor:
        """Fragments (2,2,h,w,K) of the first layer's maps, enough for ``height`` × ``width``.

        Of layers as ``scores`` makes them ready, side by side; so is ``finish``.
        """
        size, before = self.first.weight.shape[2], self.patch // 2
        rows = height + self.patch - size  # of its maps; odd, as are the columns
        columns = width + self.patch - size
        behind = _up_to(columns, ACROSS) + size - 1 - before - pixels.shape[2]
        source = bounced(pixels.shape[1], before, rows + size - 1 - before - pixels.shape[1])
        source = source.to(pixels.device)
        kernels = len(self.first.bias) // ACROSS
        fragments = pixels.new_empty(2, 2, rows // 2, columns // 2, kernels)
        for top, end in _bands(rows - 1, columns, 2):
            seen = with_columns(pixels, source[top : end + size], before, behind)
            maps = convolved(seen, self.first, (1, ACROSS)).tanh_()
            maps = maps.reshape(len(maps), -1, kernels)[:, :columns]
            put_fragments(maps, self.pooling, fragments[:, :, top // 2 : end // 2])
        return fragments

    def finish(self, maps: Tensor, into: Tensor) -> None:
        """What the second and the last layer make of a fragment (R,Q,C), into scores (K,h,w)."""
        seen = convolved(maps, self.second).tanh_()
        if self.subsamplings == 1:
            put_scores(seen, self.last, into)
            return
        rows, columns, channels = seen.shape
        inner = seen.new_empty(2, 2, rows // 2, columns // 2, channels)
        put_fragments(seen, self.pooling, inner)
        for (row, column), fragment in _places(inner):
            put_scores(fragment, self.last, into[:, row::2, column::2])


def side_by_side(layer: Layer, rows: int, columns: int) -> Layer:
    """The layer for rows × columns neighbouring places: kernels (rows·columns·K,C,s+r-1,s+c-1).

    Moved over the picture in steps of (rows, columns), with the answers in the order (row,
    column, kernel), it says what the layer says at every place.
    """
    moved = [
        F.pad(layer.weight, (column, columns - 1 - column, row, rows - 1 - row))
        for row in range(rows)
        for column in range(columns)
    ]
    return _channels_last(Layer(torch.cat(moved), layer.bias.repeat(rows * columns)))


def after(layer: Layer, pooling: Pooling) -> Layer:
    """The layer that follows ``put_fragments``, which gives four times the mean.

    A quarter of a weight changes nothing but its exponent.
    """
    weight = layer.weight / 4 if pooling == "mean" else layer.weight
    return _channels_last(Layer(weight, layer.bias))


def _channels_last(layer: Layer) -> Layer:
    return Layer(layer.weight.contiguous(memory_format=torch.channels_last), layer.bias)


def convolved(maps: Tensor, layer: Layer, steps: tuple[int, int] = (1, 1)) -> Tensor:
    """Maps (R,Q,C) under a layer, moved in these steps: (r,q,K)."""
    batch = maps.permute(2, 0, 1)[None]
    maps = F.conv2d(batch, layer.weight, layer.bias, steps)[0].permute(1, 2, 0)
    return maps.contiguous()  # as it is already, but where another kernel took a tiny picture


def put_fragments(maps: Tensor, pooling: Pooling, into: Tensor) -> None:
    """Maps (R,Q,C), R and Q odd, subsampled 2×2 from each place, into (2,2,(R-1)/2,(Q-1)/2,C).

    By the row and the column at which subsampling begins. Sums in the place of means: ``after``.
    """
    join = torch.add if pooling == "mean" else torch.maximum
    across = join(maps[:, :-1], maps[:, 1:])
    for start, place in enumerate(into):
        both = join(across[start:-1:2], across[start + 1 :: 2])
        _whole(place).copy_(_whole(both).unflatten(1, (-1, 2)).permute(2, 0, 1, 3))


def _whole(maps: Tensor) -> Tensor:
    """Maps (…,C) as fewer and longer numbers of the same bytes, where that is possible."""
    fits = maps.dtype == torch.float32 and maps.shape[-1] % 4 == 0
    return maps.view(WHOLE) if fits else maps


def put_scores(maps: Tensor, layer: Layer, into: Tensor) -> None:
    """The last layer's scores at every place of maps (h+s-1,w+s-1,C), into a view (K,h,w).

    layer: ``side_by_side`` of ``BLOCK`` and ``BLOCK``, of which h and w must be multiples.
    """
    scores = convolved(maps, layer, (BLOCK, BLOCK))
    blocks = scores.unflatten(2, (BLOCK, BLOCK, -1)).permute(4, 0, 2, 1, 3)
    into.unflatten(2, (-1, BLOCK)).unflatten(1, (-1, BLOCK)).copy_(blocks)


def _places(fragments: Tensor) -> Iterator[tuple[tuple[int, int], Tensor]]:
    """The four fragments of (2,2,…), each with the row and column at which it begins."""
    for row in range(2):
        for column in range(2):
            yield (row, column), fragments[row, column]


def _bands(rows: int, columns: int, multiple: int) -> Iterator[tuple[int, int]]:
    """First and last row (exclusive) of bands of about ``BAND`` places, whole multiples each."""
    step = max(1, BAND // (columns * multiple)) * multiple
    for top in range(0, rows, step):
        yield top, min(top + step, rows)


def _up_to(length: int, multiple: int) -> int:
    """The next multiple, or the length itself where it is one."""
    return -(-length // multiple) * multiple


# --- past the border --------------------------------------------------------------------


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
