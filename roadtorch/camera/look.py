"""What the ego car looks like: a few gradients by which a picture of another camera is told.

The gradients are taken where they hardly change from frame to frame, on the ego car and at its
upper edge. Ours.
"""

from itertools import product
from typing import Annotated

import torch
from pydantic import Field, model_validator
from torch import Tensor
from torch.nn import functional as F

from roadtorch.camera.still import Stillness, gradients, small_grey, small_size, softened
from roadtorch.settings import Settings

POINTS = 160
"""Points of a look: enough for a sure answer, few enough for a file that people read."""

EDGE = 2
"""Rows above the ego car that its edge is spread over, of a picture 320 pixels wide."""

SHIFT = 1
"""Pixels by which a picture may be displaced, as rounding does when pictures are scaled."""

MOST, LEAST = 0.5, 0.2
"""The likeness that is asked for lies between: other cameras have about .1, and .5 hardly ever."""

Shares = tuple[Annotated[float, Field(ge=0, le=1)], ...]
Parts = tuple[Annotated[float, Field(ge=-1, le=1)], ...]


class Look(Settings):
    """Softened gradients of the ego car at some points; no points where there is no ego car."""

    least: float = Field(default=LEAST, ge=-1, le=1, description="likeness of its own pictures")
    rows: Shares = Field(default=(), strict=False, description="points, shares of the height")
    columns: Shares = Field(default=(), strict=False, description="shares of the width")
    across: Parts = Field(default=(), strict=False, description="mean gradient to the right")
    down: Parts = Field(default=(), strict=False, description="mean gradient downwards")

    @model_validator(mode="after")
    def _has_all_of_each_point(self) -> "Look":
        if len({len(self.rows), len(self.columns), len(self.across), len(self.down)}) > 1:
            raise ValueError("Give as many rows, columns, across and down")
        return self


def ego_look(still: Stillness, rows: Tensor) -> Look:
    """The look of the ego car that begins at rows (w,) int64 in pictures (h,w): the surest points.

    Points lie apart (each the best of 3×3 pixels), so that one long edge is not all there is.
    """
    height, width = still.length.shape
    row = torch.arange(height)[:, None]
    sure = still.common * still.coherence * ((row >= rows - EDGE) & (rows < height))
    is_peak = sure == F.max_pool2d(sure[None, None], 3, 1, 1)[0, 0]
    peaks = torch.where(is_peak, sure, 0).reshape(-1)
    best = peaks.sort(descending=True, stable=True).indices[:POINTS]
    best = best[peaks[best] > 0].sort().values
    across, down = still.mean.flatten(1)[:, best]
    return Look(
        rows=_rounded((best // width + 0.5) / height, 4),
        columns=_rounded((best % width + 0.5) / width, 4),
        across=_rounded(across, 3),
        down=_rounded(down, 3),
    )


def _rounded(values: Tensor, digits: int) -> tuple[float, ...]:
    return tuple(round(value, digits) for value in values.tolist())


def sure_look(look: Look, found: list[Tensor]) -> Look:
    """The look with the likeness that most of its own pictures have, gradients (2,h,w).

    Three fifths of what four pictures of five exceed: those to come differ more than these do.
    """
    own = torch.tensor([gradient_likeness(look, gradient) for gradient in found])
    least = min(MOST, max(LEAST, 0.6 * float(own.quantile(0.2))))
    return look.model_copy(update={"least": round(least, 3)})


def image_likeness(look: Look, image: Tensor) -> float:
    """How alike an image (3,H,W) in [0,1] is to a look, from -1 to 1; .1 for other cameras."""
    return gradient_likeness(look, next(gradients([small_grey(image, small_size([image]))])))


def gradient_likeness(look: Look, gradient: Tensor) -> float:
    """The same for the gradient (2,h,w) of a small grey picture: a cosine, the best of shifts."""
    height, width = gradient.shape[1:]
    rows = (torch.tensor(look.rows) * height).long()
    columns = (torch.tensor(look.columns) * width).long()
    expected = torch.tensor([look.across, look.down]).reshape(-1)
    unit, best = softened(gradient), -1.0
    for down, right in product(range(-SHIFT, SHIFT + 1), repeat=2):
        seen = unit[:, (rows + down).clamp(0, height - 1), (columns + right).clamp(0, width - 1)]
        best = max(best, float(F.cosine_similarity(seen.reshape(-1), expected, 0)))
    return best
