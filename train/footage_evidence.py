"""How right what footage knows of its road is, each teacher alone; labels score, nothing else.

python train/footage_evidence.py DATA DRIVES: CamVid's val split in DATA/camvid, and drives through
rendered worlds (``python -m train.worlds --frames 60``) in DRIVES. A line a footage: the share of
the path's weight that is road, and of the road it covers; F at 0.5 of fusion alone, steadied
forwards, and of the likelihood of all frames; how often that is right where it is sure.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch import load_detector, read_image
from roadtorch.adapt.evidence import footage_evidence
from roadtorch.data.labels import read_labels
from roadtorch.road.steady import Steady, SteadySettings

WIDTH = 160


def footages(data: Path, drives: Path) -> Iterator[tuple[str, list[Path], list[Path], int, int]]:
    """Name, pictures, labels, the number of road and that of void."""
    pictures = sorted((data / "camvid/val").glob("*.jpg"))
    labels = [data / "camvid/valannot" / f"{one.stem}.png" for one in pictures]
    yield "CamVid val", pictures, labels, 3, 11
    for drive in sorted(drives.iterdir()):
        pictures = sorted((drive / "images").glob("*.jpg"))
        labels = [drive / "masks" / f"{one.stem}.png" for one in pictures]
        if len(pictures) >= 60 and labels[-1].exists():
            yield drive.name, pictures, labels, 255, 128


def small(plane: Tensor) -> Tensor:
    """A plane (H,W) at the size of the maps, averaged."""
    size = (round(plane.shape[0] * WIDTH / plane.shape[1]), WIDTH)
    return F.adaptive_avg_pool2d(plane[None].to(torch.float32), size)[0]


def f_measure(said: list[Tensor], road: list[Tensor], counted: list[Tensor]) -> float:
    """F at 0.5 over all frames together."""
    mask, truth = (torch.stack(maps) > 0.5 for maps in (said, road))
    weight = torch.stack(counted)
    both = (weight * (mask & truth)).sum()
    return float(2 * both / ((weight * mask).sum() + (weight * truth).sum()))


def main() -> None:
    detector = load_detector("fusion")
    print(
        "footage: path precision, coverage; F alone, forward, all; right where sure, share; words"
    )
    for name, pictures, labels, is_road, is_void in footages(*map(Path, sys.argv[1:3])):
        images = [read_image(path) for path in pictures]
        alone = [small(detector.detect(image).likelihood) for image in images]
        truth = [torch.from_numpy(read_labels(path).astype(np.uint8)) for path in labels]
        road = [small(one == is_road) for one in truth]
        counted = [small(one != is_void) for one in truth]
        steady = Steady(SteadySettings())
        forward = [steady(image, one) for image, one in zip(images, alone, strict=True)]
        found = footage_evidence(images, alone)
        path = torch.stack([one["path"].weight for one in found.teachers])
        time = [one["time"].road for one in found.teachers]
        sure = torch.stack([one["time"].weight for one in found.teachers]) > 0.8
        roads, counts = torch.stack(road), torch.stack(counted)
        right = (torch.stack(time) > 0.5) == (roads > 0.5)
        numbers = [
            float((path * roads * counts).sum() / (path * counts).sum().clamp_min(1e-9)),
            float(((path > 0.3) * roads * counts).sum() / (roads * counts).sum()),
            *(f_measure(said, road, counted) for said in (alone, forward, time)),
            float((right * sure * counts).sum() / (sure * counts).sum().clamp_min(1e-9)),
            float(sure.to(torch.float32).mean()),
        ]
        print(f"{name}:", *(f"{number:.4f}" for number in numbers), found.words, flush=True)


if __name__ == "__main__":
    main()
