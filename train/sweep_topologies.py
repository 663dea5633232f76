"""P2, Figs. 3 and 4a: 15 topologies of patch networks, in colour and in grey, by accuracy and time.

    python train/sweep_topologies.py PICTURES CAMVID --out runs/sweep

About 40 minutes on two cores; started again, it goes on where it was. Every network learns from
the same machine labels, as --config says but shortened, the same for all: every third picture,
one patch for each superpixel (at its centroid), one epoch in batches of 32. That is about 120
thousand patches where P2 has 4.8 million: it compares topologies with one another, not with P2.

The score is P2's "global average accuracy" on CamVid's training split, on which P2 validates
(section 6.1): recalls of the three classes, pooled over pictures, void being vertical as in
P2's sentence; beside it the same with void ignored, and by drives. The labeller, which teaches,
is scored and timed likewise. Times are of one core, as the process counts them (so that other
work on the machine stays out), medians over interleaved rounds, for every pixel of 960×720 and of
320×240.

Writes topologies.csv, topologies.md and topologies.png to --out.
"""

import argparse
import multiprocessing
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the recipes beside

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.errors import RoadtorchError
from roadtorch.evaluation import metrics
from roadtorch.imaging.resize import resized
from roadtorch.io.image import read_image
from roadtorch.layout.labeller import LabellerSettings, label_layout, label_whole
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.layout.weights import load_network, read_origin, save_network
from roadtorch.runtime.signals import Stop
from roadtorch.sources.pictures import find_images
from roadtorch.superpixels.slic import Superpixels
from roadtorch.train.config import PatchTraining, as_values, read_training
from roadtorch.train.patches import PatchRecipe
from roadtorch.train.prepared import Arrays, PreparedFolder, read_arrays, write_arrays
from roadtorch.train.processes import Processes
from train.patch_study import train_patches
from train.topologies import P2_TOPOLOGIES, on_grey
from train.topology_table import LABELLER, SIZES, Studied, write_table

EPOCHS, BATCH, SITES_AROUND = 1, 32, 0
"""How training is shortened."""


class Job(NamedTuple):
    """One network to train on prepared files, and to score."""

    name: str
    training: PatchTraining
    files: Sequence[Path]
    dataset: Dataset
    out: Path

    @property
    def weights(self) -> Path:
        """Where its network is kept."""
        return self.out / f"{self.name}.safetensors"

    @property
    def scores(self) -> Path:
        """Where its confusions are kept, by drive."""
        return self.out / f"{self.name}.npz"


def shortened(training: PatchTraining, topology: Topology) -> PatchTraining:
    """A training as it is in this study: the same for all but for the topology."""
    descent = training.descent.model_copy(update={"batch": BATCH})
    network = training.network.model_copy(update={"topology": topology})
    sites = training.sites.model_copy(update={"around": SITES_AROUND})
    changes = {"network": network, "sites": sites, "descent": descent, "passes": 1}
    return training.model_copy(update=changes)


def family(names: Sequence[str]) -> dict[str, Topology]:
    """The networks to study by name, those of the costliest training first, grey beside colour."""
    chosen = {name: P2_TOPOLOGIES[name] for name in names}
    first = sorted(chosen, key=lambda name: -training_cost(chosen[name]))
    return {
        f"{name}{suffix}": topology
        for name in first
        for suffix, topology in (("", chosen[name]), (" grey", on_grey(chosen[name])))
    }


def training_cost(topology: Topology) -> int:
    """Multiplications of one patch in the second layer, which outweighs the others."""
    side = (topology.patch - topology.size1 + 1) // 2 - topology.size2 + 1
    return side**2 * topology.k1 * topology.k2 * topology.size2**2


def run(job: Job) -> str:
    """Train and score one network, or what is left of that."""
    torch.set_num_threads(1)
    if not job.weights.exists():
        start = time.process_time()
        network, errors, patches = train_patches(job.files, job.training, EPOCHS)
        made = {"config": as_values(job.training), "patches": sum(patches), "error": errors[-1]}
        save_network(job.weights, network, made | {"seconds": time.process_time() - start})
    if not job.scores.exists():
        network = load_network(job.weights)
        looked = confusions(job.dataset, lambda image: network.cues(image)["layout"])
        write_arrays(job.scores, looked)
    return job.name


def confusions(dataset: Dataset, layout: Callable[[Tensor], Tensor]) -> Arrays:
    """By drive, the confusion int64 (4,4) of potentials (3,H,W) with the truth."""
    found: Arrays = {}
    for item in dataset.items:
        image, truth = dataset.read(item)
        assert truth.layout is not None
        counts = metrics.count_layout(layout(image).argmax(0), truth.layout)
        drive = item.group or dataset.name
        found[drive] = found.get(drive, torch.zeros_like(counts)) + counts
    return found


def timed(works: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Median seconds of each piece of work, by name; the rounds are interleaved."""
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in tqdm(range(rounds + 1), "times", disable=None):
        for name, work in works.items():
            start = time.process_time()
            work()
            seconds[name].append(time.process_time() - start)
    return {name: statistics.median(own[1:]) for name, own in seconds.items()}  # one to warm up


@torch.no_grad()
def picture_times(topologies: Mapping[str, Topology], image: Tensor, rounds: int) -> Arrays:
    """By name, seconds a picture (2,) at ``SIZES``, of networks and of the labeller."""
    networks = {
        name: PatchNetwork(PatchNetworkSettings(topology=topology)).eval()
        for name, topology in topologies.items()
    }
    own, cut = LabellerSettings(), Superpixels()
    by_size = []
    for size in SIZES:
        picture = resized(image, size).clamp(0, 1)
        works: dict[str, Callable[[], object]] = {
            name: lambda network=network, picture=picture: network.potentials(picture)
            for name, network in networks.items()
        }
        works[LABELLER] = lambda picture=picture: label_whole(picture, own, cut)
        by_size.append(timed(works, rounds))
    return {name: torch.tensor([times[name] for times in by_size]) for name in by_size[0]}


def kept_times(
    chosen: argparse.Namespace, topologies: Mapping[str, Topology], image: Tensor
) -> Arrays:
    """The times of all networks, measured together, anew where some were not there."""
    path = chosen.out / "times.npz"
    if not path.exists() or not topologies.keys() <= read_arrays(path).keys():
        write_arrays(path, picture_times(topologies, image, chosen.rounds))
    return read_arrays(path)


def prepared_files(chosen: argparse.Namespace, training: PatchTraining) -> list[Path]:
    """Every so-manieth picture made ready, once for all networks.

    ConfigError for a folder that holds a sweep with other choices.
    """
    recipe = PatchRecipe(training)
    folder = PreparedFolder(chosen.out / "prepared", Processes(), Stop())
    every = {"every": chosen.every, "score_every": chosen.score_every}
    folder.claim({"training": as_values(training), **every})
    pictures = find_images([chosen.pictures], apart=chosen.out)[:: chosen.every]
    made = folder.prepare(pictures, recipe.make, "labels")
    return [item.file for item in made if item.file is not None]


def studied(job: Job, times: Arrays) -> Studied:
    """What became of one network."""
    origin = read_origin(job.weights)
    return Studied(
        job.name,
        job.training.network.topology,
        origin["patches"],
        origin["error"],
        read_arrays(job.scores),
        times[job.name],
    )


def sweep(chosen: argparse.Namespace) -> None:
    """Everything in order; each step looks first whether it is done."""
    base = read_training(chosen.config)
    assert isinstance(base, PatchTraining), "give the config of a patch network"
    split = open_dataset("camvid", chosen.camvid, "train")
    dataset = every_kth(split, len(split.items) // chosen.score_every)
    topologies = family(chosen.only or tuple(P2_TOPOLOGIES))
    files = prepared_files(chosen, shortened(base, Topology()))
    jobs = [
        Job(name, shortened(base, topology), files, dataset, chosen.out)
        for name, topology in topologies.items()
    ]
    with ProcessPoolExecutor(chosen.jobs, multiprocessing.get_context("spawn")) as pool:
        for name in tqdm(pool.map(run, jobs), "networks", len(jobs), disable=None):
            tqdm.write(f"{name}: done", file=sys.stderr)
    teacher = chosen.out / f"{LABELLER}.npz"
    if not teacher.exists():
        found = confusions(dataset, lambda image: label_layout(image, base.labeller).potentials)
        write_arrays(teacher, found)
    times = kept_times(chosen, topologies, read_image(dataset.items[0].image))
    rows = {job.name: studied(job, times) for job in jobs}
    write_table(rows, (read_arrays(teacher), times[LABELLER]), chosen.out)


def main() -> None:
    parser = argparse.ArgumentParser(description="P2's family of networks by accuracy and time.")
    parser.add_argument("pictures", help="folder of street pictures without labels")
    parser.add_argument("camvid", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--config", type=Path, default=Path("configs/cnn7.toml"))
    parser.add_argument("--every", type=int, default=3, help="learn from every so-manieth picture")
    parser.add_argument("--score-every", type=int, default=4, help="the same for the score")
    parser.add_argument("--rounds", type=int, default=5, help="of the times")
    parser.add_argument("--jobs", type=int, default=2, help="networks trained at a time")
    parser.add_argument("--only", nargs="+", choices=tuple(P2_TOPOLOGIES), metavar="CNN-N")
    torch.set_num_threads(1)
    try:
        sweep(parser.parse_args())
    except RoadtorchError as problem:
        parser.error(str(problem))


if __name__ == "__main__":
    main()
