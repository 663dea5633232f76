"""Tar files as pieces that can be read in any order, from any thread."""

import shutil
import tarfile
import threading
import weakref
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import IO

from roadtorch.io.bounded import MOST_BYTES, reason

MOST_GROWTH = 100
"""Of a compressed tar, times its size, if that is more than ``MOST_BYTES``; ours: pictures hardly
shrink, while zeros shrink a thousandfold."""

COMPRESSED = (b"\x1f\x8b", b"BZh", b"\xfd7zXZ\x00")  # gzip, bzip2, xz


class Unpacked:
    """A file that several threads read pieces of; it is closed with the last one who holds it."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._lock = threading.Lock()
        weakref.finalize(self, file.close)

    def piece(self, start: int, size: int) -> bytes:
        """So many bytes from there; OSError where there are fewer."""
        with self._lock:
            self._file.seek(start)
            data = self._file.read(size)
        if len(data) < size:
            raise OSError("it is cut off")
        return data


@dataclass(frozen=True)
class Piece:
    """A member of a tar: where its bytes are."""

    name: str
    size: int
    start: int
    file: Unpacked

    def read(self) -> bytes:
        """Its bytes, at most one more than ``MOST_BYTES``; OSError where they are cut off."""
        return self.file.piece(self.start, min(self.size, MOST_BYTES + 1))


def tar_members(file: IO[bytes]) -> tuple[list[Piece], str]:
    """The regular files in a tar, of equal names the last, and why it ends early, or nothing.

    A plain tar is read where it lies. A compressed one cannot be read in any order: it is
    unpacked into a file without a name first, bounded by ``MOST_GROWTH``. Raises tarfile.TarError
    for what is no tar.
    """
    head = file.read(6)
    file.seek(0)
    if not head.startswith(COMPRESSED):
        return _listed(file, Unpacked(file))
    unpacked = TemporaryFile()  # noqa: SIM115  # closed with the last piece
    pieces = Unpacked(unpacked)
    try:
        return _spooled(file, unpacked, pieces)
    finally:
        file.close()


def _listed(file: IO[bytes], pieces: Unpacked) -> tuple[list[Piece], str]:
    archive = tarfile.open(fileobj=file, mode="r:")  # noqa: SIM115  # holds nothing
    found: dict[str, Piece] = {}
    problem = ""
    try:
        for info in archive:
            if info.isreg() and not info.issparse():
                found[info.name] = Piece(info.name, info.size, info.offset_data, pieces)
    except (tarfile.TarError, OSError, EOFError) as raised:
        problem = reason(raised)
    return list(found.values()), problem


def _spooled(file: IO[bytes], unpacked: IO[bytes], pieces: Unpacked) -> tuple[list[Piece], str]:
    room = max(MOST_BYTES, MOST_GROWTH * file.seek(0, 2))
    file.seek(0)
    found: dict[str, Piece] = {}
    problem = ""
    try:
        with tarfile.open(fileobj=file, mode="r|*") as archive:
            for info in archive:
                if not info.isreg() or info.issparse():
                    continue
                start = unpacked.tell()
                if start + info.size > room:
                    return list(found.values()), f"it unpacks to more than {room:,} bytes"
                if member := archive.extractfile(info):
                    shutil.copyfileobj(member, unpacked)
                found[info.name] = Piece(info.name, info.size, start, pieces)
    except Exception as raised:  # zlib.error, LZMAError, EOFError, TarError
        if not found:
            raise
        problem = reason(raised)
    unpacked.flush()
    return list(found.values()), problem
