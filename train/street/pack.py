"""Pack images with their labels into one file, from which ``train.street`` learns.

    python -m train.street.pack label DATA/unlabelled_free --out LABELS    # resumable
    python -m train.street.pack pack DATA --labels LABELS --worlds WORLDS… --out PACK

Real images (directly in unlabelled_free/, not those of also_in_many/) get machine labels: the mean
of `fusion:large`, appearance included, over two network sizes and mirrored. Rendered images of
``train.worlds`` and DATA/simulated have the renderer's truth. No label by people has a part.
"""

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F
from tqdm import tqdm

from roadtorch import load_detector, read_image
from roadtorch.base.atomic import atomic_write
from roadtorch.imaging.resize import resize_maps
from roadtorch.layout.classes import NUM_CLASSES, VERTICAL
from roadtorch.layout.image_network import compute_cues
from roadtorch.layout.weights import resize_network
from roadtorch.road.bayes import log_odds
from roadtorch.train.prepared import to_uint8
from train.worlds.truth import EGO, ROAD, THIN, VOID

SIZE = (288, 384)
"""Height and width of the packed images; most worlds are rendered at it."""

LABEL_SIZE = (144, 192)
"""Height and width of machine labels, the finest at which a loss is computed."""

TEACHER_SIZES = ((192, 256), (256, 352))
"""Sizes of the teacher's networks; its likelihoods are averaged."""

LEVELS = 31
"""Levels of machine labels: PNG packs few levels into half the bytes."""

EGO_BOUNDS = (0.3, 0.7)
"""Ego car certainly not, certainly: between them it is unknown, as in ``train.second_teacher``."""

HELD = 9000
"""Remainder of 10,000 from which the number of a world keeps it out of training."""

REAL, SIMULATED, HELD_GROUP = "real", "simulated", "held"

NOT_ROAD = 5
"""Code beside those of ``train.worlds.truth``: not road, of no known layout."""


class Example(NamedTuple):
    """A packed image: its group, its name, and the bytes of its image and of its label."""

    group: str
    name: str
    image: bytes
    label: bytes


# --- machine labels ---------------------------------------------------------------------


class Teacher:
    """The mean of `fusion:large` over sizes of its networks, and mirrored."""

    def __init__(self) -> None:
        self._detector = load_detector("fusion:large")
        fusion: Any = self._detector.get_submodule("analysis")
        pairs = fusion.network, fusion.second
        self._networks = [
            [resize_network(network, *size) for network in pairs] for size in TEACHER_SIZES
        ]
        self._fusion = fusion

    def label(self, image: Tensor) -> Tensor:
        """Return sky, vertical, horizontal, road and ego car (5, h, w) of an image (3, H, W).

        The road is the geometric mean of the views' odds, so that one uncertain view does not
        outvote two certain ones.
        """
        layouts, roads, cars = [], [], []
        for pair in self._networks:
            self._fusion.network, self._fusion.second = pair
            for is_mirrored in (False, True):
                view = image.flip(-1) if is_mirrored else image
                detection = self._detector.detect(view)
                potential = compute_cues(pair[0], view)["ego"]
                maps = [detection.cues["layout"], detection.likelihood[None]]
                maps.append((detection.cues["ego"].float() + potential)[None] / 2)
                planes = torch.cat(maps)
                layout, road, car = (planes.flip(-1) if is_mirrored else planes).split(
                    [NUM_CLASSES, 1, 1]
                )
                layouts.append(layout)
                roads.append(log_odds(road))
                cars.append(car)
        road = torch.stack(roads).mean(0).sigmoid()
        return torch.cat([torch.stack(layouts).mean(0), road, torch.stack(cars).mean(0)])


def label(options: argparse.Namespace) -> None:
    """Write the machine labels of real images as PNG of four planes: sky, vertical, road, ego."""
    options.out.mkdir(parents=True, exist_ok=True)
    teacher = Teacher()
    for file in tqdm(sorted(options.images.glob("*.jpg")), disable=None):
        target = options.out / f"{file.stem}.png"
        if not target.exists():
            maps = resize_maps(teacher.label(read_image(file)), LABEL_SIZE).clamp(0, 1)
            with atomic_write(target) as temporary:
                temporary.write_bytes(encode_label(maps))


def encode_label(maps: Tensor) -> bytes:
    """Encode sky, vertical, horizontal, road and ego car (5, h, w) as PNG of four planes."""
    sky, vertical, _, road, car = maps
    low, high = EGO_BOUNDS
    ego = torch.where(car > high, 1.0, torch.where(car < low, 0.0, 0.5))
    planes = torch.stack([sky, vertical, road, ego])
    rounded = to_uint8((planes * LEVELS).round() / LEVELS).permute(1, 2, 0).numpy()
    return encode(".png", rounded, cv2.IMWRITE_PNG_COMPRESSION, 9)


def encode(suffix: str, pixels: np.ndarray, option: int, value: int) -> bytes:
    """Return the file of pixels uint8 (H, W, …)."""
    return cv2.imencode(suffix, pixels, [option, value])[1].tobytes()


# --- packing ----------------------------------------------------------------------------


def read_real(root: Path, labels: Path, quality: int) -> Iterator[Example]:
    """Yield the real images that have labels, at ``SIZE``."""
    for file in sorted(root.glob("*.jpg")):
        image = encode_image(file, quality)
        yield Example(REAL, file.stem, image, (labels / f"{file.stem}.png").read_bytes())


def encode_image(file: Path, quality: int) -> bytes:
    """Return an image as WebP at ``SIZE``, antialiased."""
    pixels = np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR))
    image = resize_maps(torch.from_numpy(pixels).permute(2, 0, 1).float(), SIZE)
    small = image.round().clamp(0, 255).byte().permute(1, 2, 0).numpy()
    return encode(".webp", small, cv2.IMWRITE_WEBP_QUALITY, quality)


def read_worlds(root: Path, quality: int, without: Sequence[str]) -> Iterator[Example]:
    """Yield the images of ``train.worlds``: as they were written, or larger ones at ``SIZE``.

    without: patterns of names to leave out, but for worlds that nothing learns from.
    """
    for file in sorted((root / "images").glob("*.jpg")):
        number = int(file.stem.partition("_")[0])
        group = HELD_GROUP if number % 10000 >= HELD else root.name
        truth = root / "truth" / f"{file.stem}.png"
        is_left_out = group != HELD_GROUP and any(fnmatch(file.stem, part) for part in without)
        if is_left_out or not truth.exists():
            continue
        image, label = file.read_bytes(), truth.read_bytes()
        code = np.asarray(cv2.imread(str(truth), cv2.IMREAD_UNCHANGED))
        if code.shape != SIZE:
            image = encode_image(file, quality)
            label = encode(".png", shrink_code(code), cv2.IMWRITE_PNG_COMPRESSION, 9)
        yield Example(group, file.stem, image, label)


def shrink_code(code: np.ndarray) -> np.ndarray:
    """Reduce a code of truth (H, W) to ``SIZE``.

    As in ``train.worlds.truth``, a pixel is vertical from a third on, otherwise what most of it is.
    """
    values = np.unique(code)
    planes = torch.stack([torch.from_numpy(code == value) for value in values]).float()
    fractions = resize_maps(planes, SIZE).numpy()
    largest = values[fractions.argmax(0)]
    is_vertical = (fractions * (values == VERTICAL)[:, None, None]).sum(0) >= THIN
    return np.where(is_vertical, np.uint8(VERTICAL), largest)


def read_simulated(root: Path, quality: int) -> Iterator[Example]:
    """Yield the images of DATA/simulated at ``SIZE``, their road and layout as one code."""
    for file in sorted((root / "simulated").glob("*/images/*.jpg")):
        paths = [file.parents[1] / part / f"{file.stem}.png" for part in ("road", "layout")]
        road, layout = (
            np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) if path.exists() else None
            for path in paths
        )
        assert road is not None
        code = np.full_like(road, NOT_ROAD)
        if layout is not None:
            code = np.where(layout == VOID, code, layout)
        code = np.where(road == 1, np.uint8(ROAD), np.where(road == VOID, np.uint8(VOID), code))
        code = cv2.resize(code, SIZE[::-1], interpolation=cv2.INTER_NEAREST)
        image = encode_image(file, quality)
        name = f"{file.parents[1].name}_{file.stem}"
        yield Example(SIMULATED, name, image, encode(".png", code, cv2.IMWRITE_PNG_COMPRESSION, 9))


def write_pack(path: Path, examples: Sequence[Example]) -> None:
    """Write examples as arrays of one file: names, groups, bytes and where each of them ends."""
    arrays: dict[str, np.ndarray] = {}
    for part in ("image", "label"):
        files = [getattr(example, part) for example in examples]
        arrays[f"{part}_bytes"] = np.frombuffer(b"".join(files), np.uint8)
        arrays[f"{part}_ends"] = np.cumsum([len(file) for file in files])
    for part in ("group", "name"):
        arrays[part] = np.array([getattr(example, part) for example in examples])
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]  # its stub's allow_pickle


def pack(options: argparse.Namespace) -> None:
    """Write all examples, and print how many of each group and how many bytes."""
    examples = [*read_real(options.data / "unlabelled_free", options.labels, options.quality)]
    for root in options.worlds:
        examples += read_worlds(root, options.quality, options.without)
    examples += read_simulated(options.data, options.quality)
    write_pack(options.out, examples)
    for group in sorted({example.group for example in examples}):
        part = [example for example in examples if example.group == group]
        image, truth = (sum(len(getattr(e, name)) for e in part) for name in ("image", "label"))
        print(f"{group}: {len(part)} images, {image / 2**20:.1f} MiB, labels {truth / 2**20:.1f}")


# --- worlds ---------------------------------------------------------------------------


def world_kind(name: str) -> str:
    """Return the tens of thousands, the kind and "night" of a world, of NUMBER_KIND_LIGHT."""
    number, kind, light = name.split("_")[:3]
    return f"{number[0]} {kind}" + " night" * (light == "night")


def obstacle_mask(road: Tensor, vertical: Tensor) -> Tensor:
    """Return where something vertical has road above and below it in its column, bool (H, W)."""
    above, below = road.cumsum(0) > 0, road.flip(0).cumsum(0).flip(0) > 0
    return vertical & above & below


# --- unpacking --------------------------------------------------------------------------


class Pack(NamedTuple):
    """Unpacked examples.

    images: uint8 (n, 3, *SIZE). maps: sky, vertical, horizontal, road, ego car in 255ths, uint8
    (n, 5, *SIZE). known: where layout, road and ego car are known, bool (n, 3, *SIZE).
    """

    groups: np.ndarray
    names: np.ndarray
    images: Tensor
    maps: Tensor
    known: Tensor


def read_pack(path: Path, workers: int = 16) -> Pack:
    """Read a pack into memory, decoded by threads."""
    with np.load(path) as arrays:
        file = {name: arrays[name] for name in arrays.files}
    parts = {
        part: np.split(file[f"{part}_bytes"], file[f"{part}_ends"][:-1])
        for part in ("image", "label")
    }
    groups, names = file["group"], file["name"]
    with ThreadPoolExecutor(workers) as threads:
        images = list(threads.map(partial(decode, flags=cv2.IMREAD_COLOR), parts["image"]))
        labels = threads.map(partial(decode, flags=cv2.IMREAD_UNCHANGED), parts["label"])
        decoded = list(threads.map(decode_label, labels, groups == SIMULATED))
    pixels = torch.from_numpy(np.stack(images)[..., ::-1].copy()).permute(0, 3, 1, 2)
    maps, known = map(torch.stack, zip(*decoded, strict=True))
    return Pack(groups, names, pixels.contiguous(), maps, known)


def decode(data: np.ndarray, flags: int) -> np.ndarray:
    """Return the pixels of a file's bytes."""
    return np.asarray(cv2.imdecode(data, flags))


def decode_label(pixels: np.ndarray, is_simulated: bool) -> tuple[Tensor, Tensor]:
    """Return maps uint8 (5, *SIZE) and where they are known, bool (3, *SIZE), of a label's pixels.

    pixels: four planes of ``encode_label``, or a code (H, W).
    """
    label = torch.from_numpy(np.ascontiguousarray(pixels))
    if label.ndim == 3:
        fine = F.interpolate(label.permute(2, 0, 1)[None].float(), SIZE, mode="bilinear")[0]
        sky, vertical, road, ego = fine
        maps = torch.stack([sky, vertical, (255 - sky - vertical).clamp_min(0), road, ego])
        certain = (ego < 64) | (ego > 191)
        return maps.round().byte(), torch.stack([ego < 191, torch.ones_like(certain), certain])
    is_ground = (label == 2) | (label == ROAD)
    maps = torch.stack([label == 0, label == 1, is_ground, label == ROAD, label == EGO])
    is_valid = label != VOID
    known = [is_valid & (label < EGO), is_valid, is_valid & (not is_simulated)]
    return maps.byte() * 255, torch.stack(known)


def main() -> None:
    """Run a command of this script."""
    parser = argparse.ArgumentParser(description="Pack images with their labels into one file.")
    commands = parser.add_subparsers(required=True)
    labelling = commands.add_parser("label")
    labelling.add_argument("images", type=Path)
    labelling.add_argument("--out", type=Path, required=True)
    labelling.set_defaults(run=label)
    packing = commands.add_parser("pack")
    packing.add_argument("data", type=Path)
    packing.add_argument("--labels", type=Path, required=True)
    packing.add_argument("--worlds", type=Path, nargs="*", default=[])
    packing.add_argument(
        "--without", nargs="*", default=[], metavar="PATTERN", help="names of worlds, as of files"
    )
    packing.add_argument("--quality", type=int, default=88, help="of resized images, as WebP")
    packing.add_argument("--out", type=Path, required=True)
    packing.set_defaults(run=pack)
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.run(options)


if __name__ == "__main__":
    main()
