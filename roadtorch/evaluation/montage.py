"""Sheets of pictures to look at: what a detector saw, and what it made of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.detectors import Detection
from roadtorch.evaluation.datasets import Dataset, Item, Truth
from roadtorch.evaluation.runner import WHOLE, Look
from roadtorch.image import layout_colours, to_pixels, write_colours

TILE_WIDTH = 320  # pixels
CAPTION = 18  # pixels of height
BLUE, VERMILLION, WHITE = (0, 114, 178), (213, 94, 0), (255, 255, 255)  # Okabe and Ito


def write_montage(
    path: Path,
    dataset: Dataset,
    look: Look,
    chosen: Sequence[tuple[float, str]],
    thresholds: Mapping[str, float],
) -> None:
    """Write one sheet: a row of tiles for each chosen (F, picture name)."""
    by_name = {item.name: item for item in dataset.items}
    strips = [
        montage_row(dataset, look, by_name[name], thresholds[by_name[name].group or WHOLE], value)
        for value, name in chosen
    ]
    sheet = np.concatenate(strips)
    write_colours(path, torch.from_numpy(sheet.transpose(2, 0, 1).astype(np.float32) / 255))


def montage_row(
    dataset: Dataset, look: Look, item: Item, threshold: float, value: float
) -> np.ndarray:
    """Image, layout, uniformity, likelihood and decision of one item, side by side."""
    image, truth = dataset.read(item)
    detection = look(image, item)
    decided = detection.likelihood >= threshold
    tiles = {
        f"{item.name}  F {value:.3f}": to_pixels(image),
        **cue_tiles(detection),
        "likelihood": heat(detection.likelihood),
        "decision (blue), truth (line)": decision_tile(image, decided, truth),
    }
    return np.concatenate([captioned(tile, text) for text, tile in tiles.items()], axis=1)


def cue_tiles(detection: Detection) -> dict[str, np.ndarray]:
    """Tiles of the cues that a detection has, among layout and uniformity."""
    tiles, cues = {}, detection.cues
    if "layout_labels" in cues or "layout" in cues:
        labels = cues["layout_labels"] if "layout_labels" in cues else cues["layout"].argmax(0)
        tiles["layout"] = to_pixels(layout_colours(labels))
    if "uniformity" in cues:
        uniformity = cues["uniformity"].to(torch.float32)
        low, high = uniformity.min(), uniformity.max()
        tiles["uniformity"] = heat((uniformity - low) / (high - low).clamp(min=1e-9))
    return tiles


def heat(values: Tensor) -> np.ndarray:
    """A map (H,W) in [0,1] as colours from dark blue to yellow, uint8 RGB (H,W,3)."""
    levels = (values * 255).round().to(torch.uint8).contiguous().numpy()
    return np.ascontiguousarray(cv2.applyColorMap(levels, cv2.COLORMAP_CIVIDIS)[..., ::-1])


def decision_tile(image: Tensor, decided: Tensor, truth: Truth) -> np.ndarray:
    """The image with the decided road tinted blue, void black, the true road outlined."""
    tint = torch.tensor(BLUE)[:, None, None] / 255
    tinted = torch.where(decided, 0.45 * image + 0.55 * tint, image) * truth.valid
    pixels = to_pixels(tinted)
    outlines, _ = cv2.findContours(
        truth.road.numpy().astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE
    )
    width = max(1, round(pixels.shape[1] / TILE_WIDTH))
    return cv2.drawContours(pixels, outlines, -1, VERMILLION, 2 * width)


def captioned(tile: np.ndarray, text: str) -> np.ndarray:
    """A tile of the sheet's width with a line of text above."""
    height = round(tile.shape[0] * TILE_WIDTH / tile.shape[1])
    small = cv2.resize(tile, (TILE_WIDTH, height), interpolation=cv2.INTER_AREA)
    bar = np.zeros((CAPTION, TILE_WIDTH, 3), np.uint8)
    cv2.putText(bar, text, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE, 1, cv2.LINE_AA)
    return np.concatenate([bar, small])
