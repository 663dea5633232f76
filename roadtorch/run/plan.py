"""What a run does: pictures, sources and what is written of each."""

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

from roadtorch.base.errors import ConfigError
from roadtorch.inputs.find import Inputs
from roadtorch.inputs.item import Item, Source
from roadtorch.run.folder import ELSEWHERE, Owners
from roadtorch.run.loop import FileWriter, Writer


class Writers(NamedTuple):
    """What writes the frames of one source.

    files: files of each frame; where they cannot be written, the frame has failed. streams: files
    of the whole source, such as videos; where they cannot be written, the source ends.
    """

    files: FileWriter
    streams: Sequence[Writer] = ()


class Output(NamedTuple):
    """What a command writes of one source.

    kinds: what index.csv says was saved. suffixes: of the files of the whole source; of_frames: of
    those of each frame. open: what writes, closed behind the block. cues: whether it needs them.
    """

    kinds: tuple[str, ...]
    suffixes: Sequence[str]
    of_frames: Sequence[str]
    open: Callable[[], AbstractContextManager[Writers]]
    cues: bool = False


class Plan(NamedTuple):
    """What a run does: pictures that stand alone, and sources."""

    pictures: Sequence[Item]
    sources: Sequence[tuple[Source, Output]]

    @property
    def count(self) -> int | None:
        """How many pictures there are; None where there is footage as well."""
        return None if self.sources else len(self.pictures)

    @property
    def row_names(self) -> list[str]:
        """What index.csv calls all of them."""
        names = [item.row_name for item in self.pictures]
        return names + [source.row_name for source, _ in self.sources]


def plan(
    inputs: Inputs,
    out: Path,
    suffixes: Sequence[str],
    output: Callable[[Source], Output] | None = None,
) -> Plan:
    """What is to be done; no file is written yet.

    out: the folder of the results. suffixes: of the results of a picture. output: what is written
    of a source. Raises ConfigError when two pictures or sources share a result, and when one would
    replace a picture.
    """
    owners = Owners(out)
    results = [(item.name, suffixes) for item in inputs.pictures]
    for item in inputs.pictures:
        owners.take(item.name, suffixes, item.origin)
    sources = [(source, output(source)) for source in inputs.sources] if output else []
    for source, written in sources:
        owners.take_source(source.name, source.origin, has_files=bool(written.of_frames))
        results.append((source.name, written.suffixes))
    # Path.resolve raises for a link to itself.
    files = [item.file for item in inputs.pictures] + [source.path for source in inputs.sources]
    taken = {os.path.realpath(file) for file in files if file is not None}
    for result in (Path(out, name + suffix) for name, ends in results for suffix in ends):
        if os.path.realpath(result) in taken:
            raise ConfigError(result, "is one of the pictures", ELSEWHERE)
    return Plan(inputs.pictures, sources)
