"""What a night brings, tried on every command: two runs in one folder, readers, files that change.

    python scripts/hardships.py                        every class, every command
    python scripts/hardships.py --classes meet clock --commands infer train --times 10

A class is a row of the table: how often it was tried, and how often it was wrong. Right is: no
traceback and no wait without end; an exit status of docs/reliability.md; and once the trouble is
over, the same command again ends in 0 with the files of a quiet run, byte for byte, and no others.

    meet     two runs of one command at the same moment: both end well, or one is refused in a line
    read     a reader opens every result while it is written: it is whole
    change   pictures are cut short, grow or vanish while they are read, and come back
    clock    the clock is set back by a day between two halves of a run
    locks    the folder has no locks (flock says ENOLCK)
    hangup   SIGHUP at a random moment
    pause    SIGSTOP at a random moment, SIGCONT a while later
    worker   the kernel kills a worker (of commands that have some: --jobs 2)

``clock`` wants libfaketime and is left out where it is not installed; ``locks`` a C compiler.
"""

import argparse
import json
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from PIL import Image

from roadtorch.cli import main
from scripts.faults import COMMANDS, prepare
from scripts.torture import OUT, become, differences, ended, forked, load

PATIENCE = 180.0  # seconds within which every run has to end
PAUSE = 0.5  # seconds that a run is stopped; a minute changes nothing but the time that it takes
FAKETIME = Path("/usr/lib/x86_64-linux-gnu/faketime/libfaketime.so.1")
NO_LOCKS = "#include <errno.h>\nint flock(int fd, int how) { errno = ENOLCK; return -1; }\n"
WORKING = {"infer", "evaluate", "grid", "label", "submit", "tune"}
"""Commands with --jobs."""

NOT_TRIED = {
    *(("clock", name) for name in ("annotate", "import")),  # whose results hold the time
    ("change", "annotate"),  # what is drawn here depends on the list of pictures
    ("meet", "annotate"),  # it is the page that holds the lock, and here is none
}

OTHER_INPUT = ("holds a run on other pictures", "holds frames of other footage")

Command = Callable[[], None]
Hardship = Callable[[Command, Path, random.Random, float], Iterator[str]]


def said(place: Path, notes: str = "told") -> str:
    """What a run told, in a line."""
    return " / ".join((place / notes).read_text(errors="replace").strip().splitlines()[-4:])


def wrong_end(place: Path, status: int | None, allowed: set[int], notes: str = "told") -> str:
    """What is wrong with how a run ended, or nothing."""
    told = said(place, notes)
    bad = "Traceback" in told or "report it" in told
    return f"ended with {status}: {told}" if bad or status not in allowed else ""


def finished(child: int) -> int | None:
    """How a run ended; one that hangs is killed, and None."""
    status = ended(child, PATIENCE)
    if status is None:
        os.kill(child, signal.SIGKILL)
        ended(child)
    return status


def meet(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """Two runs at the same moment, or nearly."""
    place.mkdir()
    children = []
    for notes in ("told", "told by the other"):
        if (child := os.fork()) == 0:
            become(command, place, notes)
        children.append(child)
        time.sleep(chance.choice((0, 0.01, chance.uniform(0, seconds))))
    ends = [finished(child) for child in children]
    for notes, status in zip(("told", "told by the other"), ends, strict=True):
        if fault := wrong_end(place, status, {0, 1, 2}, notes):
            yield fault
    if 0 not in ends:
        yield f"neither run ended well: {said(place)} and {said(place, 'told by the other')}"
    (place / "told by the other").unlink()


def read(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """Every result is opened as it appears."""
    child = forked(command, place)
    status, broken = None, set[str]()
    while status is None:
        status = ended(child, 0.002)
        for path in (place / OUT).rglob("[!.]*"):
            try:
                opened(path)
            except FileNotFoundError:
                pass  # a part of a checkpoint, or of progress: removed meanwhile
            except Exception as problem:
                broken.add(f"{path.name} was not whole: {problem}")
    yield from broken
    if fault := wrong_end(place, status, {0}):
        yield fault


def opened(path: Path) -> None:
    """Read a result as its users do; raises where it is not whole."""
    if path.suffix in (".png", ".jpg"):
        with Image.open(path) as picture:
            picture.load()
    elif path.suffix == ".json":
        json.loads(path.read_bytes())
    elif path.suffix == ".csv":
        rows = path.read_text("utf-8").splitlines()
        assert rows[0].count(",")


def change(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """Pictures are others, or none, while they are read."""
    pictures = sorted((place.parent / "work").rglob("image*/*.png"))
    whole = {path: path.read_bytes() for path in pictures}
    child = forked(command, place)
    end = time.monotonic() + chance.uniform(0, seconds)
    while time.monotonic() < end:
        path = chance.choice(pictures)
        how, data = chance.randrange(4), whole[path]
        if how == 0:
            path.write_bytes(data[: chance.randrange(len(data))])
        elif how == 1:
            path.unlink(missing_ok=True)
        elif how == 2:
            path.write_bytes(data + bytes(999))
        else:
            path.write_bytes(data)
        time.sleep(0.001)
    for path, data in whole.items():
        path.write_bytes(data)
    if fault := wrong_end(place, finished(child), {0, 1, 2}):
        yield fault


def hangup(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """The terminal goes."""
    child = forked(command, place)
    time.sleep(chance.uniform(0, seconds))
    os.kill(child, signal.SIGHUP)
    if fault := wrong_end(place, finished(child), {0, -signal.SIGHUP, 129}):
        yield fault


def pause(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """The machine sleeps."""
    child = forked(command, place)
    time.sleep(chance.uniform(0, seconds))
    os.kill(child, signal.SIGSTOP)
    time.sleep(PAUSE)
    os.kill(child, signal.SIGCONT)
    if fault := wrong_end(place, finished(child), {0}):
        yield fault


def worker(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """The kernel kills the worker that began last."""
    child = forked(command, place)
    time.sleep(chance.uniform(0, seconds))
    with suppress(FileNotFoundError, ProcessLookupError):
        for number in Path(f"/proc/{child}/task/{child}/children").read_text().split()[-1:]:
            os.kill(int(number), signal.SIGKILL)
    if fault := wrong_end(place, finished(child), {0, 1}):
        yield fault


def halted(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """The first half of a run; what began the process afresh does the rest."""
    child = forked(command, place)
    time.sleep(chance.uniform(0, seconds))
    os.kill(child, signal.SIGTERM)
    if fault := wrong_end(place, finished(child), {0, 143}):
        yield fault


def plainly(command: Command, place: Path, chance: random.Random, seconds: float) -> Iterator[str]:
    """Nothing happens but what the process was started with."""
    if fault := wrong_end(place, finished(forked(command, place)), {0}):
        yield fault


HARDSHIPS: Mapping[str, Hardship] = {
    "meet": meet,
    "read": read,
    "change": change,
    "clock": halted,
    "locks": plainly,
    "hangup": hangup,
    "pause": pause,
    "worker": worker,
}


def ways(kind: str, names: list[str]) -> Iterator[tuple[str, Command]]:
    """The commands on which a class is tried, as they are called for it."""
    for name in names:
        command = COMMANDS[name]
        if kind == "worker" and name in WORKING:
            assert isinstance(command, partial)
            yield name, partial(main, [*command.args[0], "--jobs", "2"])
        elif kind != "worker" and (kind, name) not in NOT_TRIED:
            yield name, command


def tried(kind: str, name: str, command: Command, times: int, chance: random.Random) -> list[str]:
    """The faults of one class on one command."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        context = multiprocessing.get_context("fork")
        painter = context.Process(target=prepare, args=(folder / "work",))
        painter.start()
        painter.join()
        place, start = folder / "case", time.monotonic()
        if status := finished(forked(command, place)):
            return [f"{name}: a quiet run ended with {status}: {said(place)}"]
        seconds = time.monotonic() - start
        quiet, faults = place.rename(folder / "quiet"), list[str]()
        for _ in range(times):
            faults += HARDSHIPS[kind](command, place, chance, seconds)
            set_back(kind)
            again = wrong_end(place, finished(forked(command, place)), {0})
            if kind == "change" and any(words in again for words in OTHER_INPUT):
                shutil.rmtree(place)  # what began with other bytes is refused, and begun anew
                again = wrong_end(place, finished(forked(command, place)), {0})
            set_back("")
            faults += [f"started again it {again}"] if again else []
            faults += differences(quiet / OUT, place / OUT)
            shutil.rmtree(place)
        return [f"{kind} {name}: {fault}" for fault in faults]


def set_back(kind: str) -> None:
    """Of ``clock``: a day, for what is started from now on."""
    if kind in ("clock", "") and "FAKETIME_TIMESTAMP_FILE" in os.environ:
        Path(os.environ["FAKETIME_TIMESTAMP_FILE"]).write_text("-1d" if kind else "+0")


def preloaded(kind: str) -> dict[str, str] | None:
    """What the process of a class wants in its environment; None where that cannot be had."""
    folder = Path(tempfile.mkdtemp())
    if kind == "clock":
        (folder / "clock").write_text("+0")
        more = {"FAKETIME_TIMESTAMP_FILE": str(folder / "clock"), "FAKETIME_NO_CACHE": "1"}
        return {"LD_PRELOAD": str(FAKETIME), **more} if FAKETIME.exists() else None
    if kind == "locks":
        source, library = folder / "locks.c", folder / "locks.so"
        source.write_text(NO_LOCKS)
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source], check=True)
        return {"LD_PRELOAD": str(library)}
    return {}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--classes", nargs="*", choices=HARDSHIPS, default=[*HARDSHIPS])
    parser.add_argument("--commands", nargs="*", choices=COMMANDS, default=[*COMMANDS])
    parser.add_argument("--times", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


if __name__ == "__main__":
    given = _arguments()
    if len(given.classes) > 1:  # each in a process of its own, as some are preloaded
        status = 0
        for each in given.classes:
            words = ["--commands", *given.commands, "--times", str(given.times)]
            environment = preloaded(each)
            if environment is None:
                print(f"{each}: left out, as libfaketime is not installed", flush=True)
                continue
            script = [sys.executable, __file__, "--classes", each, "--seed", str(given.seed)]
            status |= subprocess.call([*script, *words], env={**os.environ, **environment})
        sys.exit(status)
    load()
    if given.classes != ["clock"]:
        time.time = lambda: 1e9  # of events, as in scripts/faults.py
    [each], chance, count, found = given.classes, random.Random(given.seed), 0, list[str]()
    began = time.monotonic()
    for name, command in ways(each, given.commands):
        found += tried(each, name, command, given.times, chance)
        count += given.times
    minutes = (time.monotonic() - began) / 60
    print(f"{each:8} tried {count:4}  wrong {len(found):3}  in {minutes:.1f} minutes", flush=True)
    for line in found:
        print(f"  {line}", flush=True)
    sys.exit(1 if found else 0)
