"""How well networks find the ego car, where no label by people says it.

    python -m train.compare_ego_heads TRUTH PICTURES WEIGHTS...

Two tables for each of the weights. Against the truth of rendered pictures (TRUTH, as
``train.rendered_ego_cars`` writes it, of numbers that no training saw): how many with an ego car
are found (intersection over union above a half), how many without one are taken to show one.
Against another network (``--like layout``) on PICTURES, which nothing is learned from: the same.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch import read_image
from roadtorch.imaging.resize import resized
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import load_network, weights_path
from roadtorch.road.ego import ego_found
from roadtorch.train.prepared import from_bytes, read_arrays

SIZE = (120, 160)
"""At which ego cars are compared."""

LEAST = 0.02
"""Share of the picture from which one counts."""


class Tally(NamedTuple):
    """Of one network: pictures with an ego car, found, mean IoU; without one, shown one."""

    shown: int
    found: int
    iou: float
    free: int
    false: int


def network_named(name: str) -> PictureNetwork:
    """A network for whole pictures, by file or by the name of shipped weights."""
    network = load_network(weights_path(name))
    if not isinstance(network, PictureNetwork):
        raise SystemExit(f"{name}: is no network for whole pictures")
    return network.eval()


def ego_in(network: PictureNetwork, image: Tensor) -> Tensor:
    """Where a network finds the ego car in an image (3,H,W), bool of SIZE."""
    found = ego_found(network.cues(image)["ego"])
    return resized(found[None].float(), SIZE)[0] > 0.5


def tally(pairs: Iterator[tuple[Tensor, Tensor]]) -> Tally:
    """Of pairs (true, found) of ego cars, bool of one size each."""
    ious, free, false = [], 0, 0
    for true, found in pairs:
        if float(true.double().mean()) >= LEAST:
            ious.append(float((true & found).sum()) / float((true | found).sum()))
        elif not true.any():
            free += 1
            false += bool(found.double().mean() >= LEAST)
    good = sum(iou > 0.5 for iou in ious)
    return Tally(len(ious), good, sum(ious) / max(1, len(ious)), free, false)


def rendered(truth: Path, network: PictureNetwork) -> Iterator[tuple[Tensor, Tensor]]:
    """True and found ego cars of rendered pictures."""
    for path in sorted(truth.glob("*.npz")):
        arrays = read_arrays(path, "image", "ego")
        yield arrays["ego"] == 255, ego_in(network, from_bytes(arrays["image"]))


def alike(
    pictures: Path, like: PictureNetwork, network: PictureNetwork
) -> Iterator[tuple[Tensor, Tensor]]:
    """Ego cars by two networks."""
    for path in sorted(pictures.glob("*.jpg")):
        image = read_image(path)
        yield ego_in(like, image), ego_in(network, image)


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare how networks find the ego car.")
    parser.add_argument("truth", type=Path)
    parser.add_argument("pictures", type=Path)
    parser.add_argument("weights", nargs="+")
    parser.add_argument("--like", default="layout")
    given = parser.parse_args()
    torch.set_num_threads(1)
    like = network_named(given.like)
    for name in given.weights:
        network = network_named(name)
        print(name)
        print("  rendered:", tally(rendered(given.truth, network)))
        print(f"  like {given.like}:", tally(alike(given.pictures, like, network)))


if __name__ == "__main__":
    main()
