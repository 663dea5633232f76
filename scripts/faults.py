"""Fail the n-th open, write, fsync, rename and close of a command; then start it again.

    python scripts/faults.py infer                 every case
    python scripts/faults.py annotate --every 9    one case in nine

As SQLite is tested (sqlite.org/atomiccommit.html, testing.html). Each case fills a folder of its
own: a run meets one fault below its --out (ENOSPC: the disk stays full; EIO; EINTR; a write that is
cut short; KILL right behind the call), tells no traceback, and the same command is started again.
Then the files have to be those of a quiet run, byte for byte, and no other file may be there; what
``annotate`` has acknowledged is in its logs before that. scripts/faults.c stands for the calls;
it needs Linux and a C compiler. Each broken case is a line, and the exit status is then 1.
"""

import argparse
import ctypes
import errno
import mmap
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.base.image import write_mask
from roadtorch.cli import main
from roadtorch.data.events import BrushStroke, LogHead, append_event, log_path, read_logs
from roadtorch.testing.scenes import render_scene, write_picture
from scripts.torture import ADAPTING, ASKED, OUT, TRAINING, become, differences, ended, load

KINDS = ("open", "write", "fsync", "rename", "close")
FAULTS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EINTR": errno.EINTR, "KILL": -1, "SHORT": -2}
IMPOSSIBLE = {("rename", "EINTR"), ("close", "ENOSPC")}
ONLY_WRITES = "SHORT"
PATIENCE = 120.0  # seconds of one run
COUNTS = mmap.mmap(-1, 8 * len(KINDS))
"""How often each call was made by the run, which is another process."""

CALIBRATION = """P2: 72 0 40 0 0 72 30 0 0 0 1 0
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_cam_to_road: 1 0 0 0 0 1 0.02 -1.6 0 -0.02 1 0
"""
SMALL = ("count = 2", "count = 1"), ("epochs = 3", "epochs = 2")

DETECTOR = ["--detector", "prior:rows"]
IMAGES = "../work/image_2"


def annotate() -> None:
    """Draw as the page does, three strokes on two pictures; each is noted once it is taken."""
    from roadtorch.annotate.session import opened_session
    from roadtorch.base.errors import RoadtorchError
    from roadtorch.detectors.catalogue import load_detector

    out = Path(OUT)
    out.mkdir(exist_ok=True)
    try:
        session = opened_session(Path(IMAGES), out, load_detector("prior:rows"))
        for number, name in enumerate(sorted(session.pictures.names())[:2] * 2):
            session.add(name, "ann", stroke(number))
            with Path("acknowledged").open("a") as notes:
                print(number, file=notes)
    except (RoadtorchError, OSError) as problem:
        raise SystemExit(f"roadtorch: error: {problem}") from None  # as the server tells it


def stroke(number: int) -> BrushStroke:
    """A stroke of a number."""
    point = (10.0 + number, 40.0)
    return BrushStroke(kind="brush", id=f"s{number}", saying="road", points=(point,), radius=5.0)


def called(*words: str) -> Callable[[], None]:
    """The command of these words."""
    return partial(main, [*words])


COMMANDS: Mapping[str, Callable[[], None]] = {
    "infer": called(
        "infer", IMAGES, *DETECTOR, "--save", "mask,overlay,npy,polygons", "--out", OUT
    ),
    "evaluate": called("evaluate", "folder", "../work", *DETECTOR, "--out", OUT),
    "annotate": annotate,
    "import": called(
        *("annotate", IMAGES, "--out", OUT, "--import", "png", "--from", "../work/drawn")
    ),
    "corrections": called(
        *("annotate", IMAGES, "--out", "../work/corrections", "--export", "coco", "--to", OUT)
    ),
    "grid": called(
        *("grid", IMAGES, *DETECTOR, "--height", "1.5", "--pitch", "2", "--fov", "90", "--out", OUT)
    ),
    "label": called("label", IMAGES, "--out", OUT),
    "submit": called("submit", "../work", *DETECTOR, "--out", OUT),
    "tune": called("tune", "folder", "../work", *DETECTOR, "--out", OUT),
    "train": called(
        *("train", "--config", "../work/training.toml", "--images", IMAGES, "--resume"),
        *("--corrections", "../work/corrections", "--threads", "1", "--out", OUT),
    ),
    "adapt": called(
        *("adapt", IMAGES, *(word for change in ADAPTING for word in ("--set", change))),
        *("--threads", "1", "--out", OUT),
    ),
    "export": called("export", "fusion", "--out", f"{OUT}/net.onnx"),
}


def prepare(work: Path) -> None:
    """Two labelled streets, also as KITTI has them, corrected and drawn, and a small training."""
    for seed, name in enumerate(("um_000000.png", "um_000001.png")):
        scene = render_scene(seed, 60, 80)
        write_picture(work / "image_2" / name, scene)
        write_picture(work / "images" / name, scene)
        (work / "masks").mkdir(exist_ok=True)
        write_mask(work / "masks" / name, scene.road)
        (work / "calib").mkdir(exist_ok=True)
        (work / "calib" / f"{Path(name).stem}.txt").write_text(CALIBRATION)
        head = LogHead(picture=f"../image_2/{name}", user="ann", height=60, width=80)
        append_event(log_path(work / "corrections", name, "ann"), head, stroke(seed))
    text = TRAINING
    for old, new in SMALL:
        text = text.replace(old, new)
    (work / "training.toml").write_text(text)
    words = ["annotate", str(work / "image_2"), "--out", str(work / "corrections")]
    main([*words, "--export", "png", "--to", str(work / "drawn")], standalone_mode=False)


def run(command: Callable[[], None], place: Path, kind: str, number: int, fault: int) -> int | None:
    """A run that meets one fault, none where the number is 0; its status, None where it hangs."""
    place.mkdir(exist_ok=True)
    COUNTS[:] = bytes(len(COUNTS))

    def armed() -> None:
        counts = (ctypes.c_long * len(KINDS)).from_buffer(COUNTS)
        folder = str((place / OUT).resolve()).encode()
        ctypes.CDLL(None).faults_arm(
            folder, KINDS.index(kind), ctypes.c_long(number), fault, counts
        )
        command()

    signal.pthread_sigmask(signal.SIG_BLOCK, ASKED)
    if (child := os.fork()) == 0:
        become(armed, place)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKED)
    status = ended(child, PATIENCE)
    if status is None:
        os.kill(child, signal.SIGKILL)
        ended(child)
    return status


def calls() -> dict[str, int]:
    """How often each call was made by the last run."""
    return dict(zip(KINDS, memoryview(COUNTS).cast("l"), strict=True))


def broken(
    command: Callable[[], None], place: Path, quiet: Path, case: tuple[str, int, str]
) -> list[str]:
    """What is wrong with one case."""
    kind, number, fault = case
    status = run(command, place, kind, number, FAULTS[fault])
    told = (place / "told").read_text(errors="replace")
    if status not in (0, 1, 2, -signal.SIGKILL) or "Traceback" in told or "report it" in told:
        return [f"ended with {status}: {' / '.join(told.strip().splitlines()[-6:])}"]
    if (notes := place / "acknowledged").exists():
        kept = {event.id for log in read_logs(place / OUT) for event in log.events}
        taken = {f"s{line}" for line in notes.read_text().split()}
        if taken - kept:
            return [f"lost {sorted(taken - kept)}, which were acknowledged"]
    status = run(command, place, kind, 0, 0)
    told = (place / "told").read_text(errors="replace").strip().splitlines()
    found = [] if status == 0 else [f"started again it ended with {status}: {told[-3:]}"]
    return found + list(differences(quiet / OUT, place / OUT))


def cases(counts: Mapping[str, int], every: int) -> Iterator[tuple[str, int, str]]:
    """Kind, number and fault of one case in ``every``."""
    all_of_them = (
        (kind, number, fault)
        for kind, count in counts.items()
        for number in range(1, count + 1)
        for fault in FAULTS
        if (kind, fault) not in IMPOSSIBLE and (fault != ONLY_WRITES or kind == "write")
    )
    yield from (case for at, case in enumerate(all_of_them) if at % every == 0)


def preloaded() -> None:
    """Start this script again behind the library that fails calls, unless it is there."""
    if "FAULTS" in os.environ:
        return
    folder = tempfile.mkdtemp()
    library, source = f"{folder}/faults.so", Path(__file__).with_suffix(".c")
    compiled = ["cc", "-shared", "-fPIC", "-O1", "-o", library, str(source), "-ldl"]
    subprocess.run(compiled, check=True)
    os.environ.update(FAULTS=folder, LD_PRELOAD=library)
    os.execv(sys.executable, [sys.executable, *sys.argv])


def inject(name: str, every: int, folder: Path) -> list[str]:
    """What was broken in a command; how many cases there were is told."""
    command, quiet = COMMANDS[name], folder / "quiet"
    if (child := os.fork()) == 0:  # torch's threads survive no fork
        become(partial(prepare, folder / "work"), folder)
    place = folder / "case"  # one name for all runs, as some files have it inside
    if ended(child) != 0 or run(command, place, "open", 0, 0) != 0:
        raise SystemExit((folder / "told").read_text() + (place / "told").read_text())
    place.rename(quiet)
    counts, wrong = calls(), []
    chosen = list(cases(counts, every))
    for case in chosen:
        found = broken(command, place, quiet, case)
        wrong += [f"{name}: {case[0]} {case[1]} {case[2]}: {one}" for one in found]
        shutil.rmtree(place)
    told = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    print(f"{name}: {len(chosen)} cases ({told}); {len(wrong)} broken", flush=True)
    return wrong


if __name__ == "__main__":
    preloaded()
    shutil.rmtree(os.environ["FAULTS"])
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("commands", nargs="*", choices=[*COMMANDS, []], default=[])
    parser.add_argument("--every", type=int, default=1, help="one case in so many")
    given = parser.parse_args()
    load()
    time.time = lambda: 1e9  # of events, as each is done twice
    faults = []
    for chosen in given.commands or COMMANDS:
        with tempfile.TemporaryDirectory() as temporary:
            faults += inject(chosen, given.every, Path(temporary))
    for line in faults:
        print(f"  {line}")
    sys.exit(1 if faults else 0)
