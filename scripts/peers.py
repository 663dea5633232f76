"""Score supervised networks beside our detectors on the same pictures: docs/figures/peers.json.

    python scripts/peers.py FOLDER DATA/many [--threads 1]

FOLDER holds a file NAME.py a network, with ``road_probability(rgb uint8 (H,W,3)) -> float32
(H,W)``, and what it needs (onnxruntime, openvino). Every picture is shown to all of them in turn,
on one thread: F of the mask at .5 and MaxF by camera, and the median milliseconds. They measure;
nothing here ever learns from what they say.
"""

import argparse
import importlib
import json
import shlex
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import cv2
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch import load_detector
from roadtorch.base.image import to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.metrics import RoadCounts, count_levels, decisions_at, f_measure, max_f
from scripts.readme_figures import FIGURES, used
from scripts.readme_tables import CAMERAS

OURS = ("fusion", "fusion:large")

Judge = Callable[[Tensor], Tensor]
"""An image (3,H,W) in [0,1] → how road-like each pixel is, (H,W) in [0,1]."""


def decided(detector: Detector, image: Tensor) -> Tensor:
    """The likelihood of a detection, below .5 where its mask is not."""
    detection = detector.detect(image)
    return torch.where(detection.mask, detection.likelihood, detection.likelihood.clamp_max(0.499))


def judges(folder: Path) -> dict[str, Judge]:
    """Our detectors and the networks of a folder, by name."""
    found: dict[str, Judge] = {}
    for name in OURS:
        detector = load_detector(name)
        found[name] = partial(decided, detector)
    sys.path.insert(0, str(folder))
    for file in sorted(folder.glob("*.py")):
        if "def road_probability" in file.read_text(encoding="utf-8"):
            judge = importlib.import_module(file.stem).road_probability
            found[file.stem] = lambda image, judge=judge: torch.from_numpy(judge(to_pixels(image)))
    return found


def scored(folder: Path, many: Path) -> dict[str, float]:
    """Records by name: ``peers.NAME.f_mask@CAMERA``, ``maxf``, the means over cameras, ``ms``."""
    found, dataset = judges(folder), open_dataset("folder", many)
    counts: dict[str, dict[str, RoadCounts]] = {name: {} for name in found}
    times: dict[str, list[float]] = {name: [] for name in found}
    for item in [item for item in dataset.items if item.group in CAMERAS]:
        image, truth = dataset.read(item)
        for name, judge in found.items():
            begun = perf_counter()
            likelihood = judge(image)
            times[name].append(perf_counter() - begun)
            seen = count_levels(likelihood.clamp(0, 1), truth.road, truth.valid)
            so_far = counts[name].get(str(item.group))
            counts[name][str(item.group)] = seen if so_far is None else so_far + seen
    values: dict[str, float] = {}
    for name, cameras in counts.items():
        rows = {
            camera: {"f_mask": float(f_measure(decisions_at(c, 0.5))), "maxf": float(max_f(c)[0])}
            for camera, c in cameras.items()
        }
        values[f"peers.{name}.ms"] = 1000 * median(times[name])
        for key in ("f_mask", "maxf"):
            f_of = {camera: row[key] for camera, row in rows.items()}
            values[f"peers.{name}.{key}"] = sum(f_of.values()) / len(f_of)
            values[f"peers.{name}.{key}.worst"] = min(f_of.values())
            values |= {f"peers.{name}.{key}@{camera}": f for camera, f in f_of.items()}
    rivals = [name for name in found if name not in OURS]
    for camera in CAMERAS:
        values[f"peers.best.f_mask@{camera}"] = max(
            values[f"peers.{name}.f_mask@{camera}"] for name in rivals
        )
    for name in OURS:
        behind = (
            values[f"peers.best.f_mask@{camera}"] - values[f"peers.{name}.f_mask@{camera}"]
            for camera in CAMERAS
        )
        values[f"peers.{name}.not_behind"] = sum(lead <= 0.01 for lead in behind)
    return values


def main() -> None:
    """Score, keep the records, print the means."""
    parser = argparse.ArgumentParser(description="Score supervised networks beside our detectors.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("many", type=Path)
    parser.add_argument("--out", type=Path, default=FIGURES / "peers.json")
    given = parser.parse_args()
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    values = scored(given.folder.resolve(), given.many)
    command = shlex.join(["python", "scripts/peers.py", "PEERS", "DATA/many"])
    kept = {key: values[key] for key in used() & set(values)}
    text = json.dumps({"command": command, "values": kept}, indent=0, sort_keys=True)
    given.out.write_text(f"{text}\n", encoding="utf-8")
    for name in sorted({key.split(".")[1].split("@")[0] for key in values} - {"best"}):
        f, maxf, ms = (values[f"peers.{name}.{key}"] for key in ("f_mask", "maxf", "ms"))
        print(f"{name:28} F {f:.3f} MaxF {maxf:.3f} {ms:.0f} ms")
    print({name: values[f"peers.{name}.not_behind"] for name in OURS}, "cameras not behind by .01")


if __name__ == "__main__":
    main()
