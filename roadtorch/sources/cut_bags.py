"""Bags whose end is missing, made readable: what is whole in them, and an end of our own.

A recorder that is killed, or a disk that fills, leaves a bag without its index, and ``rosbags``
reads none. Nothing is written: the end is put behind the bag while it is read.
"""

import io
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, BinaryIO, NamedTuple

MCAP_MAGIC = b"\x89MCAP0\r\n"
MCAP_END = bytes([2]) + struct.pack("<QQQI", 20, 0, 0, 0) + MCAP_MAGIC
"""The footer of a file without summary (mcap.dev/spec, Footer)."""

BAG_MAGIC = b"#ROSBAG V2.0\n"
CONNECTION, CHUNK, INDEX, CHUNK_INFO = 7, 5, 4, 6  # wiki.ros.org/Bags/Format/2.0


class Stretch(NamedTuple):
    """Bytes of a file: ``size`` of them from ``start``; or ``data`` itself."""

    start: int
    size: int
    data: bytes | None = None


@dataclass(frozen=True)
class MendedFile:
    """A file of pieces that is opened like a path, for ``rosbags``."""

    path: Path
    pieces: tuple[Stretch, ...]

    @property
    def suffix(self) -> str:
        """That of the file."""
        return self.path.suffix

    def exists(self) -> bool:
        """It does."""
        return True

    def is_dir(self) -> bool:
        """It is a file."""
        return False

    def open(self, mode: str = "rb") -> BinaryIO:
        """The pieces behind one another, to read."""
        return io.BufferedReader(_Joined(self.path.open(mode), self.pieces))  # type: ignore[arg-type]


class _Joined(io.RawIOBase):
    """The pieces of a file as one file; the interface of ``io``."""

    def __init__(self, file: BinaryIO, pieces: Sequence[Stretch]) -> None:
        self._file = file
        self._pieces = pieces
        self._size = sum(piece.size for piece in pieces)
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = max(0, offset + (0, self._at, self._size)[whence])
        return self._at

    def readinto(self, buffer: Any) -> int:
        skip = self._at
        for piece in self._pieces:
            if skip < piece.size:
                size = min(len(buffer), piece.size - skip)
                if piece.data is None:
                    self._file.seek(piece.start + skip)
                    found = self._file.read(size)
                else:
                    found = piece.data[skip : skip + size]
                buffer[: len(found)] = found
                self._at += len(found)
                return len(found)
            skip -= piece.size
        return 0

    def close(self) -> None:
        self._file.close()
        super().close()


def mended(path: Path) -> MendedFile:
    """A cut .mcap or .bag with an end; ValueError for anything else, and where nothing is whole."""
    with path.open("rb") as file:
        magic = file.read(len(BAG_MAGIC))
        size = file.seek(0, io.SEEK_END)
        if not magic.startswith(MCAP_MAGIC) and magic != BAG_MAGIC:
            raise ValueError("it is neither MCAP nor a bag of ROS 1")
        pieces = mended_bag(file, size) if magic == BAG_MAGIC else mended_mcap(file, size)
    return MendedFile(path, pieces)


# --- MCAP -------------------------------------------------------------------------------


def mended_mcap(file: BinaryIO, size: int) -> tuple[Stretch, ...]:
    """Whole records up to the end of the data; a record is one byte, a length, and its content."""
    end = len(MCAP_MAGIC)
    while end + 9 <= size:
        file.seek(end)
        kind, length = struct.unpack("<BQ", file.read(9))
        if kind in (0, 2, 0x0F) or end + 9 + length > size:  # damaged, or the end of the data
            break
        end += 9 + length
    if end == len(MCAP_MAGIC):
        raise ValueError("no record is whole")
    return Stretch(0, end), Stretch(0, len(MCAP_END), MCAP_END)


# --- ROS 1 ------------------------------------------------------------------------------


class Record(NamedTuple):
    """A record of a ROS 1 bag: its fields, where it starts and ends, and where its data start."""

    fields: dict[bytes, bytes]
    start: int
    data: int
    end: int


def mended_bag(file: BinaryIO, size: int) -> tuple[Stretch, ...]:
    """Whole chunks with their indexes, and an index of the bag behind them.

    A message that is in no whole index is left out.
    """
    records = _records(file, len(BAG_MAGIC), size)
    header = next(records, None)
    if header is None:
        raise ValueError("no record is whole")
    connections: dict[bytes, bytes] = {}
    infos: list[bytes] = []
    end = header.end
    for chunk, indexes in _whole_chunks(records):
        data = _unpacked(file, chunk)
        for record in _records(io.BytesIO(data), 0, len(data)):
            if record.fields[b"op"][0] == CONNECTION:
                connections.setdefault(record.fields[b"conn"], data[record.start : record.end])
        infos.append(_chunk_info(file, chunk, indexes))
        end = indexes[-1].end
    numbers = {b"index_pos": struct.pack("<Q", end), b"op": b"\x03"}
    numbers |= {b"conn_count": struct.pack("<I", len(connections))}
    numbers |= {b"chunk_count": struct.pack("<I", len(infos))}
    told = _packed_fields(numbers)
    padding = header.end - header.start - len(told) - 4
    told += struct.pack("<I", padding) + b" " * padding
    tail = b"".join((*connections.values(), *infos))
    head = BAG_MAGIC + told
    return (
        Stretch(0, len(head), head),
        Stretch(header.end, end - header.end),
        Stretch(0, len(tail), tail),
    )


def _records(file: IO[bytes], start: int, size: int) -> Iterator[Record]:
    """The whole records from there on, one after the other."""
    while start + 4 <= size:
        file.seek(start)
        length = int.from_bytes(file.read(4), "little")
        data = start + 8 + length
        if data > size:
            return
        fields: dict[bytes, bytes] = {}
        header, at = file.read(length), 0
        while at + 4 <= length:
            size_of_field = int.from_bytes(header[at : at + 4], "little")
            name, _, value = header[at + 4 : at + 4 + size_of_field].partition(b"=")
            fields[name] = value
            at += 4 + size_of_field
        end = data + int.from_bytes(file.read(4), "little")
        if end > size or b"op" not in fields:
            return
        yield Record(fields, start, data, end)
        start = end


def _packed_fields(fields: dict[bytes, bytes]) -> bytes:
    each = [name + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(field)) + field for field in each)
    return struct.pack("<I", len(header)) + header


def _whole_chunks(records: Iterator[Record]) -> Iterator[tuple[Record, list[Record]]]:
    """Each chunk with the indexes behind it, one for each connection; the last may lack some."""
    chunk: Record | None = None
    indexes: list[Record] = []
    for record in records:
        if record.fields[b"op"][0] == INDEX:
            indexes.append(record)
            continue
        if chunk is not None and indexes:
            yield chunk, indexes
        chunk, indexes = (record if record.fields[b"op"][0] == CHUNK else None), []
    if chunk is not None and indexes:
        yield chunk, indexes


def _unpacked(file: BinaryIO, chunk: Record) -> bytes:
    file.seek(chunk.data)
    data = file.read(chunk.end - chunk.data)
    if chunk.fields[b"compression"] == b"bz2":
        import bz2

        return bz2.decompress(data)
    if chunk.fields[b"compression"] == b"lz4":
        from lz4.frame import decompress  # comes with rosbags

        return decompress(data)
    return data


def _chunk_info(file: BinaryIO, chunk: Record, indexes: Sequence[Record]) -> bytes:
    """The record that tells what is in a chunk: how many messages of each connection, and when."""
    counts = b""
    times: list[tuple[int, int]] = []
    for index in indexes:
        file.seek(index.data)
        data = file.read(index.end - index.data)
        times += [struct.unpack_from("<II", data, at) for at in range(0, len(data), 12)]
        counts += index.fields[b"conn"] + index.fields[b"count"]
    header = {b"op": bytes([CHUNK_INFO]), b"ver": struct.pack("<I", 1)}
    header |= {b"chunk_pos": struct.pack("<Q", chunk.start)}
    header |= {b"start_time": struct.pack("<II", *min(times))}
    header |= {b"end_time": struct.pack("<II", *max(times))}
    header |= {b"count": struct.pack("<I", len(indexes))}
    return _packed_fields(header) + struct.pack("<I", len(counts)) + counts
