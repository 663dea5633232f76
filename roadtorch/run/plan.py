"""The plan of a run: its images and sources, the outputs of each, and the options of the run."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roadtorch.base.atomic import OUT_HINT
from roadtorch.base.bounded import to_printable
from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import INFER_CONFIG
from roadtorch.inputs.find import Inputs
from roadtorch.inputs.item import Item, Source
from roadtorch.run.ledger import COCO_FILE, FRAME_NUMBER, INDEX_FILE, RUN_FILE
from roadtorch.run.loop import FileWriter, Writer


@dataclass(frozen=True)
class RunOptions:
    """Options of a run."""

    jobs: int | None = None  # processes; None for an automatic number
    overwrite: bool = False  # redo finished results
    quiet: bool = False  # no progress on stderr
    device: str = "cpu"  # of torch


class Writers(NamedTuple):
    """The writers of one source."""

    files: FileWriter  # of each frame; an error fails that frame
    streams: Sequence[Writer] = ()  # of the whole source, such as videos; an error ends the source


class Output(NamedTuple):
    """The outputs of a command for one source."""

    kinds: tuple[str, ...]  # of results, as in index.csv
    suffixes: Sequence[str]  # of files of the whole source
    frame_suffixes: Sequence[str]  # of files of each frame
    open: Callable[[], AbstractContextManager[Writers]]  # closes the writers after the block
    cues: bool = False  # whether the writers need full-size cues


class Plan(NamedTuple):
    """The single images and the sources (videos, streams, bags) that a run processes."""

    images: Sequence[Item]
    sources: Sequence[tuple[Source, Output]]
    results: Mapping[str, Item | Source | None]  # by name, as in ``open_ledger``

    @property
    def image_count(self) -> int | None:
        """Number of images; None where there is footage as well."""
        return None if self.sources else len(self.images)

    @property
    def row_names(self) -> list[str]:
        """Names of all images and sources in index.csv."""
        return [item.row_name for item in (*self.images, *(source for source, _ in self.sources))]


def plan_run(
    inputs: Inputs,
    out: Path,
    suffixes: Sequence[str],
    output: Callable[[Source], Output] | None = None,
    files: Sequence[str] = (),
) -> Plan:
    """Plan a run, and check that no two results share a file name; nothing is written yet.

    out: output folder. suffixes: of the results of a single image. output: returns the outputs of
    a source. files: of the run, beside index.csv and config.toml. Raises ConfigError where two
    inputs would write the same file, or one would overwrite an input image.
    """
    sources = [(source, output(source)) for source in inputs.sources] if output else []
    results = [(item.name + suffix, item) for item in inputs.images for suffix in suffixes]
    for source, outputs in sources:
        ends = [*outputs.suffixes, *(f"/{{}}{suffix}" for suffix in outputs.frame_suffixes)]
        results += [(source.name + end, source) for end in ends]
    run_files = INDEX_FILE, INFER_CONFIG, COCO_FILE, RUN_FILE
    owners: dict[str, str] = dict.fromkeys(run_files, "the run itself")
    # Names as index.csv spells them: distinct file names may coincide there.
    for name, item in [*results, *((f"{source.name}/", source) for source, _ in sources)]:
        if (owner := owners.get(to_printable(name))) is not None:
            raise _shared_name(out / name, owner, item.origin)
        owners[to_printable(name)] = item.origin
    frames = {source.name: source for source, outputs in sources if outputs.frame_suffixes}
    for item in inputs.images:
        folder, _, last = item.name.rpartition("/")
        if folder in frames and re.fullmatch(FRAME_NUMBER, last):
            raise _shared_name(out / item.name, item.origin, frames[folder].origin)
    # Path.resolve raises for a link to itself.
    paths = [item.file for item in inputs.images] + [source.path for source in inputs.sources]
    images = {os.path.realpath(file) for file in paths if file is not None}
    for name, _ in results:
        if os.path.realpath(out / name) in images:
            raise ConfigError(out / name, "is one of the input images", OUT_HINT)
    return Plan(inputs.images, sources, {**dict.fromkeys(files), **dict(results)})


def _shared_name(path: Path, owner: str, claimant: str) -> ConfigError:
    hint = "rename one, or use two --out folders"
    return ConfigError(f"{owner} and {claimant}", f"both would write {path}", hint)
