"""Source images of a training, with a renderer's truth: worlds, and images of other simulators."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.base.errors import InputError
from roadtorch.imaging.resize import resize_maps
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import HORIZONTAL, NUM_CLASSES, SKY, VERTICAL
from roadtorch.run.memo import Arrays
from roadtorch.train.prepared import to_uint8
from roadtorch.train.targets import Targets

ROAD_CODE, EGO_CODE, NOT_ROAD_CODE = range(NUM_CLASSES, NUM_CLASSES + 3)
VOID_CODE = 255
"""Codes of truth after the layout's: road, ego car, not road of unknown layout, unknown."""

EGO_KNOWN = 0.25
"""Least distance of an ego value from 0.5, unknown, to count: values are interpolated by warps."""

THIN = 1 / 3
"""Fraction of a pixel from which a standing object is its truth: posts, legs and tyres are thin."""

HELD_OUT, NUMBERS = 9000, 10_000
"""Worlds whose number, modulo the second, is at least the first never train."""

WORLD = re.compile(r"(\d+)_([^_]+)_.+")
"""Name of a world: number, kind, light."""


@dataclass(frozen=True)
class SourceImage:
    """A source image, its kind, and the files of its truth.

    is_coded: whether ``truth`` has codes of everything, as worlds have, or road alone, to which
    ``layout`` may be added.
    """

    item: Item
    kind: str
    truth: Path
    is_coded: bool
    layout: Path | None = None

    @property
    def files(self) -> list[Path]:
        """Files on which a prepared image depends."""
        return [self.item.path, self.truth, *([self.layout] if self.layout else [])]


def find_source_images(folders: Sequence[Path]) -> list[SourceImage]:
    """Find the images of folders with truth, but for worlds that are held out.

    A folder holds ``images/`` and ``truth/`` (of ``train.worlds``), or ``images/``, ``road/`` and
    perhaps ``layout/``, or several folders that do. Names of items start with the folder's number.
    Raises InputError for any other folder.
    """
    parts = list[Path]()
    for root in folders:
        within = sorted(path.parent for path in root.glob("*/images"))
        parts += [root] if (root / "images").is_dir() else within
        if not ((root / "images").is_dir() or within):
            hint = "give folders with images/ and truth/, or images/ and road/"
            raise InputError(root, "holds no source images", hint)
    return [image for number, part in enumerate(parts) for image in _find_images(part, number)]


def _find_images(folder: Path, number: int) -> list[SourceImage]:
    images, is_coded = list[SourceImage](), (folder / "truth").is_dir()
    for item in find_images([folder / "images"]):
        name, kind, layout = f"{item.name}.png", folder.name, folder / "layout" / f"{item.name}.png"
        world = WORLD.fullmatch(Path(item.name).name) if is_coded else None
        if world:
            kind = world[2]
            if int(world[1]) % NUMBERS >= HELD_OUT:
                continue
        truth = folder / ("truth" if is_coded else "road") / name
        has_layout = not is_coded and layout.exists()
        named = replace(item, name=f"{number}/{item.name}")
        images.append(SourceImage(named, kind, truth, is_coded, layout if has_layout else None))
    return images


def read_truth(source: SourceImage) -> Tensor:
    """Read the truth of a source image as codes uint8 (H, W); InputError for a missing file."""
    if source.is_coded:
        return torch.from_numpy(_read_codes(source.truth, NOT_ROAD_CODE))
    codes = _read_codes(source.truth, 1)
    layout = np.full_like(codes, NOT_ROAD_CODE)
    if source.layout:
        classes = _read_codes(source.layout, NUM_CLASSES - 1)
        layout = np.where(classes == VOID_CODE, layout, classes)
    layout[codes == 1] = ROAD_CODE
    layout[codes == VOID_CODE] = VOID_CODE
    return torch.from_numpy(layout)


def _read_codes(path: Path, largest: int) -> np.ndarray:
    """Read codes uint8 (H, W), 0 to the largest or void; InputError for any other file."""
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if pixels is None or pixels.ndim != 2 or pixels.dtype != np.uint8:
        raise InputError(path, "is no truth of a source image", "give a grey PNG of codes")
    wrong = pixels[(pixels > largest) & (pixels != VOID_CODE)]
    if wrong.size:
        raise InputError(
            path, f"has the value {wrong[0]}", f"give 0 to {largest}, {VOID_CODE} void"
        )
    return np.asarray(pixels)


def reduce_truth(codes: Tensor, size: tuple[int, int]) -> Tensor:
    """Reduce codes uint8 (H, W) to a size: vertical from ``THIN`` of a pixel on, else what most is.

    Enlarging takes the same decision on interpolated fractions.
    """
    if codes.shape == size:
        return codes
    values = codes.unique()
    fractions = resize_maps(torch.stack([codes == value for value in values]).float(), size)
    largest = values[fractions.argmax(0)]
    upright = (fractions * (values == VERTICAL)[:, None, None]).sum(0) >= THIN
    return torch.where(upright, torch.tensor(VERTICAL, dtype=torch.uint8), largest)


def prepare_source(image: Tensor, source: SourceImage, size: tuple[int, int]) -> Arrays:
    """Return an image (3, H, W) at a size as uint8, its codes and its ego car.

    The ego car is 255 ego, 0 not, 128 unknown: only worlds know it.
    """
    codes = reduce_truth(read_truth(source), size)
    ego = torch.where((codes == VOID_CODE) | (not source.is_coded), 128, 255 * (codes == EGO_CODE))
    small = to_uint8(resize_maps(image, size).clamp(0, 1))
    return {"image": small, "codes": codes, "ego": ego.to(torch.uint8)}


def truth_targets(codes: Tensor, ego: Tensor) -> Targets:
    """Return targets of codes uint8 and the ego car in [0, 1], both (n, 1, H, W).

    What a truth does not know has weight 0: void, and layout on the ego car or where there is none.
    """
    road, knows_ego = codes == ROAD_CODE, (2 * ego - 1).abs() >= EGO_KNOWN
    layout = torch.cat([codes == SKY, codes == VERTICAL, (codes == HORIZONTAL) | road], 1)
    planes = layout, codes <= ROAD_CODE, road, codes != VOID_CODE, ego >= 0.5 + EGO_KNOWN, knows_ego
    return Targets(*(plane.to(ego) for plane in planes))
