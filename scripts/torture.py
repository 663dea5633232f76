"""Kill a command at random moments until its work is done, again and again; then compare.

    python scripts/torture.py infer --kills 100 --seed 0 --detector fusion --jobs 2
    python scripts/torture.py infer --video --kills 100
    python scripts/torture.py evaluate --kills 100
    python scripts/torture.py train --kills 100
    python scripts/torture.py adapt --kills 30 --pictures 4

Each round fills a folder: runs are started in it, each meets KILL, TERM or INT at a random moment,
and the next goes on, until one ends by itself. Then the files have to be those of a quiet run, byte
for byte (a checkpoint: value for value), and no other file may be there. TERM and INT have to end
in their exit status. Runs are forked behind the imports, so that signals meet the work, and the
clock that results are timed by stands still. Each fault is a line, with what the run told, and the
exit status is then 1.
"""

import argparse
import importlib
import json
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

import torch

from roadtorch.base.image import write_mask
from roadtorch.cli import main
from roadtorch.detectors.catalogue import list_detectors
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.run.folder import RUN
from roadtorch.run.writers.video import VideoWriter
from roadtorch.testing.scenes import render_scene, write_picture
from roadtorch.train import loop

LOADED = (
    *("roadtorch.camera.camera", "roadtorch.run.run", "roadtorch.run.record"),
    *("roadtorch.cli.evaluate", "roadtorch.run.writers.choice", "roadtorch.run.writers.coco"),
    *("roadtorch.inputs.find", "roadtorch.inputs.video", "roadtorch.run.workers"),
    *(
        "roadtorch.data.catalogue",
        "roadtorch.evaluation.evaluate",
        "roadtorch.evaluation.report.files",
    ),
    *(
        "roadtorch.evaluation.report.screen",
        "roadtorch.train.run",
        "roadtorch.train.adaptation.adapt",
    ),
)
"""What the commands import when they are used."""

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
ASKED = (signal.SIGTERM, signal.SIGINT)
SHARE = 0.6  # of the time of a quiet run: the longest that a run is left alone
PATIENT = 1.05  # by which that grows from run to run: what cannot be cut in two gets done at last
PATIENCE = 60.0  # seconds after which a run that was asked to stop hangs
OUT = "out"  # of each round's folder, in which its runs are started

TRAINING = """
kind = "pictures"
network = { height = 32, width = 40, narrow = 8, wide = 8 }
teacher = { detector = "labeller", working = { pixels = 4800 } }
recordings = { separator = "_", least = 5 }
rounds = { count = 2 }
descent = { batch = 2, method = "adam", learning_rate = 0.01, ema = 0.7 }
stopping = { rule = "epochs", epochs = 3 }
"""

ADAPTING = (
    *("network.height=32", "network.width=64", "teacher.detector=labeller", "teacher.views=one"),
    *("stopping.epochs=1", "samples_per_epoch=4", "descent.batch=2"),
)


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
        status = ended(forked(self._command, self.quiet))
        self.seconds = time.monotonic() - start
        if status != 0:
            self._blame(self.quiet, f"ended with {status}")

    def round(self, place: Path) -> None:
        """Runs into one folder until one ends by itself, and the comparison."""
        longest = SHARE * self.seconds
        while (status := self._run(place, longest)) is None:
            longest *= PATIENT
        if status != 0:
            self._blame(place, f"the last run ended with {status}")
        for fault in differences(self.quiet / OUT, place / OUT):
            self.faults.append(f"{place.name}: {fault}")

    def _run(self, place: Path, longest: float) -> int | None:
        """One run: None where a signal met it, within so many seconds, else its exit status."""
        child = forked(self._command, place)
        status = ended(child, self.chance.uniform(0, longest))
        if status is not None:
            return status
        number = self.chance.choice(SIGNALS)
        os.kill(child, number)
        status = ended(child, PATIENCE)
        self.kills[number.name] += 1
        if status is None:
            os.kill(child, signal.SIGKILL)
            ended(child)
        if status == 0:  # it was just done
            return 0
        if status not in (-number, 128 + number):
            how = "did not end it" if status is None else f"ended with {status}"
            self._blame(place, f"{number.name} {how}")
        return None

    def _blame(self, place: Path, what: str) -> None:
        told = (place / "told").read_text(errors="replace").strip().splitlines()
        self.faults.append(f"{place.name}: {what}; it told: {' / '.join(told[-8:]) or 'nothing'}")

    def _command(self) -> None:
        main([*self.words, "--out", OUT])


def forked(command: Callable[[], object], place: Path) -> int:
    """A child that runs a command in a folder, what it tells kept there; its number.

    Until it is where it would be as a process of its own, TERM and INT wait: within fork
    Python would tell an interruption and forget it, before it the child would end in ours.
    """
    place.mkdir(exist_ok=True)
    signal.pthread_sigmask(signal.SIG_BLOCK, ASKED)
    if (child := os.fork()) == 0:
        become(command, place)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKED)
    return child


def become(command: Callable[[], object], place: Path, notes: str = "told") -> None:
    """End this process with a command's status, and as Python does where it is interrupted."""
    status = 70
    try:
        os.chdir(place)
        told = os.open(notes, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream, target in enumerate((nowhere, nowhere, told)):
            os.dup2(target, stream)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKED)
        command()
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        status = 130
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(status)


def ended(child: int, seconds: float | None = None) -> int | None:
    """How a child ended, a signal as its negative number; None where it still runs by then."""
    end = None if seconds is None else time.monotonic() + seconds
    while end is None or time.monotonic() < end:
        found, status = os.waitpid(child, 0 if end is None else os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.001)
    return None


# --- what the runs leave ------------------------------------------------------------------


def differences(quiet: Path, out: Path) -> Iterator[str]:
    """What sets the results in a folder apart from those of a quiet run, in words."""
    wanted, found = _files(quiet), _files(out)
    yield from (f"{name} is missing" for name in sorted(wanted - found))
    yield from (f"{name} is stray" for name in sorted(found - wanted))
    for name in sorted(wanted & found):
        one, other = quiet / name, out / name
        if one.suffix == ".pt":
            if not _alike(*(torch.load(path, weights_only=True) for path in (one, other))):
                yield f"{name} has other values"
        elif name == RUN:
            if _lasting(one) != _lasting(other):
                yield f"{name} says something else"
        elif one.read_bytes() != other.read_bytes():
            yield f"{name} has other bytes"


def _lasting(record: Path) -> dict[str, object]:
    """What run.json says, but for when it was and how it was called."""
    said = json.loads(record.read_bytes())
    return {key: value for key, value in said.items() if key not in ("started", "ended", "command")}


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def _alike(one: object, other: object) -> bool:
    """Whether two values of a checkpoint are the same to the bit, with all that is in them."""
    if type(one) is not type(other):
        return False
    if isinstance(one, torch.Tensor) and isinstance(other, torch.Tensor):
        return torch.equal(one, other)
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_alike, one, other))
    return one == other


# --- what is done -------------------------------------------------------------------------


def infer_words(given: argparse.Namespace) -> list[str]:
    """Pictures in two folders, or a video, and all that can be saved of them."""
    kinds = "likelihood,mask,overlay,cues" + ",overlay-frames,bag" * given.video
    detector = ["--detector", given.detector, "--jobs", str(given.jobs)]
    footage = "../work/drive.mp4" if given.video else "../work/images"
    return ["infer", footage, *detector, "--save", kinds]


def evaluate_words(given: argparse.Namespace) -> list[str]:
    """A labelled folder, two detectors, and all that is written of them."""
    detectors = ["--detector", given.detector, "--detector", "prior:uniform"]
    return ["evaluate", "folder", "../work", *detectors, "--jobs", str(given.jobs)]


def train_words(given: argparse.Namespace) -> list[str]:
    """Two rounds of a small network; each run goes on with the one before."""
    work = ["--config", "../work/training.toml", "--images", "../work/images"]
    return ["train", *work, "--resume", "--threads", "1"]


def adapt_words(_: argparse.Namespace) -> list[str]:
    """One epoch of a small network for each half; the same command goes on."""
    changes = [word for change in ADAPTING for word in ("--set", change)]
    return ["adapt", "../work/images", *changes, "--threads", "1"]


COMMANDS = {
    "infer": infer_words,
    "evaluate": evaluate_words,
    "train": train_words,
    "adapt": adapt_words,
}


def paint(folder: Path, count: int) -> None:
    """Write labelled streets; in a copy of this process, as torch's threads survive no fork."""
    (folder / "masks" / "below").mkdir(parents=True)
    for seed in range(count):
        scene = render_scene(seed, 120, 160)
        name = f"{'below/' if seed % 3 == 0 else ''}street_{seed:02}.png"
        write_picture(folder / "images" / name, scene)
        write_mask(folder / "masks" / name, scene.road)
    with closing(VideoWriter(folder / "drive.mp4", Detection.overlay)) as video:
        for seed in range(count):
            scene = render_scene(seed, 120, 160)
            item = Item(f"{seed}", f"{seed}", scene.image.clone, number=seed)
            likelihood = scene.road.float()
            video.write(item, Detection(likelihood, scene.road, {}, image=scene.image))
    (folder / "training.toml").write_text(TRAINING)


def load() -> None:
    """Import what the runs need; stop the clock of results; save as often as that can be done."""
    torch.set_num_threads(1)
    loop.SAVE_EVERY = 0.0
    for name in LOADED:
        importlib.import_module(name)
    for module in [time, *(sys.modules[name] for name in sys.modules if "roadtorch" in name)]:
        if hasattr(module, "perf_counter"):  # imported by its name
            module.perf_counter = lambda: 0.0  # type: ignore[attr-defined]


def torture(given: argparse.Namespace, folder: Path) -> Torture:
    """All rounds, with pictures and results in a folder."""
    context = multiprocessing.get_context("fork")  # as the runs are, with all that is imported
    painter = context.Process(target=paint, args=(folder / "work", given.pictures))
    painter.start()
    painter.join()
    found = Torture(COMMANDS[given.command](given), folder / "quiet", random.Random(given.seed))
    found.begin()
    number = 0
    while sum(found.kills.values()) < given.kills and not found.faults:
        found.round(folder / f"round-{number}")
        number += 1
    return found


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("command", choices=COMMANDS)
    parser.add_argument("--kills", type=int, default=100, help="at least this many signals")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", type=int, default=12)
    parser.add_argument("--video", action="store_true", help="of infer: a video, no pictures")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--detector", choices=list_detectors(), default="fusion")
    return parser.parse_args()


def tell(found: Torture) -> None:
    """The signals that were sent, and each fault."""
    told = ", ".join(f"{count} {name}" for name, count in sorted(found.kills.items()))
    time_of_one = f"{found.seconds:.1f} s undisturbed"
    count = sum(found.kills.values())
    print(f"{count} signals ({told}); {time_of_one}; {len(found.faults)} faults")
    for fault in found.faults:
        print(f"  {fault}")


if __name__ == "__main__":
    load()
    with tempfile.TemporaryDirectory() as temporary:
        outcome = torture(_arguments(), Path(temporary))
    tell(outcome)
    sys.exit(1 if outcome.faults else 0)
