"""P2, Figs. 3 and 4a: networks of different patches and kernels, by accuracy and by time.

A small version, some minutes on one core: seven networks for P2's fifteen, each trained once on a
fifth of the free images as ``configs/cnn7.toml`` says but for one epoch, one patch a superpixel and
batches of 32: 32 thousand patches where P2 has 4.8 million. It compares networks with one another,
not with P2's. (P2's fifteen at four times the patches: train/README.md at 0ee65af.)

P2 prints the ranges that its networks are from, and the size of CNN-7 alone; the others are ours
from the same ranges, under its names.
"""

import shutil
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from roadtorch.base.settings import merge, read_settings_file
from roadtorch.data.catalogue import open_dataset
from roadtorch.evaluation.methods import contender_from_name
from roadtorch.evaluation.uncertainty import percentile_interval
from roadtorch.imaging.resize import resize_maps
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.labeller import HorizonSettings, label_at_image_size
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.train.config import build_training
from roadtorch.train.run import TrainingRequest, train
from scripts.figures.chart import chart, show_table
from scripts.figures.counting import count_images, observe, replicate, with_interval
from scripts.figures.p2_layout import MEANS, PRINTED_MEAN, TEACHER
from scripts.figures.sheets import read_streets

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "cnn7.toml"

TOPOLOGIES: Mapping[str, Topology] = {
    "CNN-2": Topology(k1=6, k2=50),
    "CNN-4": Topology(k1=6, k2=60, size2=9, size3=5, connections=3),
    "CNN-7": Topology(),
    "CNN-8": Topology(patch=48, size1=9, subsamplings=2),
    "CNN-9": Topology(patch=48, k1=6, k2=60, size2=13, size3=9),
    "CNN-11": Topology(patch=48, k2=10, size1=5, size2=13, size3=5, subsamplings=2, connections=2),
    "CNN-14": Topology(patch=64, k2=10, size1=5, size2=13, size3=9, subsamplings=2),
}
"""By name, from the smallest patch to the largest."""

PRINTED = {
    "CNN-2": "4.83 / 0.48",
    "CNN-7": "1.96 / 0.21",
    "CNN-9": "3.56 / 0.36",
    "CNN-11": "0.58 / 0.06",
    "CNN-14": "1.68 / 0.17",
    TEACHER: "47.6 / 6.49",
}
"""P2, Fig. 4a: seconds an image at ``SIZES``; that of Hoiem et al. beside our labeller."""

SIZES = ((720, 960), (240, 320))
"""Height and width of P2's "1/1" and "1/3" resolution."""

IMAGES = "*[07].jpg"  # names of the free images to learn from
BATCH = 32
OMITTED = {"input", "pooling", "potentials"}
COLUMNS = tuple(Topology().model_dump(exclude=OMITTED))
EVERY = 16  # step between images of CamVid's training split, on which P2 validates
ROUNDS = 3


def train_network(topology: Topology, data: Path, out: Path, name: str) -> Path:
    """Train a network in OUT/name, or resume; returns its weights."""
    changes = {
        "network": {"topology": topology.model_dump()},
        "centres": {"extra": 0},
        "descent": {"batch": BATCH},
        "stopping": {"epochs": 1},
    }
    training = build_training(merge(read_settings_file(CONFIG), changes))
    images = str(data / "unlabelled_free" / IMAGES)
    outcome = train(training, TrainingRequest(images, out / name, out / "prepared", quiet=True))
    if outcome.weights is None:
        raise InterruptedError(f"{name} is trained in part")
    return outcome.weights


def fig3(data: Path, out: Path) -> None:
    """Write P2's Fig. 3: the accuracy of networks of three patch sizes, and of their teacher."""
    kept = out / "p2-fig3-networks"
    contenders = [contender_from_name(TEACHER, {})]
    for name, topology in TOPOLOGIES.items():
        weights = train_network(topology, data, kept, name)
        network = contender_from_name("layout:cnn-7", {"weights": {"file": str(weights)}})
        contenders.append(replace(network, name=name))
    split = open_dataset("camvid", data / "camvid", "train")
    split = replace(split, items=split.items[::EVERY])
    *_, (_, tallies) = count_images(split, contenders, kept / "counts")
    rows, accuracies = [], {}
    for name, tally in tallies.items():
        counts, drawn = observe(tally).pooled, replicate(tally).pooled
        network = TOPOLOGIES[name].model_dump(exclude=OMITTED) if name in TOPOLOGIES else {}
        scores = {title: (mean(counts), mean(drawn)) for title, mean in MEANS.items()}
        means = {title: with_interval(*score) for title, score in scores.items()}
        rows.append({"network": name, **dict.fromkeys(COLUMNS, ""), **network, **means})
        value, replicates = scores[PRINTED_MEAN]
        accuracies[name] = [float(value), *percentile_interval(replicates)]
    show_table(out / "p2-fig3.csv", rows)
    draw_accuracies(accuracies, out / "p2-fig3.png")
    shutil.rmtree(kept)


def draw_accuracies(accuracies: Mapping[str, Sequence[float]], path: Path) -> None:
    """Draw the accuracy of each network with its interval, grouped by patch size."""
    names = list(TOPOLOGIES)
    patches = [TOPOLOGIES[name].patch for name in names]
    with chart(path, 5.5, 2.8) as figure:
        axes = figure.subplots()
        teacher, low, high = accuracies[TEACHER]
        axes.axhspan(low, high, color="0.9")
        axes.axhline(teacher, linestyle=":", color="0.4", label=TEACHER)
        for patch in sorted(set(patches)):
            places = [place for place, size in enumerate(patches) if size == patch]
            values = np.array([accuracies[names[place]] for place in places])
            ends = np.abs(values[:, 1:] - values[:, :1]).T
            axes.errorbar(places, values[:, 0], ends, fmt="o", label=f"{patch}×{patch}")
        axes.set_xticks(range(len(names)), names)
        axes.set(ylabel=PRINTED_MEAN)
        axes.legend(ncols=4)


def fig4a(data: Path, out: Path) -> None:
    """Write P2's Fig. 4a: seconds an image of each network and of the teacher, on one core."""
    image, superpixels = read_streets(data)[0].image, Superpixels()
    seconds: dict[str, list[str]] = {name: [] for name in (*TOPOLOGIES, TEACHER)}
    for size in SIZES:
        scaled = resize_maps(image, size).clamp(0, 1)
        works: dict[str, Callable[[], object]] = {
            name: partial(PatchNetwork(PatchNetworkSettings(topology=topology)).potentials, scaled)
            for name, topology in TOPOLOGIES.items()
        }
        works[TEACHER] = partial(label_at_image_size, scaled, HorizonSettings(), superpixels)
        for name, median in median_seconds(works).items():
            seconds[name].append(f"{median:.3f}")
    rows = [
        {"network": name, "s at 960×720": full, "s at 320×240": third, "P2": PRINTED.get(name, "")}
        for name, (full, third) in seconds.items()
    ]
    show_table(out / "p2-fig4a.csv", rows)


@torch.inference_mode()
def median_seconds(works: Mapping[str, Callable[[], object]]) -> dict[str, float]:
    """Return the median processor time of each piece of work; the rounds are interleaved."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(ROUNDS + 1):
        for name, work in works.items():
            start = time.process_time()
            work()
            seconds[name].append(time.process_time() - start)
    torch.set_num_threads(threads)
    return {name: statistics.median(times[1:]) for name, times in seconds.items()}  # 1 to warm up
