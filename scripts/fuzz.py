"""Pictures that were tampered with: does reading them crash, hang, eat memory or hide the name?

    python scripts/fuzz.py                       # 10,000 pictures
    python scripts/fuzz.py --count 500 --seed 7 --out fuzzed

Rendered pictures in every format are mutated (bits, bytes, cuts, headers, swapped pieces, sizes,
modes, EXIF) and read with ``read_image`` in this process. A watchdog ends the process, with the
number of the picture, when one takes longer than --seconds; memory is what the process has held
at most. What failed is kept in --out under its number: read it, or give ``--only NUMBER``.
"""

import argparse
import faulthandler
import io
import random
import resource
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from roadtorch.errors import InputError
from roadtorch.image import read_image
from roadtorch.scenes import render_scene

COUNT, SEED, SECONDS, GIGABYTES = 10_000, 0, 20.0, 2.0
MODES = ("RGB", "L", "P", "RGBA", "1", "CMYK", "I;16")
FORMATS = ("JPEG", "PNG", "TIFF", "WEBP", "BMP")

Mutation = Callable[[bytearray, random.Random], None]


class Verdict(NamedTuple):
    """What became of a picture: "read", "refused", or what went wrong, and how long it took."""

    what: str
    seconds: float


# --- pictures ---------------------------------------------------------------------------


def whole_picture(draw: random.Random) -> bytes:
    """A rendered picture of a random size, mode, format and EXIF orientation."""
    size = draw.choice([(64, 48), (1, 1), (1, 90), (90, 1), (320, 240)])
    picture = _scene(draw.randrange(4)).resize(size)
    kind = draw.choice(FORMATS)
    exif = Image.Exif()
    exif[274] = draw.randrange(12)
    options = draw.choice([{}, {"exif": exif}, {"exif": draw.randbytes(60)}, {"progressive": True}])
    for mode in (draw.choice(MODES), "RGB"):
        data = io.BytesIO()
        try:
            picture.convert(mode).save(data, kind, **options)
            return data.getvalue()
        except Exception:  # Pillow raises anything
            options = {}  # this format knows no such mode or metadata
    data = io.BytesIO()
    picture.save(data, "PNG")
    return data.getvalue()


_SCENES: dict[int, Image.Image] = {}


def _scene(seed: int) -> Image.Image:
    if seed not in _SCENES:
        pixels = render_scene(seed).image.mul(255).round().byte().permute(1, 2, 0).numpy()
        _SCENES[seed] = Image.fromarray(np.ascontiguousarray(pixels))
    return _SCENES[seed]


# --- mutations --------------------------------------------------------------------------


def flip_bits(data: bytearray, draw: random.Random) -> None:
    """Turn one to eight bits anywhere."""
    for _ in range(draw.randint(1, 8)):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def break_header(data: bytearray, draw: random.Random) -> None:
    """Give bytes near the beginning values that are at the edge."""
    for _ in range(draw.randint(1, 4)):
        data[draw.randrange(min(len(data), 200))] = draw.choice((0, 1, 127, 128, 254, 255))


def cut(data: bytearray, draw: random.Random) -> None:
    """Leave out everything behind some place."""
    del data[max(1, draw.randrange(len(data))) :]


def leave_out(data: bytearray, draw: random.Random) -> None:
    """Leave out a piece inside."""
    at = draw.randrange(len(data))
    del data[at : at + draw.randint(1, 200)]
    data += b"\0" * (not data)


def swap(data: bytearray, draw: random.Random) -> None:
    """Let two pieces of one length change places."""
    length = draw.randint(1, max(1, len(data) // 4))
    one, two = (draw.randrange(len(data) - length + 1) for _ in range(2))
    data[one : one + length], data[two : two + length] = (
        data[two : two + length],
        data[one : one + length],
    )


def repeat(data: bytearray, draw: random.Random) -> None:
    """Insert a piece once more somewhere else."""
    at = draw.randrange(len(data))
    to = draw.randrange(len(data))
    data[to:to] = data[at : at + draw.randint(1, 500)]


def resize(data: bytearray, draw: random.Random) -> None:
    """Write large or odd numbers where a format keeps width and height."""
    places = {b"\xff\xd8": _frame_header(data), b"\x89P": 18, b"BM": 18, b"RI": 26}
    at = places.get(bytes(data[:2]), draw.randrange(len(data)))
    number = draw.choice((0, 1, 3, 255, 13_000, 30_000, 65_535)).to_bytes(2, draw.choice(ENDS))
    data[at : at + 2] = number


ENDS = ("big", "little")


def _frame_header(data: bytearray) -> int:
    """Where a JPEG has its height."""
    return max(data.find(b"\xff\xc0"), data.find(b"\xff\xc2"), 0) + 5


MUTATIONS: tuple[Mutation, ...] = (
    *(flip_bits, break_header, cut, leave_out, swap, repeat, resize),
)


def mutated(number: int, seed: int) -> bytes:
    """Picture ``number`` of the run with that seed: the same bytes wherever it is made."""
    draw = random.Random(f"{seed} {number}")
    data = bytearray(whole_picture(draw))
    for _ in range(draw.randint(1, 3)):
        draw.choice(MUTATIONS)(data, draw)
    return bytes(data)


# --- reading ----------------------------------------------------------------------------


def judge(path: Path, seconds: float) -> Verdict:
    """Read a picture, and say what became of it; the watchdog ends the process after a hang."""
    faulthandler.dump_traceback_later(seconds, exit=True)
    start = time.perf_counter()
    try:
        image = read_image(path)
        fine = bool((image >= 0).all() and (image <= 1).all()) and image.ndim == 3
        what = "read" if fine else "values outside [0,1]"
    except InputError as problem:
        what = "refused" if str(path) in str(problem) else f"the name is missing: {problem}"
    except Exception as problem:
        what = f"crash: {type(problem).__name__}: {problem}"
    finally:
        faulthandler.cancel_dump_traceback_later()
    return Verdict(what, time.perf_counter() - start)


def gigabytes() -> float:
    """The most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def fuzz(numbers: Sequence[int], seed: int, seconds: float, out: Path) -> Counter[str]:
    """Make and read the pictures of those numbers; counts by verdict. Failures stay in ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    found: Counter[str] = Counter()
    slowest = 0.0
    for number in numbers:
        path = out / f"{seed}-{number}.bin"
        path.write_bytes(mutated(number, seed))  # before reading: it survives a crash of ours
        before = gigabytes()
        verdict = judge(path, seconds)
        slowest = max(slowest, verdict.seconds)
        what = verdict.what
        if before < GIGABYTES <= gigabytes():
            what = f"{gigabytes():.1f} GiB"
        found[what] += 1
        if what in ("read", "refused"):
            path.unlink()
        else:
            print(f"{path}: {what}", file=sys.stderr)
    print(f"slowest {slowest:.1f} s, at most {gigabytes():.2f} GiB", file=sys.stderr)
    return found


def main(words: Sequence[str] | None = None) -> int:
    options = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    options.add_argument("--count", type=int, default=COUNT)
    options.add_argument("--seed", type=int, default=SEED)
    options.add_argument("--seconds", type=float, default=SECONDS, help="a hang, beyond these")
    options.add_argument("--only", type=int, help="the number of one picture")
    options.add_argument("--out", type=Path, default=Path("fuzzed"))
    chosen = options.parse_args(words)
    numbers = range(chosen.count) if chosen.only is None else [chosen.only]
    found = fuzz(numbers, chosen.seed, chosen.seconds, chosen.out)
    for what, count in found.most_common():
        print(f"{count:6} {what}")
    return 0 if set(found) <= {"read", "refused"} else 1


if __name__ == "__main__":
    sys.exit(main())
