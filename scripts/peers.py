"""Score supervised networks beside our detectors on the same images: docs/figures/peers.json.

    python scripts/peers.py FOLDER DATA/many

FOLDER holds a file NAME.py a network, with ``road_probability(rgb uint8 (H, W, 3)) -> float32
(H, W)``, and what it needs (onnxruntime, openvino). Every image is shown to all of them in turn, on
one thread: F of the mask at .5 and MaxF by camera, and the median milliseconds. They measure;
nothing here ever learns from what they say.
"""

import argparse
import importlib
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from statistics import fmean, median
from time import perf_counter

import cv2
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch import load_detector
from roadtorch.base.image import to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.metrics import RoadCounts, confusion_at, count_levels, f_measure, max_f
from scripts.readme_figures import keep_records

DETECTORS = ("fusion", "fusion:large")

Predict = Callable[[Tensor], Tensor]
"""An image (3, H, W) in [0,1] → how road-like each pixel is, (H, W) in [0,1]."""


def likelihood_of(detector: Detector, image: Tensor) -> Tensor:
    """Return the likelihood of a detection, below .5 where its mask is not."""
    detection = detector.detect(image)
    return torch.where(detection.mask, detection.likelihood, detection.likelihood.clamp_max(0.499))


def load_networks(folder: Path) -> dict[str, Predict]:
    """Load our detectors and the networks of a folder, by name."""
    networks: dict[str, Predict] = {
        name: partial(likelihood_of, load_detector(name)) for name in DETECTORS
    }
    sys.path.insert(0, str(folder))
    for file in sorted(folder.glob("*.py")):
        if "def road_probability" in file.read_text(encoding="utf-8"):
            predict = importlib.import_module(file.stem).road_probability
            networks[file.stem] = lambda image, predict=predict: torch.from_numpy(
                predict(to_pixels(image))
            )
    return networks


def score(networks: Mapping[str, Predict], many: Path) -> dict[str, float]:
    """Return records ``peers.NAME.f_mask@CAMERA``, ``maxf``, their means and worst, ``ms``."""
    dataset = open_dataset("folder", many)
    counts: dict[str, dict[str, RoadCounts]] = {name: {} for name in networks}
    times: dict[str, list[float]] = {name: [] for name in networks}
    for item in dataset.items:
        if item.group == "india_zed":  # no camera of the figures
            continue
        image, truth = dataset.read(item)
        for name, predict in networks.items():
            start = perf_counter()
            likelihood = predict(image).clamp(0, 1)
            times[name].append(1000 * (perf_counter() - start))
            levels = count_levels(likelihood, truth.road, truth.valid)
            previous = counts[name].get(str(item.group))
            counts[name][str(item.group)] = levels if previous is None else previous + levels
    values: dict[str, float] = {}
    for name, cameras in counts.items():
        values[f"peers.{name}.ms"] = median(times[name])
        figures = {
            "f_mask": {
                camera: float(f_measure(confusion_at(c, 0.5))) for camera, c in cameras.items()
            },
            "maxf": {camera: float(max_f(c)[0]) for camera, c in cameras.items()},
        }
        for key, f_of in figures.items():
            values[f"peers.{name}.{key}"] = fmean(f_of.values())
            values[f"peers.{name}.{key}.worst"] = min(f_of.values())
            values |= {f"peers.{name}.{key}@{camera}": f for camera, f in f_of.items()}
    for name in DETECTORS:
        leads = (
            max(
                values[f"peers.{peer}.f_mask@{camera}"]
                for peer in networks
                if peer not in DETECTORS
            )
            - values[f"peers.{name}.f_mask@{camera}"]
            for camera in counts[name]
        )
        values[f"peers.{name}.not_behind"] = sum(lead <= 0.01 for lead in leads)
    return values


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("many", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    networks = load_networks(options.folder.resolve())
    values = score(networks, options.many)
    keep_records("peers", "python scripts/peers.py PEERS DATA/many", values)
    for name in networks:
        f, maxf, ms = (values[f"peers.{name}.{key}"] for key in ("f_mask", "maxf", "ms"))
        print(f"{name:28} F {f:.3f} MaxF {maxf:.3f} {ms:.0f} ms")


if __name__ == "__main__":
    main()
