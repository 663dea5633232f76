"""Compare trained layout networks on labelled pictures: mean class recall, differences, intervals.

    python train/compare_layouts.py ../shared/data runs/base/weights.safetensors \
        runs/other/weights.safetensors --every 2

The networks answer alone, without the labeller. The first one is what the others are compared
with, on the same pictures and the same draws of them. Void is ignored.
"""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, every_kth
from roadtorch.evaluation import metrics
from roadtorch.evaluation.uncertainty import (
    Replicated,
    difference,
    group_weights,
    interval,
    replicate,
)
from roadtorch.layout.weights import load_network
from roadtorch.report.table import align

SEED = 11  # of the draws


def confusions(dataset: Dataset, files: list[str]) -> dict[str, dict[str, Tensor]]:
    """By weight file and drive, the layout confusions (n,4,4) of its pictures."""
    networks = {file: load_network(file) for file in files}
    found: dict[str, dict[str, list[Tensor]]] = {file: {} for file in files}
    for item in tqdm(dataset.items, unit="image", disable=None):
        image, truth = dataset.read(item)
        assert truth.layout is not None
        for file, network in networks.items():
            counts = metrics.count_layout(network.cues(image)["layout"].argmax(0), truth.layout)
            found[file].setdefault(item.group or dataset.name, []).append(counts)
    return {
        file: {group: torch.stack(parts) for group, parts in groups.items()}
        for file, groups in found.items()
    }


def mean_recall(groups: list[Tensor], weights: list[Tensor]) -> Tensor:
    """Mean over drives of the mean class recall under weights (draws,n): (draws,)."""
    return torch.stack([drive_recall(one, w) for one, w in zip(groups, weights, strict=True)]).mean(
        0
    )


def drive_recall(counts: Tensor, weights: Tensor) -> Tensor:
    """Mean class recall of one drive's pictures (n,4,4) under weights (draws,n)."""
    flat = weights.to(torch.float64) @ counts.flatten(1).to(torch.float64)
    return metrics.mean_class_recall(flat.reshape(-1, *counts.shape[1:]))


def measured(groups: dict[str, Tensor]) -> Replicated:
    """The mean over drives, with its draws."""
    generator = torch.Generator().manual_seed(SEED)
    weights = group_weights([len(counts) for counts in groups.values()], generator)
    figure: Callable[[list[Tensor]], Tensor] = partial(mean_recall, list(groups.values()))
    return replicate(figure, weights)


def rows(found: dict[str, dict[str, Tensor]], files: list[str]) -> list[list[str]]:
    """A line for each file: recalls by drive, their mean, the difference with its interval."""
    base = measured(found[files[0]])
    lines = [["weights", *found[files[0]], "mean", "less the first", "95 %"]]
    for file in files:
        own = measured(found[file])
        each = [float(drive_recall(one, torch.ones(1, len(one)))) for one in found[file].values()]
        change = difference(own, base)
        low, high = interval(change)
        lines.append(
            [
                file,
                *(f"{value:.3f}" for value in each),
                f"{own.value:.4f}",
                f"{change.value:+.4f}",
                f"{low:+.4f} to {high:+.4f}",
            ]
        )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare layout networks.")
    parser.add_argument("data", type=Path, help="folder with camvid/ and idd_lite/")
    parser.add_argument("weights", nargs="+", help="weight files; the first is the reference")
    parser.add_argument("--every", type=int, default=1, help="look at every so-manieth picture")
    chosen = parser.parse_args()
    for name, folder in (("camvid", "camvid"), ("idd-lite", "idd_lite")):
        dataset = open_dataset(name, chosen.data / folder)
        dataset = every_kth(dataset, len(dataset.items) // chosen.every)
        print(align(rows(confusions(dataset, chosen.weights), chosen.weights)), end="\n\n")


if __name__ == "__main__":
    main()
