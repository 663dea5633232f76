"""What evaluation itself costs: time a picture and detector, and memory over many pictures.

    python scripts/bench_evaluation.py            # 1,000 pictures against 10
    python scripts/bench_evaluation.py --many 200 # a quicker look

The pictures are one rendered street of 480x360 pixels under many names; the detectors are
floors, which take next to no time of their own. Each number of pictures is run in a process
of its own, because a process never gives back the most memory it had.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from roadtorch.cli.group import BRIEF_WAITS

os.environ.update(BRIEF_WAITS)  # as the command line does, before torch

import cv2
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.evaluation.comparison import resample
from roadtorch.evaluation.contenders import named_detector
from roadtorch.evaluation.saved_tallies import SavedTallies
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.summary import summarise
from roadtorch.runtime.memory import peak_mebibytes
from roadtorch.scenes.street import render_scene, write_picture

DETECTORS = ("prior:rows", "prior:triangle", "prior:uniform")
SIZE = (360, 480)


def street(root: Path, many: int) -> Dataset:
    """A set of one picture under many names."""
    scene = render_scene(0, *SIZE)
    (root / "masks").mkdir()
    write_picture(root / "images" / "street.png", scene)
    mask = torch.where(scene.void, 127, 255 * scene.road).to(torch.uint8)
    cv2.imwrite(str(root / "masks" / "street.png"), mask.numpy())
    one = open_dataset("folder", root)
    items = tuple(replace(one.items[0], name=f"street_{index}") for index in range(many))
    return replace(one, items=items)


def measure(many: int) -> dict[str, float]:
    """Milliseconds of counting a picture and detector, seconds of the summary, peak memory."""
    with TemporaryDirectory() as folder:
        dataset = street(Path(folder), many)
        contenders = [named_detector(name, {}) for name in DETECTORS]
        saved = SavedTallies(None, "bench")
        reading = time.perf_counter()
        for item in dataset.items[: min(many, 20)]:
            dataset.read(item)
        reading = (time.perf_counter() - reading) / min(many, 20)
        start = time.perf_counter()
        for result in score(dataset, contenders):
            saved.add(result)
        whole = (time.perf_counter() - start) / many - reading
        detect = sum(float(tally.kept().seconds.median()) for tally in saved.tallies.values())
        start = time.perf_counter()
        for one in contenders:
            tally = saved.tallies[one.name]
            resample(tally, summarise(one, tally))
        return {
            "ms": 1000 * (whole - detect) / len(DETECTORS),
            "summary_s": (time.perf_counter() - start) / len(DETECTORS),
            "peak_mb": peak_mebibytes(),
        }


def main() -> None:
    parser = argparse.ArgumentParser(description="What evaluation itself costs.")
    parser.add_argument("--many", type=int, default=1000, help="pictures of the larger run")
    parser.add_argument("--only", type=int, help="measure this number of pictures, print JSON")
    chosen = parser.parse_args()
    if chosen.only:
        print(json.dumps(measure(chosen.only)))
        return
    for many in (10, chosen.many):
        command = [sys.executable, __file__, "--only", str(many)]
        found = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        print(
            f"{many:5d} pictures: {found['ms']:.1f} ms a picture and detector, "
            f"{found['summary_s']:.2f} s of summary a detector, peak {found['peak_mb']:.0f} MB"
        )


if __name__ == "__main__":
    main()
