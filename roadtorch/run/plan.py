"""The plan of a run: its images and sources, the outputs of each, and the options of the run."""

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from roadtorch.base.bounded import to_printable
from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import INFER_CONFIG
from roadtorch.inputs.find import Inputs
from roadtorch.inputs.item import Item, Source
from roadtorch.run.folder import COCO_FILE, OUT_HINT, RUN_FILE
from roadtorch.run.ledger import FRAME_NUMBER, INDEX_FILE
from roadtorch.run.loop import FileWriter, Writer
from roadtorch.run.workers import Workers, count_processors, make_workers


@dataclass(frozen=True)
class RunOptions:
    """Options of a run."""

    jobs: int | None = None  # processes, or actors on Ray; None for an automatic number
    overwrite: bool = False  # redo finished results
    quiet: bool = False  # no progress on stderr
    engine: str = "local"  # ``local``, ``ray`` for Ray on this machine, or the address of a cluster
    threads: int = 1  # per image
    device: str = "cpu"  # of torch

    @contextmanager
    def workers(self, count: int | None) -> Iterator[Workers]:
        """Open workers for ``count`` items (None: unknown); ConfigError where Ray is missing."""
        if self.engine == "local":
            yield make_workers(self.jobs, count, self.device)
            return
        from roadtorch.run.ray_workers import ray_workers

        address = None if self.engine == "ray" else self.engine
        with ray_workers(self.jobs or count_processors(), address, self.device) as workers:
            yield workers


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
    results: Mapping[str, Item | Source | None]  # by name, as in ``claim_results``; None: the run

    @property
    def count(self) -> int | None:
        """Number of images; None where there is footage as well."""
        return None if self.sources else len(self.images)

    @property
    def row_names(self) -> list[str]:
        """Names of all images and sources in index.csv."""
        names = [item.row_name for item in self.images]
        return names + [source.row_name for source, _ in self.sources]


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
    run_files = INDEX_FILE, INFER_CONFIG, COCO_FILE, RUN_FILE
    owners: dict[str, str] = dict.fromkeys(run_files, "the run itself")
    sources = [(source, output(source)) for source in inputs.sources] if output else []
    numbered: dict[str, str] = {}
    results: dict[str, Item | Source | None] = dict.fromkeys(files)
    # Path.resolve raises for a link to itself.
    paths = [item.file for item in inputs.images] + [source.path for source in inputs.sources]
    images = {os.path.realpath(file) for file in paths if file is not None}

    def claim(name: str, origin: str, owner: str | None = None) -> None:
        """Claim a result's name as index.csv spells it: distinct file names may coincide there."""
        owner = owner or owners.get(to_printable(name))
        if owner is not None:
            problem, hint = f"both would write {out}/{name}", "rename one, or use two --out folders"
            raise ConfigError(f"{owner} and {origin}", problem, hint)
        if os.path.realpath(out / name) in images:
            raise ConfigError(out / name, "is one of the input images", OUT_HINT)
        owners[to_printable(name)] = origin

    for item in inputs.images:
        results |= dict.fromkeys((item.name + suffix for suffix in suffixes), item)
        for suffix in [suffix for suffix in suffixes if "{}" not in suffix] or [""]:
            claim(item.name + suffix, item.origin)
        folder, _, last = item.name.rpartition("/")
        if re.fullmatch(FRAME_NUMBER, last):
            numbered[folder] = item.origin
    for source, outputs in sources:
        ends = [*outputs.suffixes, *(f"/{{}}{suffix}" for suffix in outputs.frame_suffixes)]
        results |= dict.fromkeys((source.name + end for end in ends), source)
        owner = numbered.get(source.name) if outputs.frame_suffixes else None
        claim(source.name, source.origin, owner)
        for suffix in outputs.suffixes:
            claim(source.name + suffix, source.origin)
    return Plan(inputs.images, sources, results)
