"""Where patches are taken, and their machine labels. P2, section 3.1.

At the centroid of each superpixel and around it, where the labeller is certain.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.errors import InputError
from roadtorch.imaging.resize import at_work
from roadtorch.layout.classes import CLASSES, UNLABELLED
from roadtorch.layout.labeller import label_layout
from roadtorch.superpixels.statistics import segment_mean, segment_size
from roadtorch.train.arrays import Arrays, read_arrays, to_bytes
from roadtorch.train.config import PatchTraining, Sites


def prepare_patches(image: Tensor, training: PatchTraining) -> Arrays:
    """What patches need of an image (3,H,W): it at working size, sites and their classes.

    image: uint8 (3,h,w); sites: int16 (n,2), row and column; classes: uint8 (n,), 0, 1, 2.
    Sites that the labeller leaves in doubt are not there.
    """
    working = training.network.working
    small = at_work(image, working)
    labels = label_layout(small, training.labeller, working, training.superpixels).labels
    sites = find_sites(training.superpixels.cut(small), training.sites)
    classes = labels[sites[:, 0], sites[:, 1]]
    known = classes != UNLABELLED
    return {
        "image": to_bytes(small),
        "sites": sites[known].to(torch.int16),
        "classes": classes[known].to(torch.uint8),
    }


def find_sites(segments: Tensor, sites: Sites) -> Tensor:
    """Rows and columns int64 (n,2) of the centroids of segments (H,W) and places around them.

    ``sites.around`` places at equal angles, the first below the centroid, kept inside the
    picture.
    """
    height, width = segments.shape
    places = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    size = segment_size(segments, int(segments.max()) + 1)
    centroid = segment_mean(torch.stack(places).to(torch.float32), segments, size).T
    turns = torch.arange(sites.around) * (2 * math.pi / max(1, sites.around))
    around = torch.stack([turns.cos(), turns.sin()], 1) * sites.distance
    moves = torch.cat([torch.zeros(1, 2), around])
    found = (centroid[:, None] + moves).reshape(-1, 2).round().to(torch.int64)
    return found.clamp_min(0).minimum(torch.tensor([height - 1, width - 1]))


def class_weights(files: Sequence[Path], training: PatchTraining) -> Tensor:
    """Weight of each class, (3,): all 1, or such that all classes weigh the same.

    Raises InputError when no picture has a site with a label.
    """
    counts = torch.zeros(CLASSES)
    for file in files:
        classes = read_arrays(file, "classes")["classes"]
        counts += torch.bincount(classes.long(), minlength=CLASSES)
    if not counts.sum():
        what = "have no superpixel whose label is certain"
        raise InputError("the pictures", what, "lower labeller.margin, or give street pictures")
    if training.balance == "none":
        return torch.ones(CLASSES)
    return counts.sum() / (CLASSES * counts.clamp_min(1))
