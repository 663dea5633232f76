"""Pictures and results behind URLs: the same work, with files of this machine in between."""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from roadtorch.errors import ConfigError, InputError, RoadtorchError
from roadtorch.io.atomic import write_text
from roadtorch.io.bounded import printable
from roadtorch.runs.batch import Job, Row, Work
from roadtorch.runs.index import INDEX
from roadtorch.runs.results import CONFIG
from roadtorch.sinks.remote_folder import RemoteFolder
from roadtorch.sources.pictures import Picture, find_images


@dataclass(frozen=True)
class RemoteJob:
    """A picture and the folder of its results, both behind URLs; see ``Job``."""

    picture: Picture
    out: RemoteFolder
    suffixes: Mapping[str, str]

    @property
    def origin(self) -> str:
        """The URL of the picture."""
        return str(self.picture.origin)

    @property
    def suffix(self) -> str:
        """How the picture's name ends."""
        return self.picture.suffix

    @property
    def file(self) -> str:
        """The name in index.csv: the result's name with the picture's own suffix."""
        return printable(self.picture.name + self.suffix)

    @property
    def is_complete(self) -> bool:
        """Whether all files exist whose names are known beforehand."""
        return all(self.out.has(self.picture.name + end) for end in self.suffixes.values())

    def has_all(self, row: Row) -> bool:
        """The same: what is behind a URL is asked for by names that are known beforehand."""
        return self.is_complete

    def digest(self) -> str:
        """SHA-256 of the bytes of the picture; empty where it cannot be read."""
        with suppress(RoadtorchError):
            return hashlib.sha256(self.picture.data()).hexdigest()
        return ""


def plan_remote(
    inputs: Sequence[str], out: RemoteFolder, suffixes: Mapping[str, str]
) -> list[RemoteJob]:
    """The jobs for URLs and paths; see ``batch.plan``.

    Raises ConfigError when two pictures share a result, InputError when nothing is found.
    """
    found: dict[str, RemoteJob] = {}
    for picture in find_images(inputs):
        other = found.setdefault(picture.name, RemoteJob(picture, out, suffixes))
        if other.picture != picture:
            what = f"both would write {out.shown(picture.name)}"
            remedy = "rename one, or use two --out folders"
            raise ConfigError(f"{other.origin} and {picture.origin}", what, remedy)
    return list(found.values())


@dataclass(frozen=True)
class Fetched:
    """Work on remote jobs: the picture is fetched, worked on as a file, the results put back."""

    work: Work

    def __call__(self, job: RemoteJob) -> Row:
        """Make the results of one job; errors name its URL."""
        with TemporaryDirectory(prefix="roadtorch-") as scratch:
            picture = Path(scratch, "in", "picture" + job.suffix)
            data = job.picture.data()
            picture.parent.mkdir()
            picture.write_bytes(data)
            here = Job(Picture(picture, job.picture.name), Path(scratch, "out"), job.suffixes)
            try:
                row = self.work(here)
            except InputError as problem:
                where = job.origin if problem.where == str(picture) else problem.where
                raise InputError(where, problem.what, problem.remedy) from None
            for file in sorted(here.out.rglob("*")):
                if file.is_file():
                    job.out.write(file.relative_to(here.out).as_posix(), file.read_bytes())
        return replace(row, file=job.file, sha256=hashlib.sha256(data).hexdigest())


@dataclass(frozen=True)
class Mirror:
    """A folder of this machine that stands for a remote one while a run goes on."""

    folder: Path
    remote: RemoteFolder

    def fetch(self) -> None:
        """Bring what an earlier run kept beside its results; InputError when it cannot be read."""
        self.remote.tidy()
        for name in (INDEX, CONFIG):
            if (data := self.remote.read(name)) is not None:
                write_text(self.folder / name, data.decode("utf-8", "surrogateescape"))
