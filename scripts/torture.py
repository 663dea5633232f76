"""Kill `infer` at random moments until the work is done, again and again; then compare.

    python scripts/torture.py --kills 100 --seed 0
    python scripts/torture.py --kills 100 --jobs 2 --detector fusion

Each round fills a folder: runs are started in it, each meets KILL, TERM or INT at a random moment,
and the next goes on, until one ends by itself. Then the files have to be those of a quiet run, byte
for byte, index.csv but for its times, and no other file may be there. TERM and INT have to end in
their exit status. Runs are forked behind the imports, so that signals meet the work. Each fault is
a line, and the exit status is then 1.
"""

import argparse
import csv
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.camera.camera import Camera  # noqa: F401  (loaded once, before the forks)
from roadtorch.cli import batch, claim, config, main, results  # noqa: F401
from roadtorch.detectors.catalogue import list_detectors
from roadtorch.scenes import render_scene, write_picture

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
SHARE = 0.6  # of the time of a quiet run: the longest that a run is left alone
PATIENCE = 120.0  # seconds after which a run that was asked to stop hangs


@dataclass
class Torture:
    """One command line without its --out, what it should leave, and what went wrong."""

    words: list[str]
    quiet: Path
    chance: random.Random
    seconds: float = 0.0
    kills: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def begin(self) -> None:
        """The quiet run, its time taken."""
        start = time.monotonic()
        status = _ended(self._started(self.quiet))
        self.seconds = time.monotonic() - start
        if status != 0:
            self.faults.append(f"the quiet run ended with {status}")

    def round(self, out: Path) -> None:
        """Runs into one folder until one ends by itself, and the comparison."""
        while (status := self._run(out)) is None:
            pass
        self.faults += [f"{out.name}: {fault}" for fault in differences(self.quiet, out)]
        if status != 0:
            self.faults.append(f"{out.name}: the last run ended with {status}")

    def _run(self, out: Path) -> int | None:
        """One run: None where a signal met it, else its exit status."""
        child = self._started(out)
        status = _ended(child, self.chance.uniform(0, SHARE * self.seconds))
        if status is not None:
            return status
        number = self.chance.choice(SIGNALS)
        os.kill(child, number)
        status = _ended(child, PATIENCE)
        self.kills[number.name] += 1
        if status == 0:  # it was just done
            return 0
        if status not in (-number, 128 + number):
            self.faults.append(f"{out.name}: {number.name} ended with {status}")
        return None

    def _started(self, out: Path) -> int:
        """A child that runs the command, quietly; its process number."""
        child = os.fork()
        if child:
            return child
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nowhere, stream)
        status = 70
        try:
            main([*self.words, "--out", str(out)])
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 0
        finally:
            os._exit(status)


def _ended(child: int, seconds: float | None = None) -> int | None:
    """How a child ended, a signal as its negative number; None where it still runs by then."""
    end = None if seconds is None else time.monotonic() + seconds
    while end is None or time.monotonic() < end:
        found, status = os.waitpid(child, 0 if end is None else os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.001)
    return None


def differences(quiet: Path, out: Path) -> Iterator[str]:
    """What sets the results in a folder apart from those of a quiet run, in words."""
    wanted, found = _files(quiet), _files(out)
    yield from (f"{name} is missing" for name in sorted(wanted - found))
    yield from (f"{name} is stray" for name in sorted(found - wanted))
    for name in sorted(wanted & found):
        if name == batch.INDEX:
            if _rows(quiet) != _rows(out):
                yield f"{name} has other rows"
        elif (quiet / name).read_bytes() != (out / name).read_bytes():
            yield f"{name} has other bytes"


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def _rows(folder: Path) -> list[dict[str, str]]:
    with (folder / batch.INDEX).open(newline="", encoding="utf-8") as file:
        return [{**row, "ms": ""} for row in csv.DictReader(file)]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=100, help="at least this many signals")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--detector", choices=list_detectors(), default="fusion")
    return parser.parse_args()


def paint(folder: Path, count: int) -> None:
    """Write rendered streets; in a process of its own, as threads of torch do not survive forks."""
    for seed in range(count):
        place = folder / ("below" if seed % 3 == 0 else ".") / f"{seed:02}.png"
        write_picture(place, render_scene(seed, 120, 160))


def torture(given: argparse.Namespace, folder: Path) -> Torture:
    """All rounds, with pictures and results in a folder."""
    painter = multiprocessing.get_context("spawn").Process(
        target=paint, args=(folder / "pictures", given.pictures)
    )
    painter.start()
    painter.join()
    words = ["infer", str(folder / "pictures"), "--detector", given.detector]
    words += ["--jobs", str(given.jobs), "--save", "likelihood,mask,overlay,cues"]
    found = Torture(words, folder / "quiet", random.Random(given.seed))
    found.begin()
    number = 0
    while sum(found.kills.values()) < given.kills and not found.faults:
        found.round(folder / f"round-{number}")
        number += 1
    return found


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        outcome = torture(_arguments(), Path(temporary))
    told = ", ".join(f"{count} {name}" for name, count in sorted(outcome.kills.items()))
    print(f"{sum(outcome.kills.values())} signals ({told}); {len(outcome.faults)} faults")
    for fault in outcome.faults:
        print(f"  {fault}")
    sys.exit(1 if outcome.faults else 0)
