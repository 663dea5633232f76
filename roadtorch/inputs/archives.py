"""Pictures in archives, each read when its turn comes.

``pictures.zip``, ``pictures.tar.gz``, ``zip://left/*.png::pictures.zip``,
``file:///data/pictures.tar``, and wherever else fsspec has a file system for.
"""

import bz2
import gzip
import io
import lzma
import posixpath
import re
import tarfile
import zipfile
from collections.abc import Callable, Generator
from contextlib import ExitStack
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO
from urllib.parse import urlsplit

from torch import Tensor

from roadtorch.base.bounded import MAX_BYTES, printable, reason
from roadtorch.base.decoding import LARGE, check_bytes
from roadtorch.base.errors import InputError
from roadtorch.base.image import READABLE, decode_image, undecodable
from roadtorch.base.urls import WEB, fetched, file_system, is_url, scheme_of, without_password
from roadtorch.inputs.item import Item, Selection, Source
from roadtorch.inputs.live import STREAMS
from roadtorch.inputs.pictures import names_picture
from roadtorch.inputs.video import VIDEO_SUFFIXES

ZIPS = (".zip",)
SCHEMES = ("zip", "tar")
TARS = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")

COMPRESSED = {b"\x1f\x8b": gzip.open, b"BZh": bz2.open, b"\xfd7zXZ\x00": lzma.open}
"""How packed tars are opened, by their first bytes."""

CHUNK = 2**16  # bytes that are unpacked at once

HEAD = 2**20  # bytes in which a large member has to have its header

MAX_GROWTH = 100
"""Of a compressed tar, times its size, if that is more than ``MAX_BYTES``; ours: pictures hardly
shrink, while zeros shrink a thousandfold."""

REPACK = "pack it again, or unpack it and give the folder"


@dataclass(frozen=True)
class Member:
    """A file in an archive: its name there, what messages call it, its size as declared, and a
    way to its first bytes, so many at most.
    """

    name: str
    origin: str
    size: int
    read: Callable[[int], bytes]


def is_archive(given: str) -> bool:
    """Whether it is a zip or tar file, of this machine or behind a URL, or names members of one."""
    return _kind(given) != ""


def _kind(given: str) -> str:
    scheme = given.partition("://")[0].lower()
    if scheme in SCHEMES or scheme in {*STREAMS} - {*WEB}:
        return scheme if scheme in SCHEMES else ""
    name = given.partition("::")[0].lower()
    if scheme in WEB:
        name = urlsplit(name).path
    return "zip" if name.endswith(ZIPS) else "tar" if name.endswith(TARS) else ""


def archive_source(given: str, selection: Selection = Selection()) -> Source:  # noqa: B008
    """The pictures in an archive, sorted by name; they can be read while its items are asked for.

    ``zip://INSIDE::ARCHIVE`` means a member, a folder of members or a glob. Pictures are named
    ``archive.zip!a/b.png``. Raises InputError for what cannot be opened or holds no pictures,
    ConfigError for an unknown scheme. A cut tar gives what it has, then InputError; a member that
    cannot be read raises in ``read``.
    """
    url, inside = given, ""
    if given.partition("://")[0].lower() in SCHEMES:
        chain, _, url = given.partition("::")
        inside = chain.partition("://")[2]
        if not url:
            remedy = f"write {_kind(given)}://MEMBER::ARCHIVE"
            raise InputError(given, "names no archive", remedy)
    if is_url(url) and scheme_of(url) not in WEB:
        file_system(url)
    stem = posixpath.basename(url.rstrip("/"))
    name = re.sub(r"(\.tar)?\.\w+$", "", stem) or stem or _kind(given)
    every = partial(_every_picture, given, url, inside)
    return Source(name, given, moving=False, items=lambda: selection.of(every()))


def _every_picture(given: str, url: str, inside: str) -> Generator[Item]:
    with ExitStack() as stack:
        members, problem = _members(given, url, stack)
        wanted = [member for member in members if is_meant(member.name, inside)]
        pictures = [member for member in wanted if _is_shown(member.name)]
        if not any(names_picture(posixpath.basename(member.name)) for member in pictures):
            if problem is not None:
                raise problem
            what = "holds videos, no pictures" if pictures else "holds no pictures"
            remedy = "unpack it and give the videos" if pictures else f"give {READABLE} files"
            raise InputError(given, what, remedy)
        for number, member in enumerate(sorted(pictures, key=lambda member: member.name)):
            name, read = safe_name(member.name), partial(_read, member, printable(member.origin))
            if is_outside(member.name):  # it is refused, and must own no other's results
                name = f"{posixpath.basename(url)}!{name}"
            yield Item(name, printable(member.origin), read, number=number)
    if problem is not None:
        raise problem


# --- names ------------------------------------------------------------------------------


def is_meant(name: str, inside: str) -> bool:
    """Whether a member's name is ``inside``, below it, or fits it as a glob (``*`` takes ``/``)."""
    inside = inside.strip("/")
    is_below = not inside or name == inside or name.startswith(f"{inside}/")
    return is_below or fnmatchcase(name, inside)


def is_outside(name: str) -> bool:
    """Whether a member's name leads out of its archive's folder: absolute, a drive's, or up."""
    return ".." in re.split(r"[/\\]", name) or re.match(r"[/\\]|\w:", name) is not None


def safe_name(name: str) -> str:
    """The name of a member's results: relative, without suffix, and never outside their folder."""
    return posixpath.splitext("/".join(_safe_parts(name)))[0]


def _safe_parts(name: str) -> list[str]:
    parts = re.split(r"[/\\]", printable(name).replace("\0", ""))
    return [part.replace(":", "_") for part in parts if part not in ("", ".", "..")]


def _is_shown(name: str) -> bool:
    """Whether a member is a picture or a video, and neither it nor a folder of it is hidden."""
    parts = _safe_parts(name)
    if not parts or any(part.startswith(".") or part == "__MACOSX" for part in parts):
        return False
    return names_picture(parts[-1]) or parts[-1].lower().endswith(VIDEO_SUFFIXES)


# --- members ----------------------------------------------------------------------------


def _members(given: str, url: str, stack: ExitStack) -> tuple[list[Member], InputError | None]:
    """The members of an archive, and the error behind them where it ends before its end.

    stack: closes the archive.
    """
    address = without_password(url)
    try:
        file = stack.enter_context(_opened(url))
        if _kind(given) == "zip":
            return _zip_members(stack.enter_context(zipfile.ZipFile(file)), address), None
        members, problem = _tar_members(file, address, stack)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(given, "does not exist", "check the name") from None
    except Exception as problem:  # file systems of others raise anything
        what = f"cannot be read: {reason(problem)}"
        raise InputError(given, what, "check that it is whole, and that you may read it") from None
    return members, InputError(given, f"ends early: {problem}", REPACK) if problem else None


def _opened(url: str) -> IO[bytes]:
    """A file to seek in; OSError for what is no file."""
    if scheme_of(url) in WEB:
        return fetched(url)
    if is_url(url):
        system, path = file_system(url)
        return system.open(path, "rb")
    if not Path(url).is_file() and Path(url).exists():
        raise OSError("it is a folder, a pipe or a device, not a file")
    return Path(url).open("rb")


def _zip_members(archive: zipfile.ZipFile, url: str) -> list[Member]:
    def read(info: zipfile.ZipInfo, most: int) -> bytes:
        if info.flag_bits & 0x1:  # APPNOTE.TXT 4.4.4, bit 0
            raise PermissionError("it is encrypted")
        with archive.open(info) as member:
            return member.read(most)

    return [
        Member(info.filename, f"{url}!{info.filename}", info.file_size, partial(read, info))
        for info in archive.infolist()  # of equal names one is refused: both would write one file
        if not info.is_dir()
    ]


def _tar_members(file: IO[bytes], url: str, stack: ExitStack) -> tuple[list[Member], str]:
    """The regular files in a tar, of equal names the last, and why it ends early, or nothing.

    A plain tar is read where it lies. A compressed one cannot be read in any order: it is
    unpacked into a file without a name first. Raises tarfile.TarError for what is no tar.
    """
    head, problem = file.read(6), ""
    size = file.seek(0, io.SEEK_END)
    file.seek(0)
    for magic, opened in COMPRESSED.items():
        if head.startswith(magic):
            with opened(file) as packed:
                file, problem = _unpacked(packed, max(MAX_BYTES, MAX_GROWTH * size))
            stack.enter_context(file).seek(0)
            break
    members: dict[str, Member] = {}

    def read(start: int, size: int, most: int) -> bytes:
        file.seek(start)
        data = file.read(min(size, most))
        if len(data) < min(size, most):
            raise OSError("it is cut off")
        return data

    archive = tarfile.open(fileobj=file, mode="r:")  # noqa: SIM115  # holds nothing
    try:
        for info in archive:
            if info.isreg() and not info.issparse():
                piece = partial(read, info.offset_data, info.size)
                members[info.name] = Member(info.name, f"{url}!{info.name}", info.size, piece)
        file.seek(archive.offset)
        if not problem and any(file.read(tarfile.BLOCKSIZE) or b"\1"):
            problem = "a header is damaged, or its end is missing"
    except (tarfile.TarError, OSError, EOFError) as raised:
        problem = problem or reason(raised)
    return list(members.values()), problem


def _unpacked(packed: io.BufferedIOBase, room: int) -> tuple[IO[bytes], str]:
    """What a compressed file unpacks to, at most so many bytes, and why that is not all of it."""
    file = TemporaryFile()  # noqa: SIM115  # closed with the last member
    try:
        while data := packed.read1(CHUNK):
            if file.tell() + len(data) > room:
                return file, f"it unpacks to more than {room:,} bytes"
            file.write(data)
    except Exception as raised:  # zlib.error, LZMAError, EOFError, OSError
        if not file.tell():
            file.close()
            raise
        return file, reason(raised)
    return file, ""


# --- reading ----------------------------------------------------------------------------


def _read(member: Member, origin: str) -> Tensor:
    if is_outside(member.name):
        raise InputError(origin, "has a name outside the archive", "give it another name")
    if member.name.lower().endswith(VIDEO_SUFFIXES):
        raise InputError(origin, "is a video in an archive", "unpack it and give the video")
    if member.size > MAX_BYTES:
        raise InputError(origin, f"has more than {MAX_BYTES:,} bytes", "make it smaller")
    try:
        if member.size > LARGE:
            head = io.BytesIO(member.read(HEAD))
            with undecodable(origin):
                check_bytes(head, member.size)
        data = member.read(MAX_BYTES + 1)
    except InputError:
        raise
    except PermissionError as problem:
        raise InputError(origin, f"cannot be read: {problem}", "unpack it first") from None
    except Exception as problem:  # zlib, lzma, and file systems of others
        raise InputError(origin, f"cannot be unpacked: {reason(problem)}", REPACK) from None
    if len(data) > MAX_BYTES:
        raise InputError(origin, f"has more than {MAX_BYTES:,} bytes", "make it smaller")
    return decode_image(data, origin)
