"""Files that were tampered with: does reading them crash, hang, eat memory or hide the name?

    python scripts/fuzz.py                                    # 10,000 pictures
    python scripts/fuzz.py --kind all --count 1000 --seed 7   # of each kind
    python scripts/fuzz.py --kind weights --only 17           # one of them again
    python scripts/fuzz.py --kind weights --read fuzzed/weights-0-17/net.safetensors

Files of our own making are mutated (bits, bytes, cuts, headers, values, sizes, texts that trip
parsers) and read in this process by what reads them in the package. Right is what is read, or
refused with one line that names the file. A watchdog ends the process, with the stack, when one
takes longer than --seconds; memory is the most that the process held meanwhile. What failed is
kept in --out.
"""

import argparse
import faulthandler
import random
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadtorch.errors import RoadtorchError
from roadtorch.runtime.memory import forget_peak, peak_mebibytes
from scripts import fuzz_labels, fuzz_pictures, fuzz_results, fuzz_settings, fuzz_weights

COUNT, SEED, SECONDS, GIGABYTES = 10_000, 0, 20.0, 2.0
STDERR = 2  # whatever sys.stderr is meanwhile
LONGEST = 1_500  # letters of a refusal, its file's name left out

READ, REFUSED = "read", "refused"


class Kind(NamedTuple):
    """A kind of files.

    make: writes one that was tampered with, and what belongs to it, into a folder. read: reads
    it as the package does; returns whether what was read makes sense.
    """

    make: Callable[[Path, random.Random], Path]
    read: Callable[[Path], bool]


KINDS: Mapping[str, Kind] = {
    "pictures": Kind(fuzz_pictures.make_picture, fuzz_pictures.read_picture),
    "weights": Kind(fuzz_weights.make_network, fuzz_weights.read_network),
    "arrays": Kind(fuzz_weights.make_arrays, fuzz_weights.read_prepared),
    "checkpoints": Kind(fuzz_weights.make_checkpoint, fuzz_weights.read_checkpoint),
    "configs": Kind(fuzz_settings.make_config, fuzz_settings.read_config),
    "sets": Kind(fuzz_settings.make_assignments, fuzz_settings.read_assignments),
    "camera": Kind(fuzz_settings.make_camera, fuzz_settings.read_camera),
    "labelme": Kind(fuzz_labels.make_labelme, fuzz_labels.read_truth),
    "xml": Kind(fuzz_labels.make_xml, fuzz_labels.read_truth),
    "labels": Kind(fuzz_labels.make_labels, fuzz_labels.read_label_picture),
    "conditions": Kind(fuzz_labels.make_conditions, fuzz_labels.read_conditions),
    "calibration": Kind(fuzz_labels.make_calibration, fuzz_labels.read_from_above),
    "index": Kind(fuzz_results.make_index, fuzz_results.read_rows),
    "results": Kind(fuzz_results.make_results, fuzz_results.read_results),
    "maps": Kind(fuzz_results.make_map, fuzz_results.read_likelihood),
    "metrics": Kind(fuzz_results.make_metrics, fuzz_results.read_thresholds),
    "progress": Kind(fuzz_results.make_progress, fuzz_results.read_progress),
    "records": Kind(fuzz_results.make_record, fuzz_results.read_record),
}


class Verdict(NamedTuple):
    """What became of a file: "read", "refused", or what went wrong; seconds, and GiB at most."""

    what: str
    seconds: float
    gigabytes: float


# --- one file ---------------------------------------------------------------------------


def made(kind: str, number: int, seed: int, out: Path) -> Path:
    """File ``number`` of the run with that seed, in a folder of its own: always the same bytes."""
    folder = out / f"{kind}-{seed}-{number}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return KINDS[kind].make(folder, random.Random(f"{seed} {number}"))


def judge(path: Path, read: Callable[[Path], bool], seconds: float) -> Verdict:
    """Read a file, and say what became of it; the watchdog ends the process after a hang."""
    faulthandler.dump_traceback_later(seconds, exit=True, file=STDERR)
    forget_peak()
    start = time.perf_counter()
    try:
        what = READ if read(path) else "what was read makes no sense"
    except RoadtorchError as problem:
        what = _of_refusal(str(problem), path)
    except Exception as problem:
        what = f"crash: {type(problem).__name__}: {str(problem)[:200]}"
    finally:
        faulthandler.cancel_dump_traceback_later()
    took, most = time.perf_counter() - start, peak_mebibytes() / 2**10
    if most > GIGABYTES:
        what = f"{most:.1f} GiB"
    return Verdict(what, took, most)


def _of_refusal(told: str, path: Path) -> str:
    """Whether a refusal is right: short, with the name of the file in it."""
    if path.name not in told:
        return f"the name is missing: {told[:200]}"
    if len(told) > LONGEST + 3 * len(str(path)):
        return f"a refusal of {len(told)} letters"
    return REFUSED


# --- memory -----------------------------------------------------------------------------


# --- many -------------------------------------------------------------------------------


def fuzz(kind: str, numbers: Sequence[int], seed: int, seconds: float, out: Path) -> Counter[str]:
    """Make and read the files of those numbers; counts by verdict. Failures stay in ``out``."""
    found: Counter[str] = Counter()
    slowest = largest = 0.0
    for number in numbers:
        path = made(kind, number, seed, out)  # on disk before reading: it survives a crash of ours
        verdict = judge(path, KINDS[kind].read, seconds)
        slowest, largest = max(slowest, verdict.seconds), max(largest, verdict.gigabytes)
        found[verdict.what] += 1
        if verdict.what in (READ, REFUSED):
            shutil.rmtree(path.parent)
        else:
            print(f"{path}: {verdict.what}", file=sys.stderr)
    told = f"{found[READ]:6} read {found[REFUSED]:6} refused {wrong(found):4} wrong"
    print(f"{kind:12}{told}; slowest {slowest:.2f} s, at most {largest:.2f} GiB", flush=True)
    return found


def wrong(found: Counter[str]) -> int:
    """How many were neither read nor refused."""
    return found.total() - found[READ] - found[REFUSED]


def main(words: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--kind", choices=[*KINDS, "all"], default="pictures")
    options.add_argument("--count", type=int, default=COUNT, help="files of each kind")
    options.add_argument("--seed", type=int, default=SEED)
    options.add_argument("--seconds", type=float, default=SECONDS, help="a hang, beyond these")
    options.add_argument("--only", type=int, help="the number of one file")
    options.add_argument("--read", type=Path, help="read this file of --kind instead")
    options.add_argument("--out", type=Path, default=Path("fuzzed"))
    chosen = options.parse_args(words)
    if chosen.read:
        verdict = judge(chosen.read, KINDS[chosen.kind].read, chosen.seconds)
        print(verdict.what)
        return 0 if verdict.what in (READ, REFUSED) else 1
    numbers = range(chosen.count) if chosen.only is None else [chosen.only]
    kinds = list(KINDS) if chosen.kind == "all" else [chosen.kind]
    found = [fuzz(kind, numbers, chosen.seed, chosen.seconds, chosen.out) for kind in kinds]
    return 1 if any(map(wrong, found)) else 0


if __name__ == "__main__":
    sys.exit(main())
