"""Dense motion between two images, and what it carries along.

A flow says for every pixel of an image where it was in another one. Source of the flow: Kroeger
et al., Fast Optical Flow using Dense Inverse Search, ECCV 2016, as OpenCV has it. Where the flow
there and back does not end where it began, the pixel is hidden in one of the images, or nothing
there can be followed (Sundaram et al., ECCV 2010).
"""

import cv2
import numpy as np
import torch
from torch import Tensor

FASTEST = cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST
FAST = cv2.DISOPTICAL_FLOW_PRESET_FAST

MIN_SIDE = 32
"""Pixels of a side at the least: OpenCV 5.0 crashes on smaller images with the fast presets."""


def flow_image(image: Tensor, width: int) -> Tensor:
    """An image (3,H,W) in [0,1] as grey of at most this width, uint8 (h,w).

    Its shape is kept as long as no side falls below ``MIN_SIDE``.
    """
    grey = np.ascontiguousarray(image.detach().cpu().mean(0).numpy())
    height, wide = grey.shape
    scale = min(1.0, width / wide)
    size = (max(MIN_SIDE, round(wide * scale)), max(MIN_SIDE, round(height * scale)))
    if size != (wide, height):
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return torch.from_numpy(np.round(grey * 255).astype(np.uint8))


def dense_flow(here: Tensor, there: Tensor, preset: int = FASTEST) -> Tensor:
    """Where each pixel of ``here`` is in ``there``: float32 (h,w,2), pixels right and down.

    here, there: uint8 (h,w). preset: one of OpenCV's for dense inverse search. Raises ValueError
    for images with a side below ``MIN_SIDE``.
    """
    if min(here.shape) < MIN_SIDE:
        raise ValueError(f"no flow of {tuple(here.shape)}: give {MIN_SIDE} pixels a side or more")
    search = cv2.DISOpticalFlow.create(preset)
    flow = search.calc(here.numpy(), there.numpy(), None)  # type: ignore[arg-type]
    return torch.from_numpy(flow)


def warp(plane: Tensor, flow: Tensor) -> Tensor:
    """The values of a plane float32 (H,W) or (H,W,2) where a flow (h,w,2) points, at its size.

    Between pixels they are interpolated; outside, those at the edge. A flow of another size is
    brought to the plane's.
    """
    columns, rows = _pointed(flow, plane.shape[0], plane.shape[1])
    edge = cv2.BORDER_REPLICATE
    values = cv2.remap(plane.numpy(), columns, rows, cv2.INTER_LINEAR, borderMode=edge)
    return torch.from_numpy(values)


def _pointed(flow: Tensor, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows where a flow points, float32 (height,width) each, at that size."""
    right, down = cv2.split(flow.numpy())
    columns = cv2.resize(right, (width, height), interpolation=cv2.INTER_LINEAR)
    rows = cv2.resize(down, (width, height), interpolation=cv2.INTER_LINEAR)
    columns *= width / flow.shape[1]
    columns += np.arange(width, dtype=np.float32)
    rows *= height / flow.shape[0]
    rows += np.arange(height, dtype=np.float32)[:, None]
    return columns, rows


def forward_backward_error(flow: Tensor, back: Tensor) -> Tensor:
    """Pixels between where a round trip begins and where it ends, float32 (h,w).

    flow: (h,w,2) from here to there. back: from there to here. Infinite where it leaves the
    image.
    """
    height, width = flow.shape[:2]
    columns, rows = _pointed(flow, height, width)
    outside = (columns < 0) | (columns > width - 1) | (rows < 0) | (rows > height - 1)
    right, down = cv2.split((flow + warp(back, flow)).numpy())
    # Not cv2.magnitude, whose last digit depends on where in memory an array happens to lie.
    missed = np.sqrt(right * right + down * down)
    missed[outside] = np.inf
    return torch.from_numpy(missed)
