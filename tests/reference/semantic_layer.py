"""Nav2's semantic segmentation layer, for one image of one camera, from its documentation.

kiwicampus/semantic_segmentation_layer, README, "How It Works" 1 and 4: each pixel with a finite
point whose distance from the sensor lies between two bounds marks the cell of its x and y; of the
pixels of one cell the one with the highest ``max_cost`` counts, or with the highest confidence.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from roadtorch.camera.ground import Pose
from roadtorch.camera.ground_grid import FREE, OCCUPIED, GridSettings

NAV2 = Path(__file__).parents[2] / "ros" / "roadtorch_ros" / "config" / "nav2.yaml"
NAV2_PARAMETERS = yaml.safe_load(NAV2.read_text("utf-8"))["local_costmap"]["local_costmap"][
    "ros__parameters"
]["semantic_segmentation_layer"]["camera"]


def mark_cells(
    mask: np.ndarray,
    confidence: np.ndarray,
    points: np.ndarray,
    names: Mapping[int, str],
    source: Mapping[str, Any],
    pose: Pose,
    settings: GridSettings,
) -> np.ndarray:
    """Return the layer's costs in the cells of a grid below the camera; -1 where none is marked.

    Mask and confidence are (H, W), points (H, W, 3) in the sensor's frame; source: parameters of
    the layer; pose: of the sensor, as tf gives it; settings: of the grid.
    """
    types = [source[name] for name in source["class_types"]]
    costs = {name: kind["max_cost"] for kind in types for name in kind["classes"]}
    axes, size = np.array(pose.axes), settings.cell
    marked = np.full((round(2 * settings.side / size), round(settings.range / size)), -1)
    best = marked.copy()
    for pixel in map(tuple, np.argwhere(np.isfinite(points[..., 2]))):
        distance = math.hypot(*points[pixel])
        if not source["min_obstacle_distance"] < distance < source["max_obstacle_distance"]:
            continue
        x, y, _ = points[pixel] @ axes + pose.position
        cell = math.floor((y + settings.side) / size), math.floor(x / size)
        cost = costs[names[int(mask[pixel])]]
        score = cost if source["use_cost_selection"] else int(confidence[pixel])
        if score > best[cell]:
            marked[cell], best[cell] = cost, score
    return marked


def count_stray_cells(
    marked: np.ndarray, cells: np.ndarray, settings: GridSettings, reach: float
) -> int:
    """Count the layer's cells, and the grid's within reach, without their like within a cell."""
    rows, columns = np.indices(cells.shape) * settings.cell
    near, count = np.hypot(columns, rows - settings.side) < reach, 0
    for cost, value in ((0, FREE), (254, OCCUPIED)):
        layer, grid = (marked == cost).astype(np.uint8), (cells == value).astype(np.uint8)
        wide_layer, wide_grid = (cv2.dilate(each, np.ones((3, 3))) for each in (layer, grid))
        count += (layer > wide_grid).sum() + (near * grid > wide_layer).sum()
    return int(count)
