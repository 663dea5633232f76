"""The folder of a run's results: locked, here or behind a URL, and who owns which name in it."""

import posixpath
import re
import secrets
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from upath import UPath

from roadtorch.base.atomic import LEFTOVER, locked, make_folder, remove_leftovers, write_text
from roadtorch.base.bounded import printable, read_regular
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.urls import is_url, url_errors
from roadtorch.data.maps import CONFIG
from roadtorch.run.ledger import BAG_LIST, FRAME_NUMBER, INDEX

ELSEWHERE = "give another --out"
COCO, RUN = "coco.json", "run.json"

RENAMING = ("file", "local", "memory", "sftp", "ssh", "smb", "hdfs")
"""File systems that show a file while it is written, and rename at no cost. Those of object
stores show nothing before all is there, and rename by copying."""


@contextmanager
def output_lock(out: Path) -> Iterator[None]:
    """A folder for the results of this run alone, without what killed runs left half-written.

    Raises InputError before the work when it cannot be written, or another run writes there.
    """
    make_folder(out, ELSEWHERE)
    try:
        tempfile.TemporaryFile(dir=out).close()
    except OSError as problem:
        what = f"cannot be written: {problem.strerror}"
        raise InputError(out, what, ELSEWHERE) from None
    with locked(out, "wait for it, or give another --out"):
        remove_leftovers([out])
        yield


class Owners:
    """Whose results have which name in a run, whatever their source, so that none is lost."""

    def __init__(self, out: object) -> None:
        self._out = out
        own = (INDEX, CONFIG, COCO, RUN)
        self._files: dict[str, str] = dict.fromkeys(own, "the run itself")
        self._sources: dict[str, str] = {}
        self._footage: dict[str, str] = {}
        self._numbered: dict[str, str] = {}

    def take(self, name: str, suffixes: Iterable[str], origin: str) -> None:
        """Note whose results are ``name`` and a suffix; ConfigError where one is another's.

        That are also the files of the run itself, and those in the place of a frame's.
        """
        name = printable(name)  # as index.csv calls it: letters and a byte may look alike there
        files = [name + suffix for suffix in suffixes if "{}" not in suffix] or [name]
        folder, _, last = name.rpartition("/")
        is_numbered = re.fullmatch(FRAME_NUMBER, last) is not None
        for file in files:
            self._refuse(self._files.get(file), origin, file)
            self._refuse(self._footage.get(folder) if is_numbered else None, origin, file)
        self._files |= dict.fromkeys(files, origin)
        if is_numbered:
            self._numbered[folder] = origin

    def take_source(self, name: str, origin: str, has_files: bool) -> None:
        """Note whose results NAME are, and NAME/000123 of frames with files; errors as above."""
        self._refuse(self._sources.get(name), origin, name)
        self._sources[name] = origin
        if has_files:
            self._refuse(self._numbered.get(name), origin, f"frames in {name}")
            self._footage[name] = origin

    def _refuse(self, other: str | None, origin: str, file: str) -> None:
        if other is not None:
            what = f"both would write {self._out}/{file}"
            raise ConfigError(f"{other} and {origin}", what, "rename one, or use two --out folders")


@dataclass(frozen=True)
class ResultFolder:
    """The folder of a run's results, on this machine or behind a URL.

    path: where index.csv and what else is of the whole run is kept on this machine. url: of the
    folder to which the files go; empty where that is ``path``.
    """

    path: Path
    url: str = ""

    def __str__(self) -> str:
        """What messages call it."""
        return self.url or str(self.path)

    @contextmanager
    def staged(self) -> Iterator[Path]:
        """A folder of this machine for the files of one item, which are then put into place."""
        if not self.url:
            yield self.path
            return
        with tempfile.TemporaryDirectory(prefix="roadtorch-") as scratch:
            yield Path(scratch)
            for file in sorted(path for path in Path(scratch).rglob("*") if path.is_file()):
                self._put(file.relative_to(scratch).as_posix(), file.read_bytes())

    def publish(self, file: Path) -> None:
        """Put a file of ``path`` where it belongs, if that is elsewhere."""
        if self.url:
            self._put(file.name, file.read_bytes())

    def has(self, name: str) -> bool:
        """Whether a result is there; a bag that is a folder has its list once it is done."""
        if not self.url:
            path = self.path / name
            with suppress(OSError):  # a name that is too long, which nothing can have
                return path.is_file() or (path / BAG_LIST).is_file()
            return False
        with url_errors(f"{self.url}/{name}"):
            return UPath(self.url, name).is_file()

    def read(self, name: str) -> bytes | None:
        """The bytes of a result; None where there is none. InputError when it cannot be read."""
        with url_errors(f"{self}/{name}"):
            file = UPath(self.url or str(self.path), name)
            return file.read_bytes() if file.exists() else None

    def tidy(self) -> None:
        """Remove what killed workers left half-written behind the URL; nobody may write there."""
        with url_errors(self.url):
            system: Any = UPath(self.url).fs
            if _renames(system):
                for file in system.find(UPath(self.url).path):
                    if LEFTOVER.fullmatch(posixpath.basename(file)):
                        system.rm_file(file)

    def _put(self, name: str, data: bytes) -> None:
        with url_errors(f"{self.url}/{name}"):
            file = UPath(self.url, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            if not _renames(file.fs):
                file.write_bytes(data)
                return
            half = file.parent / f".roadtorch.{secrets.token_hex(4)}.part"
            half.write_bytes(data)
            file.fs.mv(half.path, file.path)


def _renames(system: Any) -> bool:
    kinds = system.protocol if isinstance(system.protocol, tuple) else (system.protocol,)
    return any(kind in RENAMING for kind in kinds)


@contextmanager
def result_folder(out: str, effective: str, overwrite: bool) -> Iterator[ResultFolder]:
    """The folder of a run's results, for this run alone, with its settings, ``effective``, in it.

    Behind a URL nobody is kept out; there, a folder of this machine stands for it meanwhile, with
    what an earlier run kept beside its results. Raises as ``output_lock``, and ConfigError if
    earlier settings were different, unless ``overwrite``: a second run with another detector would
    skip what the first one did, and the folder would mix the results of both.
    """
    with ExitStack() as stack:
        if not is_url(out):
            stack.enter_context(output_lock(Path(out)))
            folder = ResultFolder(Path(out))
        elif "::" in out:
            what = "is inside another file"
            raise InputError(out, what, "give the URL of a folder that can be written")
        else:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="roadtorch-")))
            folder = ResultFolder(path, out.rstrip("/"))
            folder.tidy()
            for name in (INDEX, CONFIG):
                if (data := folder.read(name)) is not None:
                    write_text(path / name, data.decode("utf-8", "surrogateescape"))
        config, effective = folder.path / CONFIG, effective + "\n"
        try:
            is_other = config.exists() and read_regular(config) != printable(effective).encode()
        except OSError as problem:
            raise InputError(config, f"cannot be read: {problem.strerror}", ELSEWHERE) from None
        if is_other and (folder.path / INDEX).exists() and not overwrite:
            what = f"holds results of other settings ({CONFIG})"
            raise ConfigError(folder, what, ELSEWHERE + ", or --overwrite")
        write_text(config, effective)
        folder.publish(config)
        yield folder
