"""Whether a file says what Python says."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from roadtorch.export.exportable import Reference
from roadtorch.io.image import from_pixels, to_pixels
from roadtorch.scenes.street import render_scene

BOUND = 1e-4
"""How far a file may be off. Ours: a fortieth of the step between two grey levels."""

SIZES = ((48, 64), (121, 317), (360, 480))
"""Height and width of the rendered pictures on which it is tried: below the network's size, above
it, and above the size at which detectors think."""

Run = Callable[[np.ndarray], Mapping[str, np.ndarray]]
"""Pictures uint8 (N,H,W,3) RGB → maps by name, by a runtime that has read a file."""


@dataclass(frozen=True)
class Parity:
    """How far a file is off what Python says: ``most`` anywhere, ``mean`` over all pixels.

    where: the output, and the size of the picture, with the most. pictures: how many were tried.
    """

    most: float
    mean: float
    where: str
    pictures: int


def rendered_batches() -> Iterator[np.ndarray]:
    """Pictures uint8 (2,H,W,3) RGB, by day and at dusk, of each of ``SIZES``."""
    for seed, (height, width) in enumerate(SIZES):
        scenes = (render_scene(seed, height, width, dusk=dusk) for dusk in (0.0, 0.9))
        yield np.stack([to_pixels(scene.image) for scene in scenes])


def parity(run: Run, reference: Reference, batches: Iterable[np.ndarray]) -> Parity:
    """How far ``run`` is off the reference on batches of pictures uint8 (N,H,W,3), at least one."""
    seen = [one for batch in batches for one in _differences(run(batch), reference, batch)]
    most, where = max((float(apart.max()), where) for where, apart in seen)
    pixels = sum(apart.numel() for _, apart in seen)
    mean = sum(float(apart.double().sum()) for _, apart in seen) / pixels
    outputs = len({where.split()[0] for where, _ in seen})
    return Parity(most, mean, where, len(seen) // outputs)


def _differences(
    found: Mapping[str, np.ndarray], reference: Reference, batch: np.ndarray
) -> Iterator[tuple[str, Tensor]]:
    """For each picture and output: name and size, and how far it is off; NaN is endless."""
    for at, pixels in enumerate(batch):
        wanted = reference(from_pixels(pixels))
        height, width = pixels.shape[:2]
        for name, maps in found.items():
            apart = (torch.from_numpy(maps[at]) - wanted[name]).abs()
            yield f"{name} at {width}×{height}", apart.nan_to_num(torch.inf)
