"""Break commands on purpose, start them again, and compare with a run that nobody disturbed.

    python scripts/chaos.py kill infer evaluate train adapt --times 20 --jobs 2
    python scripts/chaos.py change                           # all commands

    kill     KILL, TERM or INT at a random moment, up to three times in a row
    hangup   HUP in the same way
    pause    STOP in the same way, and CONT a while later
    worker   the kernel kills a worker (of commands with --jobs)
    meet     two runs of one command at the same moment: both end well, or one is refused
    read     a reader opens every result while it is written: it is whole
    change   images are cut short, grow or vanish while they are read, and come back

No run may end in a traceback, hang, or have an exit status that docs/performance.md does not name,
and what the correction page acknowledged is in its logs. Once the trouble is over the same command
has to end in 0 with the files of the undisturbed run, byte for byte but for times, and no others.
Runs are forked behind the imports, so that trouble meets the work. What is wrong is a line, and the
exit status is then 1.
"""

import importlib
import json
import os
import pkgutil
import random
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from multiprocessing.context import ForkProcess
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

import httpx
import torch
from PIL import Image

import roadtorch
from roadtorch.base.image import write_labels, write_mask
from roadtorch.cli import main
from roadtorch.testing.scenes import render_scene, write_image
from roadtorch.train import training_loop
from scripts.freeze import settled
from tests.videos import write_video

OUT = "out"  # of the folder in which a command runs
PATIENCE = 180.0  # seconds within which every run has to end
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)

# --- processes ----------------------------------------------------------------------------


@dataclass
class Case:
    """A command in a folder of its own, and the seconds that it takes undisturbed."""

    command: Callable[[], object]
    folder: Path
    chance: random.Random
    seconds: float = 0.0
    log: str = "stderr"

    def start(self) -> ForkProcess:
        """Start the command in a forked copy of this process.

        TERM and INT are blocked until the copy is where a process of its own would be: within fork
        Python would report an interruption and forget it.
        """
        self.folder.mkdir(exist_ok=True)
        child = get_context("fork").Process(target=self.run_and_exit)
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS[1:])
        child.start()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS[1:])
        return child

    def run_and_exit(self) -> None:
        """Run the command and end this process as Python would, with standard error in a file."""
        status = 70
        try:
            os.chdir(self.folder)
            null = os.open(os.devnull, os.O_RDWR)
            errors = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for stream, target in enumerate((null, null, errors)):
                os.dup2(target, stream)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS[1:])
            self.command()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 0
        except KeyboardInterrupt:
            status = 130
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(status)

    def moment(self) -> float:
        """Sample a moment of the run, in seconds."""
        return self.chance.uniform(0, self.seconds)

    def finish(self, child: ForkProcess, allowed: set[int]) -> Iterator[str]:
        """Wait for a run; yield the problems of its end."""
        child.join(PATIENCE)
        status = child.exitcode
        if status is None:
            child.kill()
            child.join()
        lines = (self.folder / self.log).read_text(errors="replace").strip().splitlines()
        message = " / ".join(lines[-8:])
        if status not in allowed or "Traceback" in message or "report it" in message:
            yield f"ended with {status}: {message}"


# --- results ------------------------------------------------------------------------------


def lost_strokes(folder: Path) -> Iterator[str]:
    """Yield acknowledged strokes that are in no complete line of a log."""
    notes = folder / "acknowledged"
    logs = [path.read_bytes() for path in (folder / OUT).rglob("*.jsonl")]
    logged = {json.loads(line).get("id") for log in logs for line in log.split(b"\n")[:-1]}
    acknowledged = set(notes.read_text().split()) if notes.exists() else set[str]()
    yield from (f"{stroke} is lost" for stroke in acknowledged - logged)


def differences(quiet: Path, out: Path) -> Iterator[str]:
    """Yield the differences between the files of a folder and those of an undisturbed run."""
    expected, present = (
        {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}
        for folder in (quiet, out)
    )
    yield from (f"{name} is missing" for name in sorted(expected - present))
    yield from (f"{name} is stray" for name in sorted(present - expected))
    for name in sorted(expected & present):
        if content_of(quiet / name) != content_of(out / name):
            yield f"{name} has other content"


def content_of(path: Path) -> str | bytes:
    """Read a file without times; a checkpoint by its values, as shared memory in it is random."""
    if path.suffix != ".pt":
        return settled(path)
    values = torch.load(path, weights_only=True)
    text = json.dumps(values, default=lambda tensor: hash(tensor.numpy().tobytes()))
    return re.sub(r'"seconds": [^,}]*', "", text)


# --- commands -----------------------------------------------------------------------------

TRAINING = """
kind = "images"
network = { height = 32, width = 64, narrow = 8, wide = 8 }
teacher = { detector = "labeller", working = { pixels = 4800 } }
descent = { batch = 2, method = "adam", learning_rate = 0.01, ema = 0.7 }
stopping = { rule = "epochs", epochs = 2 }
"""
MAPS = "--save likelihood,mask,overlay,cues,npy,polygons"
COMMANDS = {
    "infer": f"infer ../work/images {{detector}} {{jobs}} {MAPS} --out out",
    "video": f"infer ../work/drive.mp4 {{detector}} {{jobs}} {MAPS},overlay-frames,bag --out out",
    "evaluate": "evaluate folder ../work {detector} {jobs} --detector prior:uniform --out out",
    "grid": "infer ../work/images {detector} {jobs} --save grid --set grid.height=1.5 "
    "--set grid.pitch=2 --set grid.fov=90 --out out",
    "label": "label ../work/images {jobs} --out out",
    "train": "train --config ../work/training.toml --images ../work/images_flat --threads 1 "
    "--corrections ../work/corrections --out out",
    "adapt": "adapt ../work/images --set network.height=32 --set network.width=64 --set "
    "teacher.detector=labeller --set stopping.epochs=1 --set "
    "samples_per_epoch=4 --set descent.batch=2 --threads 1 --out out",
    "import": "annotate ../work/images_flat --import png --from ../work --out out",
    "corrections": "annotate ../work/images_flat --export coco --to out --out ../work/corrections",
    "export": "export fusion --out out/net.onnx",
    "annotate": "annotate ../work/images_flat --detector prior:rows --out out",
}
"""Command lines by name."""


def annotate() -> None:
    """Serve the correction page and draw on it; end once every stroke is acknowledged."""
    done = threading.Event()
    threading.Thread(target=draw, args=(done,), daemon=True).start()
    try:
        main(COMMANDS["annotate"].split())
    except SystemExit:
        if not done.is_set():
            raise
    shutil.rmtree(Path(OUT, ".views"))  # how far the server came with its own work is chance
    Path(OUT, ".session.json").unlink()


def draw(done: threading.Event) -> None:
    """Draw on four images at the same time, and end this process."""
    with ThreadPoolExecutor(4) as people:
        list(people.map(draw_strokes, range(4)))
    done.set()
    os.kill(os.getpid(), signal.SIGINT)


def draw_strokes(person: int) -> None:
    """Send a person's strokes to the page; log those acknowledged, and exit if one is refused."""
    for number in range(5):
        stroke = {"kind": "brush", "id": f"s{person}-{number}", "label": "road", "radius": 3}
        stroke["points"], status = [[10 + number, 20], [15, 30]], 0
        while not status:
            with suppress(OSError, httpx.TransportError):  # it has not started yet
                address = json.loads(Path(OUT, ".session.json").read_text())
                page = f"http://127.0.0.1:{address['port']}/api/event?name=street_{person:06}.png"
                headers = {"x-token": address["token"]}
                status = httpx.post(page, headers=headers, json=stroke).status_code
        if status != 200:
            os._exit(1)
        with Path("acknowledged").open("a") as notes:
            print(stroke["id"], file=notes)


def prepare(work: Path, count: int) -> None:
    """Write labelled streets, a video, corrections and the config of a small training."""
    for name in ("masks/below", "labels"):
        (work / name).mkdir(parents=True)
    for seed in range(count):
        scene, name = render_scene(seed, 60, 80), f"street_{seed:06}.png"
        nested = f"below/{name}" if seed % 3 == 0 else name
        write_image(work / "images_flat" / name, scene)
        write_image(work / "images" / nested, scene)
        write_mask(work / "masks" / nested, scene.road)
        write_labels(work / "labels" / name, torch.where(scene.road, 1, 2).to(torch.uint8))
    (work / "training.toml").write_text(TRAINING)
    write_video(work / "drive.mp4")
    words = ["annotate", f"{work}/images_flat", "--out", f"{work}/corrections", "--import", "png"]
    main([*words, "--from", str(work)])


# --- trouble ------------------------------------------------------------------------------


def interrupt(case: Case, numbers: tuple[int, ...]) -> Iterator[str]:
    """Send one of the signals at a random moment, up to three times in a row."""
    for _ in range(case.chance.randint(1, 3)):
        child, number = case.start(), case.chance.choice(numbers)
        child.join(case.moment())
        if child.is_alive() and child.pid:
            os.kill(child.pid, number)
            time.sleep(0.5 * (number == signal.SIGSTOP))
            os.kill(child.pid, signal.SIGCONT)
        yield from case.finish(child, {0, -number, 128 + number})


def kill_worker(case: Case) -> Iterator[str]:
    """Kill the worker that started last, as the kernel does where memory is short."""
    child = case.start()
    child.join(case.moment())
    with suppress(FileNotFoundError, IndexError, ProcessLookupError):
        workers = Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split()
        os.kill(int(workers[-1]), signal.SIGKILL)
    yield from case.finish(child, {0, 1})


def meet(case: Case) -> Iterator[str]:
    """Start two runs at the same moment, or nearly."""
    second_case, first = replace(case, log="other"), case.start()
    first.join(case.chance.choice((0, case.moment())))
    second = second_case.start()
    yield from case.finish(first, {0, 1, 2})
    yield from second_case.finish(second, {0, 1, 2})
    if 0 not in (first.exitcode, second.exitcode):
        yield "neither run ended well"


def read(case: Case) -> Iterator[str]:
    """Open every result as it appears."""
    child, broken = case.start(), set[str]()
    while child.is_alive():
        walk = os.walk(case.folder / OUT)  # folders may vanish meanwhile
        for path in (Path(folder, name) for folder, _, names in walk for name in names):
            try:
                if path.suffix in (".png", ".jpg"):
                    Image.open(path).load()
                elif path.suffix == ".json":
                    json.loads(path.read_bytes())
            except FileNotFoundError:
                pass  # a part of a checkpoint, or of progress: removed meanwhile
            except Exception as error:
                broken.add(f"{path.name} was not whole: {error}")
    yield from broken
    yield from case.finish(child, {0})


def change(case: Case) -> Iterator[str]:
    """Replace images while they are read, by nothing or by others, and restore them."""
    images = (case.folder.parent / "work").rglob("image*/**/*.png")
    original = {path: path.read_bytes() for path in sorted(images)}
    child, due = case.start(), time.monotonic() + case.chance.uniform(0, case.seconds)
    while time.monotonic() < due:
        path, data = case.chance.choice([*original.items()])
        path.write_bytes(case.chance.choice((data[: len(data) // 2], b"", data + bytes(999), data)))
        if not path.stat().st_size:
            path.unlink()
        time.sleep(0.001)
    for path, data in original.items():
        path.write_bytes(data)
    yield from case.finish(child, {0, 1, 2})


TROUBLE: Mapping[str, Callable[[Case], Iterator[str]]] = {
    "kill": partial(interrupt, numbers=SIGNALS),
    "hangup": partial(interrupt, numbers=(signal.SIGHUP,)),
    "pause": partial(interrupt, numbers=(signal.SIGSTOP,)),
    "worker": kill_worker,
    "meet": meet,
    "read": read,
    "change": change,
}
NOT_TRIED = {
    ("change", "annotate"),  # what is drawn depends on the list of images
    ("meet", "annotate"),  # it is the page's server that holds the lock
    *(("worker", name) for name in COMMANDS if "{" not in COMMANDS[name]),
}


def disturb(name: str, options: Namespace, folder: Path) -> list[str]:
    """Try a class of trouble on a command; print the number of attempts and return the problems."""
    kind = options.trouble
    jobs = f"--jobs {2 if kind == 'worker' else options.jobs}"
    words = COMMANDS[name].format(jobs=jobs, detector=f"--detector {options.detector}").split()
    command = annotate if name == "annotate" else partial(main, words)
    case = Case(command, folder / "case", random.Random(options.seed))
    child = replace(case, command=partial(prepare, folder / "work", options.count)).start()
    child.join()  # in a copy of this process, as torch's threads survive no fork
    start = time.monotonic()
    wrong = list(case.finish(case.start(), {0}))
    case.seconds = time.monotonic() - start
    quiet = case.folder.rename(folder / "quiet")
    for _ in range(options.times):
        problems = [*TROUBLE[kind](case), *lost_strokes(case.folder)]
        again = list(case.finish(case.start(), {0}))
        if kind == "change" and again and "ended with 2:" in again[0]:
            shutil.rmtree(case.folder)  # what began with other bytes is refused, and begun anew
            again = list(case.finish(case.start(), {0}))
        problems += [f"started again it {end}" for end in again]
        problems += differences(quiet / OUT, case.folder / OUT)
        wrong += [f"{kind} {name}: {problem}" for problem in problems]
        shutil.rmtree(case.folder)
    print(f"{kind} {name}: tried {options.times}, wrong {len(wrong)}", flush=True)
    return wrong


# --- the command line ---------------------------------------------------------------------


def load() -> None:
    """Import what the runs need and stop the clock of events, as each run is repeated."""
    torch.set_num_threads(1)
    for module in pkgutil.walk_packages(roadtorch.__path__, "roadtorch."):
        if not module.name.endswith("__main__"):
            with suppress(ImportError):  # of an extra that is not installed
                importlib.import_module(module.name)
    training_loop.SAVE_INTERVAL = 0.0  # save as often as that can be done
    time.time = lambda: 1e9


def run() -> int | str:
    """Try a class of trouble on commands; return the problems."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("trouble", choices=TROUBLE)
    parser.add_argument("commands", nargs="*", choices=[*COMMANDS, []], default=[])
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=4, help="images")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--detector", default="prior:rows")
    options = parser.parse_args()
    load()
    wrong = list[str]()
    for name in options.commands or COMMANDS:
        if (options.trouble, name) not in NOT_TRIED:
            with tempfile.TemporaryDirectory() as temporary:
                wrong += disturb(name, options, Path(temporary))
    return "\n".join(wrong)


if __name__ == "__main__":
    sys.exit(run() or 0)
