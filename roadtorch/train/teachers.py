"""Who labels whole pictures: detectors, and from the second round on the last network too. Ours."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError
from roadtorch.imaging.resize import resized
from roadtorch.io.atomic import make_folder
from roadtorch.layout.normalisation import normalise
from roadtorch.layout.picture_network import PictureNetwork, potentials_of
from roadtorch.road.ego import continued
from roadtorch.train.arrays import Arrays, from_bytes, read_arrays, to_bytes, write_arrays
from roadtorch.train.config import PictureTraining, Teacher
from roadtorch.train.loop import RunContext

ACROSS, LEAST_EGO = 0.95, 0.03
"""Shares of the columns and of the picture that an ego car takes which is cut out."""


def prepare_picture(
    image: Tensor, ego: Tensor | None, teachers: Sequence[Detector], training: PictureTraining
) -> Arrays:
    """What training needs of an image (3,H,W), at the network's size.

    ego: bool (H,W), the ego car that the footage shows; the teachers see the ground continued
    in its place. None where nothing is known.

    image: uint8 (3,h,w). maps: uint8 (4,h,w), what the teacher says: sky, vertical,
    horizontal, road, as 255ths. ego: uint8 (h,w): 255 ego, 0 not, 128 unknown. Raises
    ConfigError for a teacher without a layout.
    """
    size = (training.network.height, training.network.width)
    seen = image if ego is None else continued(image, ego)
    maps = teacher_maps(seen, teachers, training.teacher.views)
    known = torch.full(size, 0.5) if ego is None else resized(ego[None].float(), size)[0]
    return {
        "image": to_bytes(resized(image, size).clamp(0, 1)),
        "maps": to_bytes(resized(maps, size).clamp(0, 1)),
        "ego": to_bytes(known.clamp(0, 1)),
    }


def lends_ego(file: Path) -> bool:
    """Whether a prepared picture is known to show a whole ego car, from one side to the other.

    A small piece may as well be a lane mark or a reflection that stays.
    """
    ego = read_arrays(file, "ego")["ego"] == 255
    across = float(ego.any(0).double().mean())
    return across >= ACROSS and float(ego.double().mean()) >= LEAST_EGO


def load_teachers(teacher: Teacher) -> list[Detector]:
    """The detectors that make the labels together: one, or one for each size.

    Raises ConfigError for a wrong name or a detector without a working size.
    """
    sizes = [teacher.working.pixels]
    if teacher.views == "scaled":
        sizes.append(teacher.working.pixels // 2)
    own: dict[str, Any] = {"weights": {"file": teacher.weights}} if teacher.weights else {}
    return [load_detector(teacher.detector, working={"pixels": size}, **own) for size in sizes]


def teacher_maps(image: Tensor, teachers: Sequence[Detector], views: str = "one") -> Tensor:
    """Layout and road (4,H,W) in [0,1] of an image (3,H,W): the mean over all teachers.

    views: "one", or another word for the mean with the mirror image.
    """
    found = [_look(teacher, image) for teacher in teachers]
    if views != "one":
        found += [_look(teacher, image.flip(-1)).flip(-1) for teacher in teachers]
    return torch.stack(found).mean(0)


def _look(teacher: Detector, image: Tensor) -> Tensor:
    found = teacher.detect(image)
    if "layout" not in found.cues:
        what = f"{teacher.name} has no layout among its cues"
        raise ConfigError("teacher.detector", what, "use fusion or labeller")
    return torch.cat([found.cues["layout"], found.likelihood[None]])


def label_with_network(
    files: Sequence[Path], folder: Path, network: PictureNetwork, context: RunContext
) -> list[Path]:
    """What a network says of prepared pictures, the mean with their mirror images, on disk.

    One file a picture, in the order of ``files``; those that exist are kept. Stops early
    when asked to.
    """
    processes = context.processes
    names = [folder / f"{number:06d}.npz" for number in range(len(files))]
    make_folder(folder)
    pairs = processes.share(list(zip(files, names, strict=True)))
    hidden = processes.hides_bar(context.quiet)
    for file, name in tqdm(pairs, "labels again", unit="image", disable=hidden, file=sys.stderr):
        if context.stop.asked:
            break
        if not name.exists():
            image = from_bytes(read_arrays(file, "image")["image"])
            write_arrays(name, {"maps": to_bytes(network_maps(network, image))})
    processes.gather(None)  # nobody reads before all have written
    return names


@torch.no_grad()
def network_maps(network: PictureNetwork, image: Tensor) -> Tensor:
    """Potentials (5,h,w) in [0,1] of an image (3,h,w): the mean with its mirror image."""
    pixels = normalise(image, network.settings.normalisation).pixels
    found = potentials_of(network(torch.stack([pixels, pixels.flip(-1)])))
    return resized((found[0] + found[1].flip(-1)) / 2, (image.shape[-2], image.shape[-1]))
