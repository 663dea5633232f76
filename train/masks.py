"""Score what masks bring: `fusion` as it ships, fine-tuned on masks, and LRASPP trained on them.

    python -m train.masks DATA --out MASKS [--sets camvid idd ycor] [--counts 20 0 5 100]
    python -m train.masks DATA --out MASKS --table docs/research/masks.csv

DATA holds many/, camvid/ and idd_lite/. Two drives of CamVid are labelled and the third is scored;
of each other set one half of the images, in the order of their names, is labelled and the other
one is scored. The labelled images are evenly spaced, one draw. LRASPP has random initial weights,
the same batches and the processor time that fine-tuning took. The mean of the masks ignores the
image. A cell that MASKS has is kept; --set changes the settings of configs/masks.toml.
"""

import argparse
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from roadtorch import load_detector
from roadtorch.base.settings import find_config, merge, parse_assignments, read_settings_file
from roadtorch.base.signals import stop_on_signals
from roadtorch.base.vision import import_torchvision
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, subsample_dataset
from roadtorch.data.masks import Mask
from roadtorch.evaluation.methods import resize_map, road_frequencies
from roadtorch.evaluation.metrics import ConfusionCounts, count_mask, f_measure
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    percentile_interval,
    pooled_f,
    sample_weights,
)
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.inputs.images import find_images
from roadtorch.run.memo import Arrays, read_cached, write_cached
from roadtorch.train.config import ImageTraining, build_training
from roadtorch.train.corrections import corrections_by_image, write_corrections
from roadtorch.train.run import TrainingRequest, prepare_folder, train
from roadtorch.train.training_loop import Batch, TrainingInputs
from roadtorch.train.whole_images import ImageRecipe
from train.claim_scores import format_row, read_csv, write_csv

SETS = ("camvid", "idd", "ycor", "dn_cityscapes", "dn_makassar")
COUNTS = (20, 0, 5, 100)
"""Numbers of labelled images, in the order of work; 0 stands for all."""

MAX_SCORED = 60
"""Images of a fold that are scored, evenly spaced."""

SHIPPED, TUNED, LRASPP, MEAN = "fusion", "fine-tuned", "lraspp", "mean of the masks"

LRASPP_RATE = 0.002
MEAN_LEVEL, DEVIATION = 0.45, 0.225  # of ImageNet


class Fold(NamedTuple):
    """A labelled part and a scored part of a set."""

    name: str
    labelled: Dataset
    scored: Dataset


# --- folds ------------------------------------------------------------------------------


def open_folds(name: str, root: Path) -> Iterator[Fold]:
    """Yield the folds of a set: the drives of CamVid, or the halves of another set."""
    kinds = {"camvid": ("camvid", "camvid"), "idd": ("idd-lite", "idd_lite")}
    kind, folder = kinds.get(name, ("folder", "many"))
    dataset = open_dataset(kind, root / folder)
    items = [item for item in dataset.items if kind != "folder" or item.group == name]
    halves = ["first half" if row < len(items) // 2 else "second half" for row in range(len(items))]
    parts = [str(item.group) for item in items] if name == "camvid" else halves
    for part in dict.fromkeys(parts):
        labelled, scored = (
            tuple(item for item, own in zip(items, parts, strict=True) if (own == part) == chosen)
            for chosen in (False, True)
        )
        sample = subsample_dataset(replace(dataset, items=scored), MAX_SCORED)
        yield Fold(part, replace(dataset, items=labelled), sample)


# --- methods ----------------------------------------------------------------------------

Predict = Callable[[Tensor], Tensor]
"""Image (3, H, W) in [0, 1] → mask bool (H, W)."""


def load_fusion(weights: str = "") -> Predict:
    """Load `fusion` with some weights."""
    detector = load_detector("fusion", weights={"file": weights})
    return lambda image: detector.detect(image).mask


def mean_mask(labelled: Dataset) -> Predict:
    """Return the mean of the masks."""
    items = tuple(replace(item, group=None) for item in labelled.items)
    mean = road_frequencies(replace(labelled, items=items))[""]
    return lambda image: resize_map(mean, spatial_size(image)) >= 0.5


def train_lraspp(samples: Callable[[int], Batch], seconds: float) -> Predict:
    """Train LRASPP on batches by their number, for some seconds of processor time."""
    torch.manual_seed(0)
    segmentation = import_torchvision().models.segmentation
    network = segmentation.lraspp_mobilenet_v3_large(
        weights=None, weights_backbone=None, num_classes=1
    )
    for layer in network.modules():
        if isinstance(layer, nn.BatchNorm2d):
            layer.momentum = 0.1  # of torch; torchvision's 0.01 needs hundreds of steps
    optimizer = torch.optim.AdamW(network.parameters(), LRASPP_RATE)
    start, step, progress = time.process_time(), 0, 0.0
    while progress < 1:
        for group in optimizer.param_groups:
            group["lr"] = LRASPP_RATE * (1 + np.cos(np.pi * progress)) / 2
        batch = samples(step)
        scores = network((batch.inputs - MEAN_LEVEL) / DEVIATION)["out"]
        road, weight = batch.targets[:, 4:5], batch.targets[:, 5:6]
        loss = F.binary_cross_entropy_with_logits(scores, road, weight)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        step, progress = step + 1, (time.process_time() - start) / seconds
    network.eval()
    size = spatial_size(batch.inputs)

    @torch.no_grad()
    def predict(image: Tensor) -> Tensor:
        small = (resize_maps(image, size) - MEAN_LEVEL) / DEVIATION
        return resize_maps(network(small[None])["out"][0], spatial_size(image))[0] >= 0

    return predict


def train_both(
    training: ImageTraining, labels: Sequence[Mask], work: Path, prepared: Path
) -> Iterator[tuple[str, float, Predict]]:
    """Yield the trained methods with the seconds of training."""
    folder = work / "images"
    folder.mkdir(parents=True, exist_ok=True)
    for label in labels:
        if not (link := folder / label.image.name).exists():
            link.symlink_to(label.image.resolve())
    images, recipe = find_images([str(folder)]), ImageRecipe(training)
    with stop_on_signals() as stop:
        items = prepare_folder(recipe, images, prepared, stop, quiet=True)
        by_name, _ = corrections_by_image(images, labels)
        human = {item.file: by_name[item.name] for item in items if item.file}
        corrected = write_corrections(work / "labels", human, recipe.encode_correction)
        inputs = TrainingInputs(list(human), corrected, None, work)
        samples = recipe.make_samples(inputs, stop, quiet=True)
    start = time.process_time()
    weights = train(
        training, TrainingRequest(str(folder), work / "run", prepared, True, labels)
    ).weights
    seconds = time.process_time() - start
    yield TUNED, seconds, load_fusion(str(weights))

    def batch(step: int) -> Batch:
        return next(samples.batches(*divmod(step, samples.chunks)))

    yield LRASPP, seconds, train_lraspp(batch, seconds)


# --- cells ------------------------------------------------------------------------------


def count_masks(dataset: Dataset, predict: Predict) -> Tensor:
    """Count the masks of all images, (n, 4) as in ``ConfusionCounts``."""
    rows = []
    for item in dataset.items:
        image, truth = dataset.read(item)
        rows.append(torch.stack(count_mask(predict(image), truth.road, truth.valid)))
    return torch.stack(rows)


def cell_file(out: Path, name: str, fold: str, count: int, method: str) -> Path:
    """Return the file of a cell's counts."""
    return out / "cells" / f"{name} {fold} {count} {method}.npz".replace(" ", "_")


def fill_cells(options: argparse.Namespace) -> None:
    """Score the cells that are missing: of each count the first halves, then the second ones."""
    values = merge(read_settings_file(find_config("masks")), parse_assignments(options.set))
    training = build_training(values)
    assert isinstance(training, ImageTraining)
    folds = [
        (number * (name != "camvid"), name, fold)
        for name in options.sets
        for number, fold in enumerate(open_folds(name, options.data))
    ]
    for count in options.counts:
        for _, name, fold in sorted(folds, key=lambda entry: entry[0]):
            fill_cell(training, name, fold, count, options.out)


def fill_cell(training: ImageTraining, name: str, fold: Fold, count: int, out: Path) -> None:
    """Score all methods with a number of labelled images, unless there are fewer."""
    labelled = subsample_dataset(fold.labelled, count or None)
    file = partial(cell_file, out, name, fold.name)
    if len(labelled.items) < count or file(count, LRASPP).exists():
        return
    save = partial(save_cell, fold.scored, len(labelled.items))
    if not file(0, SHIPPED).exists():
        save(file(0, SHIPPED), 0.0, load_fusion())
        save(file(0, MEAN), 0.0, mean_mask(fold.labelled))
    labels = [
        Mask(item.image, partial(read_numbers, labelled, item), (1,), (255,))
        for item in labelled.items
    ]
    work = out / "work" / f"{name} {fold.name} {count}".replace(" ", "_")
    for method, seconds, predict in train_both(training, labels, work, out / "prepared" / name):
        save(file(count, method), seconds, predict)


def read_numbers(dataset: Dataset, item: LabelledItem) -> np.ndarray:
    """Read the true road of an item: 0, 1, void 255, shape (H, W)."""
    truth = dataset.truth(item)
    return truth.road.to(torch.uint8).masked_fill_(~truth.valid, 255).numpy()


def save_cell(scored: Dataset, labelled: int, file: Path, seconds: float, predict: Predict) -> None:
    """Score a method and keep its counts."""
    counts = count_masks(scored, predict)
    numbers = torch.tensor([labelled, seconds])
    write_cached(file, file.stem, {"counts": counts, "numbers": numbers})
    score = float(f_measure(ConfusionCounts(*counts.sum(0))))
    print(f"{file.stem}: F {score:.4f}, {labelled} labelled, {seconds:.0f} s", flush=True)


# --- table ------------------------------------------------------------------------------


def write_table(out: Path, root: Path, sets: Sequence[str], path: Path) -> None:
    """Write a row for each set and number of labelled images of which all folds are scored.

    F is the mean over the folds; an interval is of a difference, with 1,000 draws of the scored
    images of each fold.
    """
    rows = []
    for name in sets:
        names = [fold.name for fold in open_folds(name, root)]
        for count in (5, 20, 100, 0):
            folds = []
            for fold in names:
                counts = {SHIPPED: 0, MEAN: 0, TUNED: count, LRASPP: count}
                files = {key: cell_file(out, name, fold, counts[key], key) for key in counts}
                cells = {key: read_cached(file, None) for key, file in files.items()}
                folds.append({key: cell for key, cell in cells.items() if cell is not None})
            if all(len(cells) == 4 for cells in folds):
                rows.append({"set": name, **format_folds(folds)})
    write_csv(path, rows)


def format_folds(folds: Sequence[Mapping[str, Arrays]]) -> dict[str, str]:
    """Format the scores of the methods, given the content of their cells in each fold."""
    generator = torch.Generator().manual_seed(BOOTSTRAP_SEED)
    scores: dict[str, list[Tensor]] = {}
    for cells in folds:
        weights = sample_weights(("",) * len(cells[SHIPPED]["counts"]), generator)
        for method, cell in cells.items():
            scores.setdefault(method, []).append(pooled_f(cell["counts"], weights))
    means = {method: torch.stack(values).mean(0) for method, values in scores.items()}
    numbers = torch.stack([cells[TUNED]["numbers"] for cells in folds])
    row = {
        "folds": str(len(folds)),
        "labelled": " ".join(dict.fromkeys(f"{number:.0f}" for number in numbers[:, 0])),
        "scored": str(sum(len(cells[SHIPPED]["counts"]) for cells in folds)),
        "seconds": f"{numbers[:, 1].mean():.0f}",
        **{method: f"{values[0]:.3f}" for method, values in means.items()},
    }
    for reference in (SHIPPED, LRASPP):
        change = means[TUNED] - means[reference]
        interval = percentile_interval(change[1:])
        row[f"{TUNED} - {reference}"] = f"{change[0]:+.3f}"
        row[f"{TUNED} - {reference}, 95 %"] = f"{interval.low:+.3f} to {interval.high:+.3f}"
    return row


def page_rows(path: Path) -> Iterator[str]:
    """Yield the rows of the page's table."""
    for row in read_csv(path):
        cells = [row["set"], row["labelled"]]
        cells += [row[method] for method in (MEAN, LRASPP, SHIPPED, TUNED)]
        change = row[f"{TUNED} - {SHIPPED}"], row[f"{TUNED} - {SHIPPED}, 95 %"]
        yield format_row(*cells, "{} ({})".format(*change))


def main() -> None:
    """Fill the cells, or write the table of those that are there."""
    parser = argparse.ArgumentParser(description="Score what masks bring.")
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sets", nargs="*", default=SETS)
    parser.add_argument("--counts", nargs="*", type=int, default=COUNTS)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.table:
        write_table(options.out, options.data, options.sets, options.table)
        print("\n".join(page_rows(options.table)))
    else:
        fill_cells(options)


if __name__ == "__main__":
    main()
