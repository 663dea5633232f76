"""Score supervised networks beside our detectors on the same images: docs/figures/peers.json.

    python scripts/peers.py FOLDER DATA/many --leave-out india_zed
    python scripts/peers.py DATA/many --onnx FILE --road 0 --size 512x1024 \\
        --mean 123.675 116.28 103.53 --scale 58.395 57.12 57.375

FOLDER holds a file NAME.py a network, with ``road_probability(rgb uint8 (H, W, 3)) -> float32
(H, W)``, and what it needs (such as onnxruntime). FILE is a network of one image (1, 3, H, W),
RGB, (levels of 0 to 255 - mean) / scale, by default 0 to 1; its first output is a class map or
scores (1, C, h, w). Every image is shown to all of them in turn, on one thread: F of the mask at .5
and MaxF by camera, and the median milliseconds. They measure; nothing here ever learns from what
they say. Records of networks that FOLDER lacks stay; of an ONNX file nothing is recorded.
"""

import importlib
import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import fmean, median
from time import perf_counter

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch import RoadtorchError, load_detector
from roadtorch.base.errors import ConfigError, WeightsError
from roadtorch.base.image import to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, leave_out
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.metrics import RoadCounts, confusion_at, count_levels, f_measure, max_f
from scripts.readme_figures import keep_records, records

DETECTORS = ("fusion", "fusion:large")

ONNX_HINT = "one image (1, 3, H, W) of --size in, a class map or scores (1, C, h, w) out"

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


def load_onnx(path: Path, options: Namespace) -> Predict:
    """Load a network; ConfigError without onnxruntime, WeightsError for files of another kind."""
    try:
        import onnxruntime

        settings = onnxruntime.SessionOptions()
        settings.log_severity_level, settings.intra_op_num_threads = 4, 1
        session = onnxruntime.InferenceSession(path, settings, providers=["CPUExecutionProvider"])
        (entry,) = session.get_inputs()
        sizes = zip(entry.shape[2:], options.size or [0, 0], strict=True)
        sides = [side if isinstance(side, int) else size for side, size in sizes]
        if 0 in sides or entry.type != "tensor(float)" or options.size not in (None, sides):
            raise ValueError(f"takes {entry.type} {entry.shape}")

        def predict(image: Tensor) -> Tensor:
            pixels = cv2.resize(to_pixels(image), sides[::-1]).astype(np.float32)
            levels = ((pixels - options.mean) / options.scale).transpose(2, 0, 1)[None]
            output = np.asarray(session.run(None, {entry.name: levels.astype(np.float32)})[0])
            likelihood = road_likelihood(output, options.road, sides)
            return F.interpolate(likelihood[None, None], image.shape[1:], mode="bilinear")[0, 0]

        predict(torch.zeros(3, *sides))
    except ImportError as error:
        raise ConfigError("--onnx", str(error), "pip install 'roadtorch[onnx]'") from None
    except Exception as error:  # those of onnxruntime have no class in common
        raise WeightsError(path, str(error).partition("\n")[0], ONNX_HINT) from None
    return predict


def road_likelihood(output: np.ndarray, road: list[int], sides: list[int]) -> Tensor:
    """Return how road-like pixels are, float32 (h, w): .5 or more where the best class is road.

    ValueError for an output that is no map of an image of these sides, or lacks a class of road.
    """
    *_, rows, columns = 0, 0, *output.shape
    is_map = abs(rows * sides[1] - columns * sides[0]) <= 2 * max(sides)  # up to rounding
    if is_map and output.dtype.kind in "iu" and output.size == rows * columns:
        return torch.from_numpy(np.isin(output.reshape(rows, columns), road)).float()
    is_scores = is_map and output.ndim == 4 and len(output) == 1
    if not is_scores or output.shape[1] <= max(len(road), *road):
        raise ValueError(f"gives {output.dtype} {list(output.shape)}")
    scores = torch.from_numpy(output[0]).float()
    background = [index for index in range(len(scores)) if index not in road]
    return (scores[road].amax(0) - scores[background].amax(0)).sigmoid()


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
    """Score the networks of a folder, or one of an ONNX file, beside our detectors."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("many", type=Path)
    parser.add_argument("--leave-out", nargs="*", default=[], metavar="CAMERA")
    parser.add_argument("--onnx", type=Path, metavar="FILE")
    parser.add_argument("--road", type=int, nargs="+", default=[0], help="classes of the network")
    parser.add_argument("--size", type=lambda text: [*map(int, text.split("x"))], metavar="HxW")
    for name, default in (("--mean", 0.0), ("--scale", 255.0)):
        parser.add_argument(name, type=float, nargs=3, default=[default] * 3, metavar="LEVEL")
    options = parser.parse_intermixed_args(words)
    if (options.folder is None) == (options.onnx is None):
        parser.error("give a FOLDER of networks or --onnx FILE")
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    try:
        dataset = leave_out(open_dataset("folder", options.many), options.leave_out)
        networks: dict[str, Predict] = {
            name: partial(likelihood_of, load_detector(name)) for name in DETECTORS
        }
        if options.onnx:
            networks[options.onnx.stem] = load_onnx(options.onnx, options)
        else:
            networks |= load_networks(options.folder.resolve())
        values = score(networks, dataset)
    except RoadtorchError as error:
        sys.exit(f"peers.py: error: {error}")
    if options.folder:
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
