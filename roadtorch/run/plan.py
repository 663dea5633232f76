"""What a run does, and how: images, sources, what is written of each; its options."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roadtorch.base.bounded import printable
from roadtorch.base.errors import ConfigError
from roadtorch.data.maps import CONFIG
from roadtorch.inputs.find import Inputs
from roadtorch.inputs.item import Item, Source
from roadtorch.run.folder import COCO, ELSEWHERE, RUN
from roadtorch.run.ledger import FRAME_NUMBER, INDEX
from roadtorch.run.loop import FileWriter, Writer
from roadtorch.run.workers import Workers, processors, workers_for


@dataclass(frozen=True)
class RunOptions:
    """Options of a run.

    jobs: processes, or actors on Ray; None for as many as pay. overwrite: redo what is done. quiet:
    no progress on stderr. engine: ``local``, ``ray`` for a cluster of this machine, or the address
    of one. threads: within an image. device: of torch.
    """

    jobs: int | None = None
    overwrite: bool = False
    quiet: bool = False
    engine: str = "local"
    threads: int = 1
    device: str = "cpu"

    @contextmanager
    def workers(self, count: int | None) -> Iterator[Workers]:
        """Give the workers for so many items (None: unknown); ConfigError where Ray is missing."""
        if self.engine == "local":
            yield workers_for(self.jobs, count, self.device)
            return
        from roadtorch.run.ray_workers import ray_workers

        address = None if self.engine == "ray" else self.engine
        with ray_workers(self.jobs or processors(), address, self.device) as workers:
            yield workers


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
    """What a run does: images that stand alone, and sources."""

    images: Sequence[Item]
    sources: Sequence[tuple[Source, Output]]

    @property
    def count(self) -> int | None:
        """How many images there are; None where there is footage as well."""
        return None if self.sources else len(self.images)

    @property
    def row_names(self) -> list[str]:
        """What index.csv calls all of them."""
        names = [item.row_name for item in self.images]
        return names + [source.row_name for source, _ in self.sources]


def plan(
    inputs: Inputs,
    out: Path,
    suffixes: Sequence[str],
    output: Callable[[Source], Output] | None = None,
) -> Plan:
    """Return what is to be done; no file is written yet.

    out: the folder of the results. suffixes: of the results of an image. output: what is written
    of a source. Raises ConfigError when two images or sources share a result, and when one would
    replace an image.
    """
    owners: dict[str, str] = dict.fromkeys((INDEX, CONFIG, COCO, RUN), "the run itself")
    sources = [(source, output(source)) for source in inputs.sources] if output else []
    numbered: dict[str, str] = {}
    # Path.resolve raises for a link to itself.
    files = [item.file for item in inputs.images] + [source.path for source in inputs.sources]
    images = {os.path.realpath(file) for file in files if file is not None}

    def take(name: str, origin: str, other: str | None = None) -> None:
        """Note whose result has a name, as index.csv calls it: two names may be one there."""
        other = other or owners.get(printable(name))
        if other is not None:
            problem = f"both would write {out}/{name}"
            raise ConfigError(
                f"{other} and {origin}", problem, "rename one, or use two --out folders"
            )
        if os.path.realpath(out / name) in images:
            raise ConfigError(out / name, "is one of the images", ELSEWHERE)
        owners[printable(name)] = origin

    for item in inputs.images:
        for suffix in [suffix for suffix in suffixes if "{}" not in suffix] or [""]:
            take(item.name + suffix, item.origin)
        folder, _, last = item.name.rpartition("/")
        if re.fullmatch(FRAME_NUMBER, last):
            numbered[folder] = item.origin
    for source, written in sources:
        frames = numbered.get(source.name) if written.of_frames else None
        take(source.name, source.origin, frames)
        for suffix in written.suffixes:
            take(source.name + suffix, source.origin)
    return Plan(inputs.images, sources)
