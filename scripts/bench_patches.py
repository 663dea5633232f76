"""Patches per second: all patches of a picture in one pass, against a plain DataLoader.

    python scripts/bench_patches.py
    python scripts/bench_patches.py --images FOLDER --pictures 16 --rounds 10 --workers 2

Both make the same patches: same sites, scales, angles, noise and normalisation, batches of
128, shuffled. The plain loader takes them one by one, as a Dataset with ``__getitem__`` does;
it gets its pictures decoded, labelled and in memory, ours reads them from disk as in training.
Rounds are interleaved; figures are medians, the ratio is the median of the rounds' ratios.
"""

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the rendered scenes

from roadtorch.errors import RoadtorchError
from roadtorch.io.image import read_image
from roadtorch.layout.normalisation import normalise
from roadtorch.scenes.street import render_scene
from roadtorch.sources.pictures import find_images
from roadtorch.train.config import PatchTraining
from roadtorch.train.patches import PatchSamples, cut_patches, draw_jitter, prepare_patches
from roadtorch.train.prepared import from_bytes, read_arrays, write_arrays
from roadtorch.train.processes import Processes

TRAINING = PatchTraining(passes=1)
PLAIN = "plain DataLoader"
OURS = "in one pass"


class PatchByPatch(Dataset[tuple[Tensor, Tensor]]):
    """The patches of prepared pictures, one at a time."""

    def __init__(self, files: list[Path]) -> None:
        arrays = [read_arrays(file) for file in files]
        how = TRAINING.network.normalisation
        self.pictures = [normalise(from_bytes(values["image"]), how) for values in arrays]
        self.items = [
            (number, site, int(label))
            for number, values in enumerate(arrays)
            for site, label in zip(values["sites"], values["classes"], strict=True)
        ]

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> tuple[Tensor, Tensor]:
        number, site, label = self.items[index]
        pixels, gain = self.pictures[number]
        generator = torch.default_generator
        draw = draw_jitter(site[None], TRAINING.jitter, generator)
        patch = cut_patches(pixels, draw, TRAINING.network.topology.patch)[0]
        noise = torch.randn(patch.shape, generator=generator)
        return patch + noise * (draw.noise[0] * gain / 255), torch.tensor(label)


def prepare(images: str | None, pictures: int, folder: Path) -> list[Path]:
    """Prepared pictures: of a folder, or rendered streets."""
    files = []
    found = find_images([images])[:pictures] if images else range(pictures)
    for number, item in enumerate(tqdm(found, "labels", leave=False, file=sys.stderr)):
        image = render_scene(number).image if isinstance(item, int) else read_image(item.path)
        files.append(folder / f"{number}.npz")
        write_arrays(files[-1], prepare_patches(image, TRAINING))
    return files


def patches_per_second(work: Callable[[], int]) -> float:
    start = time.perf_counter()
    count = work()
    return count / (time.perf_counter() - start)


def contestants(files: list[Path], workers: int) -> dict[str, Callable[[], int]]:
    """Work that makes every patch of the pictures once and returns how many there were."""
    batch = TRAINING.descent.batch
    loader = DataLoader(PatchByPatch(files), batch, shuffle=True, num_workers=workers)
    samples = PatchSamples(files, TRAINING, Processes())

    def plain() -> int:
        return sum(len(inputs) for inputs, _ in loader)

    def ours() -> int:
        return sum(
            len(batch.inputs)
            for chunk in range(samples.chunks)
            for batch in samples.batches(0, chunk)
        )

    return {PLAIN: plain, OURS: ours}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--images", help="folder of pictures (default: rendered streets)")
    parser.add_argument("--pictures", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--workers", type=int, default=0, help="processes of the plain loader")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    with tempfile.TemporaryDirectory() as folder:
        try:
            files = prepare(given.images, given.pictures, Path(folder))
        except RoadtorchError as problem:
            parser.error(str(problem))
        works = contestants(files, given.workers)
        works[OURS]()  # once, to warm up
        rounds = [
            {name: patches_per_second(work) for name, work in works.items()}
            for _ in tqdm(range(given.rounds), "rounds", leave=False, file=sys.stderr)
        ]
    print("| patches per second | median | fastest |\n|---|---:|---:|")
    for name in works:
        speeds = [times[name] for times in rounds]
        print(f"| {name} | {statistics.median(speeds):.0f} | {max(speeds):.0f} |")
    ratios = [times[OURS] / times[PLAIN] for times in rounds]
    print(f"| ratio | {statistics.median(ratios):.1f} | {max(ratios):.1f} |")


if __name__ == "__main__":
    main()
