"""Pictures in archives and behind URLs: order, names, damage, bombs, threads. No network."""

import gzip
import io
import struct
import tarfile
import threading
import tracemalloc
import zipfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import fsspec
import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.errors import ConfigError, InputError
from roadtorch.io import decoding
from roadtorch.sources import archives
from roadtorch.sources.archives import archive_source, is_archive, safe_name
from roadtorch.sources.frame import Frame, Selection


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


def frames_of(given: object) -> list[Frame]:
    return list(archive_source(str(given)).frames())


@pytest.fixture
def memory() -> Iterator[fsspec.AbstractFileSystem]:
    system = fsspec.filesystem("memory")
    system.store.clear()
    yield system
    system.store.clear()


NAMES = ["pictures.zip", "pictures.tar", "pictures.tar.gz", "pictures.tgz", "pictures.tar.xz"]


@pytest.mark.parametrize("name", [*NAMES, "pictures.tar.bz2"])
def test_gives_the_pictures_sorted_by_name(tmp_path: Path, name: str):
    path = write_archive(tmp_path / name)
    source = archive_source(str(path))
    assert is_archive(str(path))
    assert (source.name, source.moving) == ("pictures", False)
    frames = list(source.frames())
    assert [frame.name for frame in frames] == ["a", "b/1", "b/2"]
    assert [frame.number for frame in frames] == [0, 1, 2]
    assert frames[1].origin == f"{path}!b/1.png"
    assert frames[1].seconds is None
    for frame, seed in zip(reversed(frames), (2, 1, 0), strict=True):  # any order
        assert torch.equal(frame.read(), image(seed))
    chosen = archive_source(str(path), Selection(every=2)).frames()
    first = next(chosen)
    assert [frame.name for frame in chosen] == ["b/2"]
    del frames, chosen
    assert torch.equal(first.read(), image(0))  # it outlives the iterator


@pytest.mark.parametrize("name", NAMES[:3])
def test_several_threads_read_at_once(tmp_path: Path, name: str):
    members = {f"{seed:03d}.png": png(seed) for seed in range(40)}
    frames = frames_of(write_archive(tmp_path / name, members))
    start = threading.Barrier(8)

    def read(part: int) -> bool:
        start.wait()
        mine = frames[part::8] * 3
        return all(torch.equal(frame.read(), image(frame.number)) for frame in mine)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(read, range(8)))


# --- URLs -------------------------------------------------------------------------------


def test_urls_of_folders_files_globs_and_archives(
    tmp_path: Path, memory: fsspec.AbstractFileSystem
):
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
        frames = frames_of(url)
        assert [frame.name for frame in frames] == names, url
        assert torch.equal(frames[-1].read(), image(int(names[-1][-1])))
    assert frames_of("memory://set")[0].origin == "memory:///set/a.png"


def test_what_is_an_archive():
    others = ["rtsp://camera/1", "http://host/a.zip", "a.png", "s3://bucket/set", "folder"]
    archives = ["A.ZIP", "s3://bucket/set.zip", "a.tar.gz"]
    assert [one for one in (*others, *archives) if is_archive(one)] == archives


def test_an_unknown_scheme_has_near_names():
    with pytest.raises(ConfigError, match=r"memry: unknown kind of URL \(did you mean memory"):
        archive_source("memry://a")
    with pytest.raises(InputError, match=r"names no archive \(write zip://MEMBER::ARCHIVE"):
        archive_source("zip://a.png")


# --- bad input --------------------------------------------------------------------------


def test_names_that_climb_out_are_refused_and_the_others_done(tmp_path: Path):
    names = ["../x.png", "/etc/y.png", "C:\\z.png", "d/../../w.png", "fine.png"]
    frames = frames_of(write_zip(tmp_path / "a.zip", {name: png(0) for name in names}))
    assert len(frames) == 5
    for frame in frames:
        assert ".." not in Path(frame.name).parts
        assert not Path(frame.name).is_absolute()
        if frame.origin.endswith("!fine.png"):
            assert torch.equal(frame.read(), image(0))
            continue
        with pytest.raises(InputError, match="has a name outside the archive"):
            frame.read()


def test_names_of_results_stay_inside():
    safe = {"a/b.png": "a/b", "../x.png": "x", "/e/y.png": "e/y", "C:\\z.png": "C_/z"}
    safe |= {"a/./../b.tar.png": "a/b.tar", "x\0y.png": "xy", "..\\..\\w.png": "w"}
    assert {name: safe_name(name) for name in safe} == safe


def test_hidden_members_and_our_results_are_left_out(tmp_path: Path):
    names = ["__MACOSX/._a.png", ".git/b.png", ".c.png", "d.mask.png", "a.png"]
    frames = frames_of(write_zip(tmp_path / "a.zip", {name: png(0) for name in names}))
    assert [frame.name for frame in frames] == ["a"]


def test_an_encrypted_member_is_named_and_the_others_done(tmp_path: Path):
    path = write_zip(tmp_path / "a.zip")
    data = bytearray(path.read_bytes())
    entry = data.rindex(b"b/1.png") - 46  # in the list of members
    assert data[entry : entry + 4] == b"PK\x01\x02"
    data[entry + 8] |= 1  # the flag bits
    path.write_bytes(data)
    frames = frames_of(path)
    assert torch.equal(frames[2].read(), image(2))
    with pytest.raises(InputError, match=r"a\.zip!b/1\.png: cannot be read: it is encrypted"):
        frames[1].read()


def test_a_damaged_member_is_named_and_the_others_done(tmp_path: Path):
    path = write_zip(tmp_path / "a.zip")
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("b/1.png").header_offset
    data[start + 300 : start + 320] = bytes(20)
    path.write_bytes(data)
    frames = frames_of(path)
    assert torch.equal(frames[2].read(), image(2))
    with pytest.raises(InputError, match=r"a\.zip!b/1\.png: cannot be unpacked: "):
        frames[1].read()


@pytest.mark.parametrize("name", ["cut.tar", "cut.tar.gz", "cut.tar.xz"])
def test_a_cut_tar_gives_what_it_has(tmp_path: Path, name: str):
    members = {f"{seed}.png": png(seed) for seed in range(8)}
    path = write_tar(tmp_path / name, members)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3 if name == "cut.tar" else -len(whole) // 4])
    frames = archive_source(str(path)).frames()
    assert torch.equal(next(frames).read(), image(0))
    with pytest.raises(InputError, match=r"cut\.tar[.\w]*: ends early: "):
        list(frames)


@pytest.mark.parametrize("place", [slice(100, 108), slice(124, 135), slice(0, 512)])
def test_a_tar_with_a_damaged_header_in_it_says_so(tmp_path: Path, place: slice):
    path = write_tar(tmp_path / "a.tar", {f"{seed}.png": png(seed) for seed in range(4)})
    data = bytearray(path.read_bytes())
    at = data.index(b"2.png\0")
    data[at + place.start : at + place.stop] = b"7" * (place.stop - place.start)
    path.write_bytes(data)
    frames = archive_source(str(path)).frames()
    assert [next(frames).name, next(frames).name] == ["0", "1"]
    with pytest.raises(InputError, match=r"a\.tar: ends early: a header is damaged"):
        next(frames)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("content", [b"", b"garbage" * 200])
def test_what_is_no_archive_is_one_line(tmp_path: Path, name: str, content: bytes):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match="pictures") as raised:
        frames_of(path)
    assert "\n" not in str(raised.value)


def test_missing_empty_and_videos(tmp_path: Path, memory: fsspec.AbstractFileSystem):
    for given in (tmp_path / "none.zip", tmp_path / "none.tar", "memory://none"):
        with pytest.raises(InputError, match="does not exist"):
            frames_of(given)
    with pytest.raises(InputError, match="holds no pictures"):
        frames_of(write_zip(tmp_path / "empty.zip", {"a.txt": b""}))
    with pytest.raises(InputError, match=r"holds videos, no pictures \(unpack it"):
        frames_of(write_zip(tmp_path / "video.zip", {"drive.mp4": b""}))
    both = frames_of(write_zip(tmp_path / "both.zip", {"a.png": png(0), "drive.mp4": b""}))
    with pytest.raises(InputError, match=r"both\.zip!drive\.mp4: is a video in an archive"):
        both[1].read()


# --- bombs ------------------------------------------------------------------------------


def test_a_member_that_grows_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(archives, "MAX_BYTES", 100_000)
    members = {"a.png": png(0), "bomb.png": bytes(10**6)}
    frames = frames_of(write_zip(tmp_path / "a.zip", members))
    assert torch.equal(frames[0].read(), image(0))
    with pytest.raises(InputError, match=r"a\.zip!bomb\.png: has more than 100,000 bytes"):
        frames[1].read()


@pytest.mark.parametrize("name", NAMES[:3])
def test_the_header_of_a_large_member_is_looked_at_before_its_body(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
):
    for module, name_of in ((archives, "LARGE"), (decoding, "LARGE"), (archives, "HEAD")):
        monkeypatch.setattr(module, name_of, 2**16)
    large = np.random.default_rng(0).integers(0, 256, (200, 200, 3)).astype(np.uint8)
    sized = b"BM" + bytes(8) + struct.pack("<IIiiHH", 54, 40, 18_000, 18_000, 1, 24) + bytes(24)
    members = {
        "good.bmp": cv2.imencode(".bmp", large[..., ::-1])[1].tobytes(),
        "many.bmp": sized + bytes(10**7),
        "tail.png": png(0) + bytes(10**7),
    }
    frames = frames_of(write_archive(tmp_path / name, members))
    assert torch.equal(frames[0].read(), torch.from_numpy(large).permute(2, 0, 1) / 255)

    tracemalloc.start()
    for frame, told in zip(frames[1:], ["megapixels", "bytes for 32 by 24 pixels"], strict=True):
        with pytest.raises(InputError, match=told):
            frame.read()
    assert tracemalloc.get_traced_memory()[1] < 3 * 10**6
    tracemalloc.stop()


def test_a_member_that_lies_about_its_size_is_bounded(tmp_path: Path):
    path = write_zip(tmp_path / "a.zip", {"bomb.png": bytes(10**6)})
    data = bytearray(path.read_bytes())
    for start, at in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        data[data.index(start) + at : data.index(start) + at + 4] = (50).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"bomb\.png: cannot be unpacked: Bad CRC"):
        frames_of(path)[0].read()


def test_a_compressed_tar_that_grows_too_large_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(archives, "MAX_BYTES", 100_000)
    members = {"a.png": png(0), "bomb.png": bytes(2 * 10**7)}
    path = write_tar(tmp_path / "a.tar.gz", members)
    assert len(gzip.decompress(path.read_bytes())) > 500 * path.stat().st_size
    frames = archive_source(str(path)).frames()
    assert torch.equal(next(frames).read(), image(0))
    with pytest.raises(InputError, match=r"a\.tar\.gz: ends early: it unpacks to more than"):
        list(frames)


def test_links_in_a_tar_are_left_out(tmp_path: Path):
    path = tmp_path / "a.tar"
    with tarfile.open(path, "w") as archive:
        for name, kind in (("link.png", tarfile.SYMTYPE), ("hard.png", tarfile.LNKTYPE)):
            info = tarfile.TarInfo(name)
            info.type, info.linkname = kind, "/etc/passwd"
            archive.addfile(info)
        info = tarfile.TarInfo("a.png")
        info.size = len(png(0))
        archive.addfile(info, io.BytesIO(png(0)))
    assert [frame.name for frame in frames_of(path)] == ["a"]
