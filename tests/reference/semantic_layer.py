"""Nav2's semantic segmentation layer, for one image of one camera, from its documentation.

kiwicampus/semantic_segmentation_layer, README, "How It Works" 1 and 4: each pixel with a finite
point whose distance from the sensor lies between two bounds marks the tile of its x and y; of the
pixels of one tile the one with the highest ``max_cost`` counts, or with the highest confidence.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

NAV2 = Path(__file__).parents[2] / "ros" / "roadtorch_ros" / "config" / "nav2.yaml"
NAV2_PARAMETERS = yaml.safe_load(NAV2.read_text("utf-8"))["local_costmap"]["local_costmap"][
    "ros__parameters"
]["semantic_segmentation_layer"]["camera"]


def mark_tiles(
    mask: np.ndarray,
    confidence: np.ndarray,
    points: np.ndarray,
    names: Mapping[int, str],
    source: Mapping[str, Any],
    pose: tuple[np.ndarray, np.ndarray],
    resolution: float,
) -> dict[tuple[int, int], int]:
    """Return the cost of each marked tile (column, row).

    Mask and confidence are (H, W), points (H, W, 3) in the sensor's frame; source: parameters of
    the layer; pose: the sensor's axes (3, 3), one per row, and its position.
    """
    types = [source[name] for name in source["class_types"]]
    costs = {name: kind["max_cost"] for kind in types for name in kind["classes"]}
    axes, position = pose
    best: dict[tuple[int, int], tuple[int, int]] = {}
    for pixel in map(tuple, np.argwhere(np.isfinite(points[..., 2]))):
        distance = math.hypot(*points[pixel])
        if not source["min_obstacle_distance"] < distance < source["max_obstacle_distance"]:
            continue
        x, y, _ = points[pixel] @ axes + position
        tile = math.floor(x / resolution), math.floor(y / resolution)
        cost = costs[names[int(mask[pixel])]]
        score = cost if source["use_cost_selection"] else int(confidence[pixel])
        best[tile] = max(best.get(tile, (-1, 0)), (score, cost), key=lambda pair: pair[0])
    return {tile: cost for tile, (_, cost) in best.items()}
