"""Pictures a second of `infer`, against what detection alone and reading and writing alone allow.

    python scripts/bench_throughput.py PICTURES --pictures 120 --rounds 5

Each round does the same pictures with the same workers in three ways: detection alone, of images
that are in memory; reading, and writing likelihood, mask and overlay alone, of detections that are
in memory; and both, as `infer` does it. Figures are medians over the rounds; the share is that of
the whole in the slower of the two, which is the most that it could reach if the other cost
nothing. The order moves on by one from round to round.
"""

import argparse
import json
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from torch import Tensor

from roadtorch.detector import Detection, Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.io.image import read_image
from roadtorch.runs.engines import processors, rows_of_workers
from roadtorch.runs.footage import USUAL_OF_PICTURES
from roadtorch.runs.index import Row
from roadtorch.runs.pictures import Job, plan
from roadtorch.runs.results import Inference
from roadtorch.runtime.memory import keep_freed_memory
from roadtorch.runtime.threads import Threads
from roadtorch.sources.pictures import find_images

KEPT = 8  # images and detections that are in memory; every picture of a drive is about as hard
KINDS = frozenset(USUAL_OF_PICTURES)


@dataclass(frozen=True)
class Detecting:
    """Detection alone."""

    detector: Detector
    images: Sequence[Tensor]

    def __call__(self, job: Job) -> Row:
        self.detector.detect(self.images[len(job.picture.name) % len(self.images)])
        return Row(job.file)


@dataclass(frozen=True)
class ReadingAndWriting:
    """Reading and writing alone."""

    found: Sequence[Detection]
    writing: Inference

    def __call__(self, job: Job) -> Row:
        detection = self.found[len(job.picture.name) % len(self.found)]
        image = read_image(job.picture.path)
        return self.writing.write(job.file, image, detection, job.output)


def rate(jobs: Sequence[Job], work: Callable[[Job], Row], workers: int) -> float:
    """Pictures a second, from the start of the workers to their end."""
    start = time.perf_counter()
    done = [row for row in rows_of_workers(jobs, work, workers) if not row.failed]
    seconds = time.perf_counter() - start
    assert len(done) == len(jobs), "some pictures failed"
    return len(jobs) / seconds


def measure(given: argparse.Namespace, out: Path) -> dict[str, float]:
    """Medians by what was done."""
    Threads(1, 1).set()
    keep_freed_memory()
    detector = load_detector(given.detector)
    infer = Inference(detector, KINDS, 8)
    jobs = plan(find_images([given.images]), out, infer.ends)[: given.pictures]
    images = [read_image(job.picture.path) for job in jobs[:KEPT]]
    found = [detector.detect(image) for image in images]
    ways: dict[str, Callable[[Job], Row]] = {
        "detect": Detecting(detector, images),
        "read and write": ReadingAndWriting(found, infer),
        "infer": infer,
    }
    rates: dict[str, list[float]] = {name: [] for name in ways}
    for number in range(given.rounds):
        names = list(ways)
        for name in names[number % 3 :] + names[: number % 3]:
            rates[name].append(rate(jobs, ways[name], given.workers))
            shutil.rmtree(out, ignore_errors=True)
    medians = {name: statistics.median(values) for name, values in rates.items()}
    shares = zip(rates["detect"], rates["read and write"], rates["infer"], strict=True)
    medians["share"] = statistics.median(whole / min(one, two) for one, two, whole in shares)
    return medians


def main(words: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("images", type=Path, help="a folder of pictures")
    options.add_argument("--pictures", type=int, default=120)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--workers", type=int, default=processors())
    options.add_argument("--detector", default="fusion")
    with tempfile.TemporaryDirectory() as folder:
        found = measure(options.parse_args(words), Path(folder, "out"))
    print(json.dumps({name: round(value, 3) for name, value in found.items()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
