"""What is read of tampered pictures, videos, bags and archives is what others read of them.

    python -m pytest tests/fuzz/test_second_opinion.py                                # some
    python -m pytest tests/fuzz/test_second_opinion.py --hypothesis-profile long -s   # COUNTS

Right is what equals the opinion of a decoder that is not ours, or is refused by its name: Pillow
and tifffile of pictures, a plain loop of PyAV of videos, whose number of frames is known, and of
bags and archives what was put in. A part of footage is right when it says what is missing.
"""

import io
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import Any

import av
import av.error
import numpy as np
import pytest
import tifffile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image, ImageOps

from roadtorch.errors import InputError, RoadtorchError
from roadtorch.io.image import read_image
from roadtorch.runtime.memory import forget_peak, peak_mebibytes
from roadtorch.sources.archives import archive_source
from roadtorch.sources.bags import bag_source
from roadtorch.sources.frame import Selection, Source
from roadtorch.sources.video import video_source
from tests.fuzz.pictures import OF_PICTURES, scene, whole_picture
from tests.fuzz.tampered import OF_BYTES, Draw, one_of, tampered, written
from tests.io.test_image import TURNS
from tests.sources.bags import FIRST, ROS1, ROS2, STEP, raw_image, write_bag
from tests.sources.test_archives import write_archive
from tests.videos import write_video

COUNTS = {"pictures": 3_000, "videos": 500, "bags": 500, "archives": 300}
SECONDS, MEBIBYTES = 10, 1_500
SOME, MANY = 50, 1_000
UNHURRIED = [HealthCheck.too_slow, HealthCheck.data_too_large]
CLOSE = 1.5 / 255  # on average; decoders round otherwise, and Pillow reads 16 bits of RGB as 8
READ, PART, REFUSED = "read", "a part, and it says so", "refused"
WRONG = "wrong"


def mostly_tampered(draw: Draw, data: bytes, kinds: tuple[str, ...] = OF_BYTES) -> bytes:
    return data if one_of(draw, *range(8)) == 0 else tampered(draw, data, kinds)


# --- pictures -----------------------------------------------------------------------------

LAYOUTS = [
    *(("minisblack", 1, None), ("minisblack", 2, "unassalpha"), ("rgb", 3, None)),
    *(("rgb", 4, kind) for kind in ("unassalpha", "assocalpha", "unspecified")),
]


def whole_tiff(draw: Draw) -> bytes:
    """Of any layout, 8 or 16 bits."""
    colours, samples, extra = one_of(draw, *LAYOUTS)
    pixels = np.asarray(scene(one_of(draw, 0, 1)).resize((53, 37)))
    alpha = pixels[..., :1]
    if extra == "assocalpha":  # which colours are multiplied with
        pixels = np.minimum(pixels, alpha)
    pixels = np.dstack([pixels[..., : samples - bool(extra)], alpha])[..., :samples]
    if one_of(draw, 8, 16) == 16:
        pixels = pixels.astype(np.uint16) * 257
    stored, planes = pixels[..., 0] if samples == 1 else pixels, None
    if samples > 1:
        planes = one_of(draw, "contig", "separate")
        stored = np.moveaxis(pixels, -1, 0) if planes == "separate" else pixels
    data = io.BytesIO()
    form: dict[str, Any] = one_of(draw, {"rowsperstrip": 10}, {"tile": (16, 16)}, {})
    tifffile.imwrite(
        data, stored, photometric=colours, planarconfig=planes, **form,
        extrasamples=[extra] if extra else None, byteorder=one_of(draw, "<", ">"),
        compression=one_of(draw, None, None, "zlib"),
    )  # fmt: skip
    return data.getvalue()


def make_picture(draw: Draw, folder: Path) -> Path:
    data = whole_tiff(draw) if one_of(draw, 0, 1, 2) == 0 else whole_picture(draw)
    return written(folder / "picture.bin", mostly_tampered(draw, data, OF_PICTURES))


def pillows(data: bytes) -> np.ndarray:
    """(H,W,3) in [0,1]."""
    with Image.open(io.BytesIO(data), formats=("JPEG", "PNG", "TIFF", "WEBP", "BMP")) as picture:
        picture.load()
        upright: Image.Image = picture
        with suppress(SyntaxError):  # EXIF that is none
            upright = ImageOps.exif_transpose(picture)
        if upright.mode.startswith("I"):
            return np.repeat(np.array(upright).astype(float)[..., None] / 65535, 3, 2)
        pixels = np.array(upright.convert("RGBA")) / 255
        return pixels[..., :3] * (pixels[..., 3:] if upright.has_transparency_data else 1)


def tifffiles(data: bytes) -> np.ndarray:
    """(H,W,3) in [0,1], of grey and RGB."""
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        page: Any = file.pages.first
        if page.photometric not in (1, 2) or page.dtype not in (np.uint8, np.uint16):
            raise ValueError("another kind")
        pixels = page.asarray(squeeze=False)[:, 0]
        pixels = np.moveaxis(pixels, 0, -1).reshape(*pixels.shape[1:3], -1)
        shares = pixels / np.iinfo(page.dtype).max
        colours = 3 if page.photometric == 2 else 1
        alpha = shares[..., colours : colours + 1] if page.extrasamples[:1] == (2,) else 1
        found = np.broadcast_to(shares[..., :colours] * alpha, (*shares.shape[:2], 3))
        return TURNS.get(page.tags.valueof(274), np.asarray)(found)


def judge_picture(path: Path) -> str:
    image, data = read_image(path).permute(1, 2, 0).numpy(), path.read_bytes()
    opinions = (tifffiles, pillows) if data[:2] in (b"II", b"MM") else (pillows,)
    for opinion in opinions:
        try:
            with warnings.catch_warnings(action="ignore"):
                other = opinion(data)
        except Exception:  # decoders of foreign bytes raise anything
            continue
        far = np.abs(image - other).mean() if image.shape == other.shape else 1.0
        return READ if far < CLOSE else f"{WRONG}: {far:.3f} from {opinion.__name__}"
    return f"{WRONG}: read by us alone"


# --- footage ------------------------------------------------------------------------------

FRAMES = 12
CODECS = {
    **{".mp4": "libx264", ".mov": "mpeg4", ".avi": "mjpeg", ".mkv": "libx264"},
    **{".webm": "libvpx", ".m4v": "mpeg4"},
}


def judge_source(source: Source, is_same: Callable[[int, np.ndarray], bool], every: int) -> str:
    """Whether all frames are there and are those that were put in, or something is said of it.

    is_same: whether pixels (H,W,3) are those of the frame of a number.
    """
    outcomes: list[str] = []
    try:
        for frame in source.frames():
            try:
                pixels = frame.read().mul(255).round().permute(1, 2, 0).numpy()
            except InputError as problem:
                outcomes.append(REFUSED if problem.where == frame.origin else "has another name")
            else:
                outcomes.append(READ if is_same(frame.number, pixels) else "is another one")
    except InputError as problem:
        assert_named(problem, source.origin)
        return PART if READ in outcomes else REFUSED
    wrong = [outcome for outcome in outcomes if outcome not in (READ, REFUSED)]
    if wrong or len(outcomes) != every:
        return f"{WRONG}: {len(outcomes)} of {every} frames, {wrong}, and not a word"
    return READ if REFUSED not in outcomes else PART if READ in outcomes else REFUSED


def assert_named(problem: RoadtorchError, name: str) -> None:
    assert name in str(problem)


@cache
def video(suffix: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        seconds = [number / 10 for number in range(FRAMES)]
        path = Path(folder, f"a{suffix}")
        return write_video(path, seconds, codec=CODECS[suffix], ticks=10).read_bytes()


def make_video(draw: Draw, folder: Path) -> Path:
    suffix = one_of(draw, *CODECS)
    return written(folder / f"drive{suffix}", mostly_tampered(draw, video(suffix)))


def packets(container: Any, stream: Any) -> Iterator[Any]:
    """Those that can be read, and None for what the decoder still holds."""
    with suppress(av.error.FFmpegError):
        yield from (packet for packet in container.demux(stream) if packet.size)
    yield None


def judge_video(path: Path) -> str:
    def is_same(number: int, pixels: np.ndarray) -> bool:
        return pixels.shape == others[number].shape and bool((pixels == others[number]).all())

    others: list[np.ndarray] = []
    hidden, is_bare = 0, False
    with suppress(av.error.FFmpegError, ValueError, IndexError), av.open(str(path)) as container:
        stream, is_bare = container.streams.video[0], container.format.name == "mjpeg"
        stream.thread_type = "NONE"
        for packet in packets(container, stream):
            hidden += bool(packet and packet.is_discard)  # by an edit list
            with suppress(av.error.FFmpegError):
                for picture in stream.decode(packet):
                    turned = round(picture.rotation / 90)
                    others.append(np.rot90(picture.to_ndarray(format="rgb24"), turned))
    # Pictures one after the other, which is left where AVI's own header is gone, have no length.
    every = len(others) if is_bare else FRAMES - hidden
    return judge_source(video_source(path, "drive", Selection()), is_same, every)


BAGS = ("bag", "sqlite3", "mcap")


@cache
def bag(form: str) -> Mapping[str, bytes]:
    """The files of a bag by name."""
    with tempfile.TemporaryDirectory() as folder:
        store = ROS1 if form == "bag" else ROS2
        images = [
            raw_image(store, np.asarray(scene(number)), "rgb8", FIRST + STEP * number)
            for number in range(3)
        ]
        path = write_bag(
            Path(folder, "drive.bag" if form == "bag" else "drive"), {"/i": images}, form
        )
        files = [path] if form == "bag" else sorted(path.iterdir())
        return {file.name: file.read_bytes() for file in files}


def make_bag(draw: Draw, folder: Path) -> Path:
    form = one_of(draw, *BAGS)
    files = bag(form)
    path = folder / ("drive.bag" if form == "bag" else "drive")
    if form != "bag":
        path.mkdir()
    spoiled = one_of(draw, *files)
    for name, data in files.items():
        place = path if form == "bag" else path / name
        place.write_bytes(mostly_tampered(draw, data) if name == spoiled else data)
    return path


def judge_bag(path: Path) -> str:
    def is_same(number: int, pixels: np.ndarray) -> bool:
        """But for the bytes that were changed: without compression bags have no checksum."""
        return bool((pixels == np.asarray(scene(number))).mean() > 0.99)

    return judge_source(bag_source(str(path)), is_same, 3)


# --- archives -----------------------------------------------------------------------------

ARCHIVES = (".zip", ".tar", ".tar.gz", ".tar.xz")


@cache
def archive(suffix: str) -> bytes:
    members = {}
    for number in range(4):
        member = io.BytesIO()
        scene(number).save(member, "PNG")
        members[f"{number}.png"] = member.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        return write_archive(Path(folder, f"many{suffix}"), members).read_bytes()


def make_archive(draw: Draw, folder: Path) -> Path:
    suffix = one_of(draw, *ARCHIVES)
    return written(folder / f"many{suffix}", mostly_tampered(draw, archive(suffix)))


def judge_archive(path: Path) -> str:
    def is_same(_: int, pixels: np.ndarray) -> bool:
        return any(bool((pixels == np.asarray(scene(seed))).all()) for seed in range(4))

    data, every = path.read_bytes(), 4
    if path.suffix == ".tar":  # two letters of a name that change places keep its checksum
        heads = [data[at : at + 512] for at in range(0, len(data), 512)]
        names = {head[:100].rstrip(b"\0") for head in heads if head[257:262] == b"ustar"}
        every = sum(name[:1] != b"." and name.endswith(b".png") for name in names)
    return judge_source(archive_source(str(path)), is_same, every)


MAKE: dict[str, tuple[Callable[[Draw, Path], Path], Callable[[Path], str]]] = {
    "pictures": (make_picture, judge_picture),
    "videos": (make_video, judge_video),
    "bags": (make_bag, judge_bag),
    "archives": (make_archive, judge_archive),
}


@pytest.mark.parametrize("kind", MAKE)
def test_what_is_read_is_what_others_read(kind: str) -> None:
    make, judge = MAKE[kind]
    seen: Counter[str] = Counter()
    slowest, peak = 0.0, 0.0
    count = COUNTS[kind] if settings().max_examples > MANY else SOME

    @settings(max_examples=count, suppress_health_check=UNHURRIED)
    @given(st.data())
    def check(data: st.DataObject) -> None:
        nonlocal slowest, peak
        with tempfile.TemporaryDirectory() as folder:
            path = make(data.draw, Path(folder))
            forget_peak()
            start = perf_counter()
            try:
                outcome = judge(path)
            except RoadtorchError as problem:
                assert_named(problem, path.name)
                outcome = REFUSED
            slowest = max(slowest, perf_counter() - start)
            peak = max(peak, peak_mebibytes())
            seen[outcome] += 1
            assert not outcome.startswith(WRONG), outcome

    check()

    print(f"{kind}: {dict(seen)}; slowest {slowest:.1f} s, at most {peak:.0f} MiB")
    assert seen[READ] > 0
    assert slowest < SECONDS
    assert peak < MEBIBYTES
