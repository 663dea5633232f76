"""Montages of an evaluation: rows of image, cues, likelihood and decision."""

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.bounded import to_printable
from roadtorch.base.image import jpeg_bytes, to_pixels, write_pixels
from roadtorch.data.dataset import Dataset, LabelledItem, Truth
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation.methods import Predictor
from roadtorch.evaluation.result import Evaluation, rank_images, select_examples
from roadtorch.evaluation.scoring import warp_truth
from roadtorch.evaluation.tally import UNGROUPED
from roadtorch.imaging.resize import spatial_size
from roadtorch.layout.classes import colour_layout

MAX_DETECTORS = 8  # detectors with montages
TILE_WIDTH = 320  # pixels
CAPTION_HEIGHT = 18  # pixels
MAX_PAGE_WIDTH = 1200  # pixels on the page; ours: the width at which it is displayed
JPEG_QUALITY = 80  # on pages; ours: no artefact is visible at that size
BLUE, VERMILLION, WHITE = (0, 114, 178), (213, 94, 0), (255, 255, 255)  # Okabe and Ito


def write_montages(out: Path, evaluation: Evaluation, count: int) -> list[tuple[str, str]]:
    """Write ``montage.NAME.best.jpg``, ``.median`` and ``.worst`` for the best detectors.

    At most ``MAX_DETECTORS`` with the highest MaxF get one, baselines none. Returns captions and
    data URIs for the page.
    """
    detectors, dataset = evaluation.detectors, evaluation.dataset
    ranked = [name for name in evaluation.ranking() if not detectors[name].is_baseline]
    items, montages = {item.name: item for item in dataset.items}, list[tuple[str, str]]()
    for name in ranked[:MAX_DETECTORS]:
        scores, predictor = detectors[name], detectors[name].contender.prepare(dataset)
        order = rank_images(evaluation.tallies[name], scores)
        for part, images in select_examples(order, count).items():
            rows = [
                draw_montage_row(dataset, predictor, item, scores.thresholds, value)
                for value, item in ((value, items[image]) for value, image in images)
            ]
            if rows:
                width = max(row.shape[1] for row in rows)
                pixels = np.concatenate(
                    [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows]
                )
                write_pixels(out / f"montage.{name.replace(':', '-')}.{part}.jpg", pixels)
                montages.append((f"{name}, {part}", jpeg_uri(_shrink(pixels))))
    return montages


def draw_montage_row(
    dataset: Dataset,
    predictor: Predictor,
    item: LabelledItem,
    thresholds: Mapping[str, float],
    value: float,
) -> np.ndarray:
    """Draw image, layout, uniformity, likelihood and decision side by side, in the scored view."""
    image, truth = dataset.read(item)
    viewed, detection = image, predictor(image, item)
    if detection.likelihood.shape != truth.road.shape:
        viewed = dataset.warp(item, spatial_size(image), image)
        truth = warp_truth(dataset, item, truth)
    decided = detection.likelihood >= thresholds[item.group or UNGROUPED]
    tiles = {
        f"{item.name}  F {value:.3f}": to_pixels(image),
        **cue_tiles(detection),
        "likelihood": apply_colormap(detection.likelihood),
        "decision (blue), truth (line)": decision_tile(viewed, decided, truth),
    }
    return hstack_tiles(tiles, image.shape[1:])


def hstack_tiles(tiles: Mapping[str, np.ndarray], size: Sequence[int]) -> np.ndarray:
    """Return captioned tiles side by side, uint8 RGB, as high as an image of a size needs."""
    height = round(size[0] * TILE_WIDTH / size[1])
    return np.hstack([caption_tile(tile, text, height) for text, tile in tiles.items()])


def cue_tiles(detection: Detection) -> dict[str, np.ndarray]:
    """Return tiles of the detection's cues layout and uniformity, where it has them."""
    tiles, cues = {}, detection.cues
    if "layout_labels" in cues or "layout" in cues:
        labels = cues["layout_labels"] if "layout_labels" in cues else cues["layout"].argmax(0)
        tiles["layout"] = to_pixels(colour_layout(labels))
    if "uniformity" in cues:
        uniformity = cues["uniformity"].to(torch.float32)
        low, high = uniformity.min(), uniformity.max()
        tiles["uniformity"] = apply_colormap((uniformity - low) / (high - low).clamp(min=1e-9))
    return tiles


def apply_colormap(values: Tensor) -> np.ndarray:
    """Colour a map (H, W) in [0, 1] from dark blue to yellow, uint8 RGB (H, W, 3)."""
    levels = (values * 255).round().to(torch.uint8).contiguous().numpy()
    return np.ascontiguousarray(cv2.applyColorMap(levels, cv2.COLORMAP_CIVIDIS)[..., ::-1])


def decision_tile(image: Tensor, decided: Tensor, truth: Truth) -> np.ndarray:
    """Draw the predicted road blue, void dark, and the outline of the true road."""
    tint = torch.tensor(BLUE)[:, None, None] / 255
    tinted = torch.where(decided, 0.45 * image + 0.55 * tint, image) * (0.3 + 0.7 * truth.valid)
    pixels = to_pixels(tinted)
    road = truth.road.numpy().astype(np.uint8)
    outlines, _ = cv2.findContours(road, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    width = max(1, round(pixels.shape[1] / TILE_WIDTH))
    return cv2.drawContours(pixels, outlines, -1, VERMILLION, 2 * width)


def caption_tile(tile: np.ndarray, text: str, height: int) -> np.ndarray:
    """Fit a tile into TILE_WIDTH × height under a caption, with black bars where it is narrower."""
    scale = min(TILE_WIDTH / tile.shape[1], height / tile.shape[0])
    size = (max(1, round(tile.shape[1] * scale)), max(1, round(tile.shape[0] * scale)))
    small = cv2.resize(tile, size, interpolation=cv2.INTER_AREA)
    canvas = np.zeros((CAPTION_HEIGHT + height, TILE_WIDTH, 3), np.uint8)
    text = to_printable(text)  # OpenCV crashes on other names
    cv2.putText(canvas, text, (4, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.4, WHITE, 1, cv2.LINE_AA)
    offset = (TILE_WIDTH - size[0]) // 2
    canvas[CAPTION_HEIGHT : CAPTION_HEIGHT + size[1], offset : offset + size[0]] = small
    return canvas


def _shrink(montage: np.ndarray) -> np.ndarray:
    """Return a montage, uint8 RGB (H, W, 3), at most as wide as the page shows it."""
    scale = min(1.0, MAX_PAGE_WIDTH / montage.shape[1])
    return cv2.resize(montage, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def jpeg_uri(pixels: np.ndarray) -> str:
    """Return pixels, uint8 RGB (H, W, 3), as the data URI of a JPEG."""
    data = base64.b64encode(jpeg_bytes(pixels, JPEG_QUALITY)).decode()
    return f"data:image/jpeg;base64,{data}"
