"""Score supervised networks beside our detectors on the same images: docs/figures/peers.json.

    python scripts/peers.py FOLDER DATA/many --leave-out india_zed

FOLDER holds a file NAME.py a network, with ``road_probability(rgb uint8 (H, W, 3)) -> float32
(H, W)``, and what it needs (such as onnxruntime). Every image is shown to all of them in turn, on
one thread: F of the mask at .5 and MaxF by camera, and the median milliseconds. They measure;
nothing here ever learns from what they say. Records of networks that FOLDER lacks stay.
"""

import importlib
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import fmean, median
from time import perf_counter

import cv2
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch import RoadtorchError, load_detector
from roadtorch.base.image import to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, leave_out
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.metrics import RoadCounts, confusion_at, count_levels, f_measure, max_f
from scripts.readme_figures import keep_records, records

DETECTORS = ("fusion", "fusion:large")

Predict = Callable[[Tensor], Tensor]
"""An image (3, H, W) in [0,1] → how road-like each pixel is, (H, W) in [0,1]."""


def likelihood_of(detector: Detector, image: Tensor) -> Tensor:
    """Return the likelihood of a detection, below .5 where its mask is not."""
    detection = detector.detect(image)
    return torch.where(detection.mask, detection.likelihood, detection.likelihood.clamp_max(0.499))


def load_networks(folder: Path) -> dict[str, Predict]:
    """Load the networks of a folder, by name."""
    networks: dict[str, Predict] = {}
    sys.path.insert(0, str(folder))
    for file in sorted(folder.glob("*.py")):
        if "def road_probability" in file.read_text(encoding="utf-8"):
            predict = importlib.import_module(file.stem).road_probability
            networks[file.stem] = lambda image, predict=predict: torch.from_numpy(
                predict(to_pixels(image))
            )
    return networks


def score(networks: Mapping[str, Predict], dataset: Dataset) -> dict[str, float]:
    """Return records ``peers.NAME.f_mask@CAMERA``, ``maxf``, their means and worst, ``ms``."""
    counts: dict[str, dict[str, RoadCounts]] = {name: {} for name in networks}
    times: dict[str, list[float]] = {name: [] for name in networks}
    for item in (item for item in dataset.items if item.group not in dataset.left_out):
        image, truth = dataset.read(item)
        for name, predict in networks.items():
            start = perf_counter()
            likelihood = predict(image).clamp(0, 1)
            times[name].append(1000 * (perf_counter() - start))
            levels = count_levels(likelihood, truth.road, truth.valid)
            camera, cameras = str(item.group or "all"), counts[name]
            cameras[camera] = cameras[camera] + levels if camera in cameras else levels
    values: dict[str, float] = {}
    for name, cameras in counts.items():
        prefix = f"peers.{name}"
        values[f"{prefix}.ms"] = median(times[name])
        f_mask = {camera: float(f_measure(confusion_at(c, 0.5))) for camera, c in cameras.items()}
        maxf = {camera: float(max_f(c)[0]) for camera, c in cameras.items()}
        for key, f_of in {"f_mask": f_mask, "maxf": maxf}.items():
            values |= {f"{prefix}.{key}": fmean(f_of.values())}
            values |= {f"{prefix}.{key}.worst": min(f_of.values())}
            values |= {f"{prefix}.{key}@{camera}": f for camera, f in f_of.items()}
    return values


def main(words: Sequence[str] | None = None) -> None:
    """Score the networks of a folder beside our detectors."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("many", type=Path)
    parser.add_argument("--leave-out", nargs="*", default=[], metavar="CAMERA")
    options = parser.parse_intermixed_args(words)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        dataset = leave_out(open_dataset("folder", options.many), options.leave_out)
        networks: dict[str, Predict] = {
            name: partial(likelihood_of, load_detector(name)) for name in DETECTORS
        }
        networks |= load_networks(options.folder.resolve())
        values = score(networks, dataset)
    except RoadtorchError as error:
        sys.exit(f"peers.py: error: {error}")
    left_out = ["--leave-out", *options.leave_out] if options.leave_out else []
    command = " ".join(["python scripts/peers.py PEERS DATA/many", *left_out])
    earlier = {key: f for key, f in records().items() if key.startswith("peers.")}
    keep_records("peers", command, earlier | values)
    for name in networks:
        keys = ("f_mask", "f_mask.worst", "maxf", "ms")
        figures = (values[f"peers.{name}.{key}"] for key in keys)
        print("{:28} F {:.3f} worst {:.3f} MaxF {:.3f} {:.0f} ms".format(name, *figures))


if __name__ == "__main__":
    main()
