"""Pictures in archives and behind URLs: order, names, damage, bombs. No network."""

import io
import struct
import tarfile
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import cv2
import fsspec
import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.base import decoding
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.inputs import archives
from roadtorch.inputs.archives import archive_source, is_archive
from roadtorch.inputs.find import open_source
from roadtorch.inputs.item import Selection


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (24, 32, 3)).astype(np.uint8)


def png(seed: int) -> bytes:
    return cv2.imencode(".png", picture(seed)[..., ::-1])[1].tobytes()


def image(seed: int) -> Tensor:
    return torch.from_numpy(picture(seed)).permute(2, 0, 1) / 255


PICTURES = {"b/2.png": png(2), "b/1.png": png(1), "a.png": png(0), "notes.txt": b"no"}


def write_zip(path: Path, members: Mapping[str, bytes] = PICTURES) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def write_tar(path: Path, members: Mapping[str, bytes] = PICTURES) -> Path:
    kind = path.suffixes[-1][1:].removeprefix("t").removeprefix("ar")
    with tarfile.open(path, f"w:{kind}") as archive:  # pyright: ignore
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(data)
            archive.addfile(info, io.BytesIO(data))
    return path


def write_archive(path: Path, members: Mapping[str, bytes] = PICTURES) -> Path:
    return write_zip(path, members) if path.suffix == ".zip" else write_tar(path, members)


def read_all(given: object) -> dict[str, Tensor | str]:
    """The image of each item by its name, or why there is none; ``end``: why there are no more."""
    images: dict[str, Tensor | str] = {}
    try:
        for item in open_source(str(given), Selection()).items():
            try:
                images[item.name] = item.read()
            except InputError as problem:
                images[item.name] = str(problem)
    except InputError as problem:
        images["end"] = str(problem)
    return images


@pytest.fixture
def memory() -> Iterator[fsspec.AbstractFileSystem]:
    system = fsspec.filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


NAMES = ["pictures.zip", "pictures.tar", "pictures.tar.gz", "pictures.tgz", "pictures.tar.xz"]


@pytest.mark.parametrize("name", [*NAMES, "pictures.tar.bz2"])
def test_gives_the_pictures_sorted_by_name(tmp_path: Path, name: str) -> None:
    path = write_archive(tmp_path / name)
    source = archive_source(str(path))

    assert is_archive(str(path))
    assert (source.name, source.moving) == ("pictures", False)
    for number, (item, expected) in enumerate(
        zip(source.items(), ["a", "b/1", "b/2"], strict=True)
    ):
        assert (item.name, item.number, item.seconds) == (expected, number, None)
        assert item.origin == f"{path}!{expected}.png"
        assert torch.equal(item.read(), image(number))
    chosen = archive_source(str(path), Selection(every=2)).items()
    assert [item.name for item in chosen] == ["a", "b/2"]


def test_urls_of_folders_files_globs_and_archives(
    tmp_path: Path, memory: fsspec.AbstractFileSystem
) -> None:
    path = write_zip(tmp_path / "pictures.zip")
    for name, data in PICTURES.items():
        memory.pipe(f"/set/{name}", data)
    memory.pipe("/pictures.zip", path.read_bytes())
    tar = write_tar(tmp_path / "pictures.tar.gz")
    all_names = ["a", "b/1", "b/2"]

    for url, names in {
        "memory://set": all_names,
        "memory://set/b/1.png": ["1"],
        "memory://set/b/*.png": ["1", "2"],
        "memory://pictures.zip": all_names,
        f"zip://::{path}": all_names,
        f"zip://b::{path}": ["b/1", "b/2"],
        f"zip://b/2.png::{path}": ["b/2"],
        f"zip://*/1.png::{path}": ["b/1"],
        "zip://b::memory://pictures.zip": ["b/1", "b/2"],
        f"file://{path}": all_names,
        f"tar://b/1.png::file://{tar}": ["b/1"],
    }.items():
        images = read_all(url)
        assert list(images) == names, url
        assert torch.equal(images[names[-1]], image(int(names[-1][-1])))  # type: ignore[arg-type]


def test_what_is_an_archive() -> None:
    others = ["rtsp://camera/1", "http://host/a.zip/live", "a.png", "s3://bucket/set", "folder"]
    known = ["A.ZIP", "http://host/a.zip?key=1", "s3://bucket/set.zip", "a.tar.gz"]
    assert [given for given in (*others, *known) if is_archive(given)] == known


def test_hidden_members_our_results_and_links_are_left_out(tmp_path: Path) -> None:
    names = ["__MACOSX/._a.png", ".git/b.png", ".c.png", "d.mask.png", "a.png"]
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w") as archive:
        for name, kind in (("link.png", tarfile.SYMTYPE), ("hard.png", tarfile.LNKTYPE)):
            info = tarfile.TarInfo(name)
            info.type, info.linkname = kind, "/etc/passwd"
            archive.addfile(info)
        for name in names:
            info = tarfile.TarInfo(name)
            info.size = len(png(0))
            archive.addfile(info, io.BytesIO(png(0)))

    assert list(read_all(path)) == ["a"]


# --- bad input --------------------------------------------------------------------------


def encrypted(path: Path) -> None:
    data = bytearray(path.read_bytes())
    entry = data.rindex(b"b/1.png") - 46  # in the list of members
    assert data[entry : entry + 4] == b"PK\x01\x02"
    data[entry + 8] |= 1  # the flag bits
    path.write_bytes(data)


def damaged(path: Path) -> None:
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("b/1.png").header_offset
    data[start + 300 : start + 320] = bytes(20)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("tamper", "what"),
    [(encrypted, "cannot be read: it is encrypted (unp"), (damaged, "cannot be unpacked: ")],
)
def test_a_bad_member_is_named_and_the_others_done(
    tmp_path: Path, tamper: Callable[[Path], None], what: str
) -> None:
    path = write_zip(tmp_path / "a.zip")
    tamper(path)

    first, bad, last = read_all(path).values()

    assert str(bad).startswith(f"{path}!b/1.png: {what}")
    assert torch.equal(first, image(0))  # type: ignore[arg-type]
    assert torch.equal(last, image(2))  # type: ignore[arg-type]


def test_names_that_climb_out_are_refused_and_the_others_done(tmp_path: Path) -> None:
    names = ["../x.png", "/etc/y.png", "C:\\z.png", "d/../../w.png", "..\\v.png", "a/./b.tar.png"]
    images = read_all(write_zip(tmp_path / "a.zip", {name: png(0) for name in names}))

    assert torch.equal(images.pop("a/b.tar"), image(0))  # type: ignore[arg-type]
    assert sorted(images) == [f"a.zip!{name}" for name in ("C_/z", "d/w", "etc/y", "v", "x")]
    assert all("has a name outside the archive" in str(problem) for problem in images.values())


@pytest.mark.parametrize("name", ["cut.tar", "cut.tar.gz", "cut.tar.xz"])
def test_a_cut_tar_gives_what_it_has(tmp_path: Path, name: str) -> None:
    path = write_tar(tmp_path / name, {f"{seed}.png": png(seed) for seed in range(8)})
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3 if name == "cut.tar" else -len(whole) // 4])

    images = read_all(path)

    assert torch.equal(images["0"], image(0))  # type: ignore[arg-type]
    assert str(images["end"]).startswith(f"{path}: ends early: ")


@pytest.mark.parametrize("place", [slice(100, 108), slice(124, 135), slice(0, 512)])
def test_a_tar_with_a_damaged_header_in_it_says_so(tmp_path: Path, place: slice) -> None:
    path = write_tar(tmp_path / "a.tar", {f"{seed}.png": png(seed) for seed in range(4)})
    data = bytearray(path.read_bytes())
    at = data.index(b"2.png\0")
    data[at + place.start : at + place.stop] = b"7" * (place.stop - place.start)
    path.write_bytes(data)

    images = read_all(path)

    assert list(images) == ["0", "1", "end"]
    assert str(images["end"]).startswith(f"{path}: ends early: a header is damaged")


@pytest.mark.parametrize("name", NAMES[:3])
@pytest.mark.parametrize("content", [b"", b"garbage" * 200])
def test_what_is_no_archive_is_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)

    images = read_all(path)

    assert list(images) == ["end"]
    assert str(images["end"]).startswith(f"{path}: cannot be read: ") or name == "pictures.tar"
    assert "\n" not in str(images["end"])


@pytest.mark.parametrize(
    ("members", "what"),
    [
        (None, "does not exist"),
        ({"a.txt": b""}, "holds no pictures"),
        ({"drive.mp4": b""}, "holds videos, no pictures (unpack it"),
    ],
)
@pytest.mark.parametrize("name", ["x.zip", "x.tar"])
def test_what_has_no_pictures(
    tmp_path: Path, name: str, members: Mapping[str, bytes] | None, what: str
) -> None:
    if members is not None:
        write_archive(tmp_path / name, members)

    assert what in str(read_all(tmp_path / name)["end"])


def test_a_video_beside_pictures_is_told(tmp_path: Path) -> None:
    images = read_all(write_zip(tmp_path / "both.zip", {"a.png": png(0), "drive.mp4": b""}))

    assert "both.zip!drive.mp4: is a video in an archive" in str(images["drive"])


def test_an_unknown_scheme_has_near_names_and_a_member_needs_an_archive() -> None:
    with pytest.raises(ConfigError, match=r"memry: unknown kind of URL \(did you mean memory"):
        open_source("memry://a", Selection())
    with pytest.raises(InputError, match=r"names no archive \(write zip://MEMBER::ARCHIVE"):
        archive_source("zip://a.png")


# --- bombs ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "size", "key", "what"),
    [
        ("a.zip", 10**6, "bomb", "a.zip!bomb.png: has more than 100,000 bytes"),
        ("a.tar.gz", 2 * 10**7, "end", "a.tar.gz: ends early: it unpacks to more than"),
    ],
)
def test_what_grows_too_large_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, size: int, key: str, what: str
) -> None:
    monkeypatch.setattr(archives, "MAX_BYTES", 100_000)

    images = read_all(write_archive(tmp_path / name, {"a.png": png(0), "bomb.png": bytes(size)}))

    assert torch.equal(images["a"], image(0))  # type: ignore[arg-type]
    assert what in str(images[key])


@pytest.mark.parametrize("name", NAMES[:3])
def test_the_header_of_a_large_member_is_looked_at_before_its_body(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module, constant in ((archives, "LARGE"), (decoding, "LARGE"), (archives, "HEAD")):
        monkeypatch.setattr(module, constant, 2**16)
    large = np.random.default_rng(0).integers(0, 256, (200, 200, 3)).astype(np.uint8)
    sized = b"BM" + bytes(8) + struct.pack("<IIiiHH", 54, 40, 18_000, 18_000, 1, 24) + bytes(24)
    members = {
        "good.bmp": cv2.imencode(".bmp", large[..., ::-1])[1].tobytes(),
        "many.bmp": sized + bytes(10**7),
        "tail.png": png(0) + bytes(10**7),
    }
    items = archive_source(str(write_archive(tmp_path / name, members))).items()

    assert torch.equal(next(items).read(), torch.from_numpy(large).permute(2, 0, 1) / 255)
    tracemalloc.start()
    for item, what in zip(items, ["megapixels", "bytes for 32 by 24 pixels"], strict=True):
        with pytest.raises(InputError, match=what):
            item.read()
    assert tracemalloc.get_traced_memory()[1] < 3 * 10**6
    tracemalloc.stop()


def test_a_member_that_lies_about_its_size_is_bounded(tmp_path: Path) -> None:
    path = write_zip(tmp_path / "a.zip", {"bomb.png": bytes(10**6)})
    data = bytearray(path.read_bytes())
    for start, at in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        data[data.index(start) + at : data.index(start) + at + 4] = (50).to_bytes(4, "little")
    path.write_bytes(data)

    assert "bomb.png: cannot be unpacked: Bad CRC" in str(read_all(path)["bomb"])
