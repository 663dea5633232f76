"""Label Studio's coding of brush masks: thi.ng/rle-pack over the bytes of an RGBA picture.

Bits, high ones first: 32 how many values; 5 bits of a value, less 1; four times 4: bits of a count,
less 1; then packets: 1 whether a run, 2 which of the four sizes, the count less 1, and the value
(of a run) or the values. The mask is in the alpha channel; what we write has it in all four.
"""

from collections.abc import Sequence

import numpy as np

SIZES = (3, 4, 8, 16)  # bits of a count

WORD = 8

CHANNELS = 4

LONGEST_RUN = 2 ** SIZES[-1]


def packed_mask(mask: np.ndarray) -> list[int]:
    """The bytes of a mask bool (H,W) in this coding."""
    flat = np.repeat(mask.reshape(-1), CHANNELS)
    edges = np.flatnonzero(np.concatenate([[True], flat[1:] != flat[:-1], [True]]))
    bits = [f"{len(flat):032b}", f"{WORD - 1:05b}", *(f"{size - 1:04b}" for size in SIZES)]
    for start, length in zip(edges[:-1].tolist(), np.diff(edges).tolist(), strict=True):
        value = "1" * WORD if flat[start] else "0" * WORD
        while length:
            part = min(length, LONGEST_RUN)
            place = next(i for i, size in enumerate(SIZES) if part <= 2**size)
            bits.append(f"1{place:02b}{part - 1:0{SIZES[place]}b}{value}")
            length -= part
    text = "".join(bits)
    text += "0" * (-len(text) % 8)
    return list(int(text, 2).to_bytes(len(text) // 8, "big"))


def unpacked_mask(data: Sequence[int], size: tuple[int, int]) -> np.ndarray:
    """The mask bool (H,W) of such bytes; ValueError where they are not, or of another size."""
    bits = _Bits(data)
    count, word = bits.read(32), bits.read(5) + 1
    sizes = [bits.read(4) + 1 for _ in SIZES]
    if count != size[0] * size[1] * CHANNELS:
        raise ValueError(f"{count} values, not those of {size[1]} by {size[0]} pixels")
    values = np.zeros(count, np.uint32)
    place = 0
    while place < count:
        is_run = bits.read(1)
        length = bits.read(sizes[bits.read(2)]) + 1
        end = min(place + length, count)
        if is_run:
            values[place:end] = bits.read(word)
        else:
            values[place:end] = [bits.read(word) for _ in range(end - place)]
        place = end
    return values.reshape(*size, CHANNELS)[..., -1] > 0


class _Bits:
    """A reader of bits, high ones first."""

    def __init__(self, data: Sequence[int]) -> None:
        self._text = (np.unpackbits(np.array(data, np.uint8)) + ord("0")).tobytes().decode()
        self._place = 0

    def read(self, count: int) -> int:
        """The next bits as a number; ValueError at the end."""
        end = self._place + count
        if end > len(self._text):
            raise ValueError("the data ends too early")
        value = int(self._text[self._place : end], 2)
        self._place = end
        return value
