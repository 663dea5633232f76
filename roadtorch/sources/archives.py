"""Pictures in archives and behind fsspec URLs, each read when its turn comes.

``pictures.zip``, ``pictures.tar.gz``, ``zip://left/*.png::pictures.zip``, ``memory://folder``,
``file:///data/pictures.tar``, and whatever else fsspec has a file system for.
"""

import posixpath
import re
import weakref
import zipfile
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import IO, Any

import fsspec
import fsspec.core
from torch import Tensor

from roadtorch.errors import InputError, unknown_name
from roadtorch.io.bounded import MOST_BYTES, printable, reason
from roadtorch.io.image import READABLE, decode_image
from roadtorch.sources.frame import Frame, Selection, Source
from roadtorch.sources.pictures import names_picture
from roadtorch.sources.tarballs import tar_members
from roadtorch.sources.video import VIDEO_SUFFIXES

ZIPS = (".zip",)
TARS = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")

STREAMS = ("http", "https", "rtsp", "rtsps", "rtmp", "rtmps", "rtp", "srt", "tcp", "udp", "mms")
"""Schemes of URLs that are read as video streams."""

REPACK = "pack it again, or unpack it and give the folder"


@dataclass(frozen=True)
class Member:
    """A file in an archive or folder: its name there, what messages call it, its size as declared,
    and a way to its bytes.
    """

    name: str
    origin: str
    size: int
    read: Callable[[], bytes]


@dataclass(frozen=True)
class Place:
    """Where members are: ``url`` of a ``zip``, a ``tar`` or a ``folder``, and which are meant.

    inside: a member, a folder of members or a glob; everything where it is empty.
    """

    kind: str
    url: str
    inside: str


def is_archive(given: str) -> bool:
    """Whether it is a zip or tar file of this machine."""
    return not _scheme(given) and _archive_kind(given) != ""


def is_remote(given: str) -> bool:
    """Whether ``archive_source`` reads it: a zip or tar file, or a URL that is no video stream."""
    scheme = _scheme(given)
    return scheme not in STREAMS if scheme else _archive_kind(given) != ""


def archive_source(given: str, selection: Selection = Selection()) -> Source:  # noqa: B008
    """The pictures in an archive, or behind a URL, sorted by name.

    Each frame reads its member alone, in any thread, also when the iterator is closed; the archive
    is closed when nobody holds a frame of it. Frames are named ``archive.zip!a/b.png``. Raises
    InputError for what cannot be opened or holds no pictures, ConfigError for an unknown scheme. A
    cut tar gives what it has, then InputError; a member that cannot be read raises in ``read``.
    """
    place = _place(given)
    stem = posixpath.basename(place.url.rstrip("/")) or place.kind
    return Source(
        name=re.sub(r"(\.tar)?\.\w+$", "", stem) or stem,
        origin=given,
        moving=False,
        frames=partial(_frames, given, place, selection),
    )


def _frames(given: str, place: Place, selection: Selection) -> Iterator[Frame]:
    with closing(_every_frame(given, place)) as every:
        yield from selection.of(every)


def _every_frame(given: str, place: Place) -> Generator[Frame]:
    members, problem = _members(given, place)
    wanted = [member for member in members if is_meant(member.name, place.inside)]
    pictures = [member for member in wanted if _is_shown(member.name)]
    if not any(names_picture(posixpath.basename(member.name)) for member in pictures):
        if problem is not None:
            raise problem
        what = "holds videos, no pictures" if pictures else "holds no pictures"
        remedy = "unpack it and give the videos" if pictures else f"give {READABLE} files"
        raise InputError(given, what, remedy)
    for number, member in enumerate(sorted(pictures, key=lambda member: member.name)):
        origin = printable(member.origin)
        yield Frame(number, safe_name(member.name), origin, None, partial(_read, member, origin))
    if problem is not None:
        raise problem


# --- names ------------------------------------------------------------------------------


def is_meant(name: str, inside: str) -> bool:
    """Whether a member's name is ``inside``, below it, or fits it as a glob (``*`` takes ``/``)."""
    inside = inside.strip("/")
    is_below = not inside or name == inside or name.startswith(f"{inside}/")
    return is_below or fnmatchcase(name, inside)


def safe_name(name: str) -> str:
    """The name of a member's results: relative, without suffix, and never outside their folder."""
    return posixpath.splitext("/".join(_safe_parts(name)))[0]


def _safe_parts(name: str) -> list[str]:
    parts = re.split(r"[/\\]", printable(name).replace("\0", ""))
    return [part.replace(":", "_") for part in parts if part not in ("", ".", "..")]


def _climbs(name: str) -> bool:
    return ".." in re.split(r"[/\\]", name) or re.match(r"[/\\]|\w:", name) is not None


def _is_shown(name: str) -> bool:
    """Whether a member is a picture or a video, and neither it nor a folder of it is hidden."""
    parts = _safe_parts(name)
    if not parts or any(part.startswith(".") or part == "__MACOSX" for part in parts):
        return False
    return names_picture(parts[-1]) or parts[-1].lower().endswith(VIDEO_SUFFIXES)


# --- places -----------------------------------------------------------------------------


def _place(given: str) -> Place:
    scheme = _scheme(given)
    if scheme in ("zip", "tar"):
        inside, _, url = given.partition("::")
        if not url:
            remedy = f"write {scheme}://MEMBER::ARCHIVE"
            raise InputError(given, "names no archive", remedy)
        return Place(scheme, url, inside.partition("://")[2])
    if scheme and scheme not in fsspec.available_protocols():
        raise unknown_name("kind of URL", scheme, fsspec.available_protocols())
    return Place(_archive_kind(given) or "folder", given, "")


def _scheme(given: str) -> str:
    found = re.match(r"([A-Za-z][\w+.-]*)://", given)
    return found[1].lower() if found else ""


def _archive_kind(given: str) -> str:
    name = given.partition("::")[0].lower()
    return "zip" if name.endswith(ZIPS) else "tar" if name.endswith(TARS) else ""


# --- members ----------------------------------------------------------------------------


def _members(given: str, place: Place) -> tuple[list[Member], InputError | None]:
    """The members of a place, and the error behind them where it ends before its end."""
    try:
        if place.kind == "folder":
            return _folder_members(place.url), None
        file = _opened(place.url)
        if place.kind == "zip":
            return _zip_members(file, place.url), None
        found, problem = tar_members(file)
    except FileNotFoundError:
        raise InputError(given, "does not exist", "check the name") from None
    except InputError:
        raise
    except Exception as problem:  # file systems of others raise anything
        what = f"cannot be read: {reason(problem)}"
        raise InputError(given, what, "check that it is whole, and that you may read it") from None
    members = [_member(place.url, piece.name, piece.size, piece.read) for piece in found]
    return members, InputError(given, f"ends early: {problem}", REPACK) if problem else None


def _member(archive: str, name: str, size: int, read: Callable[[], bytes]) -> Member:
    return Member(name, f"{archive}!{name}", size, read)


def _opened(url: str) -> IO[bytes]:
    """A file to seek in; OSError for what is no file."""
    if _scheme(url) or "::" in url:
        system, path = fsspec.core.url_to_fs(url)
        return system.open(path, "rb")
    if not Path(url).is_file() and Path(url).exists():
        raise OSError("it is a folder, a pipe or a device, not a file")
    return Path(url).open("rb")


def _folder_members(url: str) -> list[Member]:
    """The files below a folder of any file system, or the one file, or those that fit a glob."""
    system, path = fsspec.core.url_to_fs(url)
    if system.isdir(path):
        found = system.find(path, detail=True)
        below = len(path.rstrip("/")) + 1
    else:
        found = system.glob(path, detail=True) if "*" in path else {path: system.info(path)}
        below = path.partition("*")[0].rfind("/") + 1
    protocol = url.partition("://")[0]
    return [
        Member(
            name[below:],
            f"{protocol}://{name}",
            info["size"] or 0,
            partial(_read_file, system, name),
        )
        for name, info in found.items()
        if info["type"] == "file"
    ]


def _read_file(system: Any, path: str) -> bytes:
    with system.open(path, "rb") as file:
        return file.read(MOST_BYTES + 1)


def _zip_members(file: IO[bytes], url: str) -> list[Member]:
    try:
        archive = zipfile.ZipFile(file)
    except Exception:
        file.close()
        raise
    weakref.finalize(archive, file.close)  # with the last frame that may be read
    return [
        _member(url, info.filename, info.file_size, partial(_read_zipped, archive, info))
        for info in {info.filename: info for info in archive.infolist()}.values()
        if not info.is_dir()
    ]


def _read_zipped(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytes:
    if info.flag_bits & 0x1:  # APPNOTE.TXT 4.4.4, bit 0
        raise PermissionError("it is encrypted")
    with archive.open(info) as file:
        return file.read(MOST_BYTES + 1)


# --- reading ----------------------------------------------------------------------------


def _read(member: Member, origin: str) -> Tensor:
    if _climbs(member.name):
        raise InputError(origin, "has a name outside the archive", "give it another name")
    if member.name.lower().endswith(VIDEO_SUFFIXES):
        raise InputError(origin, "is a video in an archive", "unpack it and give the video")
    if member.size > MOST_BYTES:
        raise InputError(origin, f"has more than {MOST_BYTES:,} bytes", "make it smaller")
    try:
        data = member.read()
    except PermissionError as problem:
        raise InputError(origin, f"cannot be read: {problem}", "unpack it first") from None
    except Exception as problem:  # zlib, lzma, and file systems of others
        raise InputError(origin, f"cannot be unpacked: {reason(problem)}", REPACK) from None
    if len(data) > MOST_BYTES:
        raise InputError(origin, f"has more than {MOST_BYTES:,} bytes", "make it smaller")
    return decode_image(data, origin)
