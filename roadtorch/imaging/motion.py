"""Dense optical flow between two images, and warping by it.

Flow: Kroeger et al., "Fast Optical Flow using Dense Inverse Search", ECCV 2016, as implemented in
OpenCV. Where the forward and the backward flow disagree, the pixel is occluded in one of the images
or cannot be tracked (Sundaram et al., ECCV 2010).
"""

import cv2
import numpy as np
import torch
from torch import Tensor

MIN_FLOW_SIDE = 32
"""Shortest side in pixels: OpenCV 5.0 crashes on smaller images with the fast presets."""


def flow_image(image: Tensor, width: int) -> Tensor:
    """Convert an image (3, H, W) in [0, 1] to grey uint8 (h, w), the flow's input.

    It is at most ``width`` wide and has the image's aspect ratio, but ``MIN_FLOW_SIDE`` at least.
    """
    grey = np.ascontiguousarray(image.detach().cpu().mean(0).numpy())
    height, wide = grey.shape
    scale = min(1.0, width / wide)
    size = (max(MIN_FLOW_SIDE, round(wide * scale)), max(MIN_FLOW_SIDE, round(height * scale)))
    if size != (wide, height):
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return torch.from_numpy(np.round(grey * 255).astype(np.uint8))


def dense_flow(source: Tensor, target: Tensor) -> Tensor:
    """Compute the flow from ``source`` to ``target``: float32 (h, w, 2), pixels right and down.

    source, target: uint8 (h, w), of ``flow_image``.
    """
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    flow = search.calc(source.numpy(), target.numpy(), None)  # type: ignore[arg-type]
    return torch.from_numpy(flow)


def warp(plane: Tensor, flow: Tensor) -> Tensor:
    """Sample a plane, float32 (H, W) or (H, W, 2), where a flow (h, w, 2) points, bilinearly.

    Flow is resized to the plane's size. Outside, the edge is repeated.
    """
    columns, rows = _target_positions(flow, plane.shape[0], plane.shape[1])
    edge = cv2.BORDER_REPLICATE
    values = cv2.remap(plane.numpy(), columns, rows, cv2.INTER_LINEAR, borderMode=edge)
    return torch.from_numpy(values)


def _target_positions(flow: Tensor, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns and rows to which a flow points, float32 (height, width) each."""
    right, down = cv2.split(flow.numpy())
    columns = cv2.resize(right, (width, height), interpolation=cv2.INTER_LINEAR)
    rows = cv2.resize(down, (width, height), interpolation=cv2.INTER_LINEAR)
    columns *= width / flow.shape[1]
    columns += np.arange(width, dtype=np.float32)
    rows *= height / flow.shape[0]
    rows += np.arange(height, dtype=np.float32)[:, None]
    return columns, rows


def forward_backward_error(flow: Tensor, back: Tensor) -> Tensor:
    """Compute the distance (h, w) in pixels from start to end of a round trip along two flows.

    flow, back: (h, w, 2), to another image and back. Infinite where the trip leaves the image.
    """
    height, width = flow.shape[:2]
    columns, rows = _target_positions(flow, height, width)
    outside = (columns < 0) | (columns > width - 1) | (rows < 0) | (rows > height - 1)
    right, down = cv2.split((flow + warp(back, flow)).numpy())
    # Not cv2.magnitude, whose last digit depends on the array's address.
    missed = np.sqrt(right * right + down * down)
    missed[outside] = np.inf
    return torch.from_numpy(missed)
