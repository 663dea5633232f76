"""How far a network says what its teacher says, on prepared pictures. Ours."""

from collections.abc import Sequence
from pathlib import Path

import torch

from roadtorch.evaluation.adaptation import Agreement
from roadtorch.layout.classes import CLASSES
from roadtorch.layout.picture_network import ROAD, PictureNetwork
from roadtorch.train.arrays import from_bytes, read_arrays
from roadtorch.train.config import PictureTraining
from roadtorch.train.targets import targets_of
from roadtorch.train.teachers import network_maps


def teacher_agreement(
    network: PictureNetwork, files: Sequence[Path], training: PictureTraining
) -> Agreement:
    """The agreement of a network with the teacher's maps in prepared pictures, pixels pooled.

    Where the teacher is sure is decided as in training (``targets_of``): by its margins, off the
    ego car. Raises InputError for a damaged file; a share of no pixel is NaN.
    """
    same, known = torch.zeros(2, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    for file in files:
        arrays = read_arrays(file, "image", "maps", "ego")
        image, maps, ego = (from_bytes(arrays[name]) for name in ("image", "maps", "ego"))
        targets = targets_of(maps[None], ego[None, None], None, training.teacher, training.rounds)
        said = network_maps(network, image)[None]
        layout = said[:, :CLASSES].argmax(1) == targets.layout.argmax(1)
        road = (said[:, ROAD] >= 0.5) == (targets.road[:, 0] >= 0.5)
        where = torch.stack([targets.layout_weight[:, 0], targets.road_weight[:, 0]]) > 0
        same += (torch.stack([layout, road]) & where).flatten(1).sum(1)
        known += where.flatten(1).sum(1)
    shares = same / known
    return Agreement(float(shares[0]), float(shares[1]), len(files))
