"""The ceiling of CNN-7: the same network, trained on the true labels of the other two drives.

    python train/ceiling.py configs/cnn7.toml ../shared/data/camvid --out runs/ceiling --epochs 4

Patches, jitter, error and descent are those of the config; only the classes of the patches come
from people. Void has no class. Each drive is scored with a network that never saw it. This is a
measure, not a way to train: what it makes is not label-free and is never shipped.
"""

import argparse
import sys
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the recipes beside

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, Item
from roadtorch.evaluation import metrics
from roadtorch.imaging.resize import at_work
from roadtorch.io.atomic import make_folder
from roadtorch.layout.classes import CLASSES, UNLABELLED
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import save_network
from roadtorch.train.config import PatchTraining, read_training
from roadtorch.train.patches import find_sites
from roadtorch.train.prepared import to_bytes, write_arrays
from train.patch_study import train_patches


def prepare(dataset: Dataset, item: Item, training: PatchTraining, path: Path) -> None:
    """What ``prepare_patches`` keeps of a picture, with the true classes of its sites."""
    image, truth = dataset.read(item)
    assert truth.layout is not None
    small = at_work(image, training.network.working)
    sites = find_sites(training.superpixels.cut(small), training.sites)
    (height, width), (rows, columns) = small.shape[-2:], truth.layout.shape
    classes = truth.layout[sites[:, 0] * rows // height, sites[:, 1] * columns // width]
    known = classes != UNLABELLED
    arrays = {"image": to_bytes(small), "sites": sites[known].to(torch.int16)}
    write_arrays(path, {**arrays, "classes": classes[known].to(torch.uint8)})


def recalls(network: PatchNetwork, dataset: Dataset, items: list[Item]) -> Tensor:
    """Recall of sky, vertical, horizontal over pictures; void ignored."""
    confusion = torch.zeros((CLASSES + 1, CLASSES + 1), dtype=torch.int64)
    for item in items:
        image, truth = dataset.read(item)
        assert truth.layout is not None
        confusion += metrics.count_layout(network.cues(image)["layout"].argmax(0), truth.layout)
    return metrics.class_recalls(confusion)


def main() -> None:
    parser = argparse.ArgumentParser(description="CNN-7 on true labels, one drive left out.")
    parser.add_argument("config", type=Path)
    parser.add_argument("camvid", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--every", type=int, default=1, help="score every so-manieth picture")
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    training = read_training(chosen.config)
    assert isinstance(training, PatchTraining), "give the config of a patch network"
    dataset = open_dataset("camvid", chosen.camvid)
    make_folder(chosen.out)
    files = {item: chosen.out / f"{item.name}.npz" for item in dataset.items}
    for item, file in tqdm(files.items(), "truth", disable=None):
        if not file.exists():
            prepare(dataset, item, training, file)
    means = []
    for drive in dataset.groups():
        others = [file for item, file in files.items() if item.group != drive]
        network, errors, _ = train_patches(others, training, chosen.epochs)
        for epoch, error in enumerate(errors, 1):
            print(f"epoch {epoch}: error {error:.4f}", flush=True)
        save_network(chosen.out / f"{drive}.safetensors", network, {"trained on": "true labels"})
        held = [item for item in dataset.items if item.group == drive][:: chosen.every]
        found = recalls(network, dataset, held)
        means.append(float(found.mean()))
        each = "/".join(f"{value:.3f}" for value in found.tolist())
        print(f"{drive}: sky/vertical/horizontal {each}, mean {means[-1]:.3f}", flush=True)
    print(f"mean over the drives {sum(means) / len(means):.3f}")


if __name__ == "__main__":
    main()
