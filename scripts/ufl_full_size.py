"""Masks of ``ufl`` at full size: enlarged by themselves, and together with what ranks them.

    python scripts/ufl_full_size.py DATA

On every fifth frame of CamVid's validation split, pooled: F of the mask, MaxF, and by how many
pixels a picture the second way falls short of the first.
"""

import argparse
from pathlib import Path

from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detectors.ufl import ENTRIES, OriginalUflSettings, road_cues
from roadtorch.evaluation.metrics import count_levels, count_mask, f_measure, max_f
from roadtorch.imaging.resize import resized
from roadtorch.ufl.learned import learn_features
from roadtorch.ufl.preprocess import bicubic
from roadtorch.ufl.road import AS_CHOSEN, enlarged_likelihood

EVERY = 5


def both_ways(image: Tensor, likelihood: Tensor) -> dict[str, Tensor]:
    """A likelihood of the working size at that of its image (3,H,W), enlarged both ways."""
    size = (image.shape[1], image.shape[2])
    return {
        "by itself": enlarged_likelihood(likelihood, size),
        "smoothly": resized(likelihood, size),
    }


def tell(name: str, found: list[tuple[dict[str, Tensor], Truth]]) -> None:
    """Print a line for each way."""
    for way in ("by itself", "smoothly"):
        pairs = [(maps[way], truth) for maps, truth in found]
        masks = [count_mask(m >= AS_CHOSEN, t.road, t.valid) for m, t in pairs]
        levels = [count_levels(m, t.road, t.valid) for m, t in pairs]
        pixels = sum(int((m >= AS_CHOSEN).sum()) for m, _ in pairs) / len(pairs)
        f = float(f_measure(sum(masks[1:], masks[0])))
        best = float(max_f(sum(levels[1:], levels[0]))[0])
        print(f"{name:14} {way:10} F {f:.4f}  MaxF {best:.4f}  road {pixels:.0f} pixels a picture")


def main() -> None:
    parser = argparse.ArgumentParser(description="Masks of ufl at full size.")
    parser.add_argument("data", type=Path)
    frames = open_dataset("camvid", parser.parse_args().data / "camvid", "val")
    pictures = [frames.read(item) for item in frames.items[::EVERY]]
    for entry in ENTRIES:
        settings = entry.settings()
        assert isinstance(settings, OriginalUflSettings)
        found = []
        for image, truth in pictures:
            small = bicubic(image, settings.working.size(image.shape[1], image.shape[2]))
            parts = (settings.smoothing, settings.dictionary, settings.maps)
            cues = road_cues(learn_features(small, *parts), settings)
            found.append((both_ways(image, cues["likelihood"]), truth))
        tell(entry.name, found)


if __name__ == "__main__":
    main()
