"""The folder of a run's results: locked, here or behind a URL, and what is in it for all pictures.

That is config.toml (the settings), coco.json (the masks as polygons) and run.json (how it went).
"""

import hashlib
import platform
import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path, PurePath

import cv2
import numpy as np
import torch

from roadtorch.data.annotations import read_annotation
from roadtorch.data.maps import CONFIG
from roadtorch.data.polygons import filled_shapes
from roadtorch.detector import Detector
from roadtorch.errors import ConfigError, ExitCode, InputError, RoadtorchError
from roadtorch.io.atomic import (
    atomic,
    digest_of,
    locked,
    make_folder,
    remove_leftovers,
    write_json,
    write_text,
)
from roadtorch.io.bounded import printable, read_regular
from roadtorch.layout.weights import corrected_pictures, tensors_hash
from roadtorch.runs.index import DOUBTFUL, INDEX, read_index
from roadtorch.runtime.signals import Terminated
from roadtorch.runtime.threads import Threads
from roadtorch.sinks.polygons import ROAD, CocoPicture, coco_text
from roadtorch.sinks.remote_folder import RemoteFolder
from roadtorch.version import __version__

ELSEWHERE = "give another --out"
COCO, RUN = "coco.json", "run.json"
FRAME_NUMBER = r"\d{6,}"
"""What follows ``NAME/`` in the names of a source's frames."""

POLYGONS = ".labelme.json"
"""How the name of the annotation file of a picture ends."""


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

    def __init__(self, out: Path | RemoteFolder) -> None:
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
        files = [name + end for end in suffixes] or [name]
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
            result = self._out / file if isinstance(self._out, Path) else self._out.shown(file)
            remedy = "rename one, or use two --out folders"
            raise ConfigError(f"{other} and {origin}", f"both would write {result}", remedy)


@dataclass(frozen=True)
class ResultFolder:
    """A folder in which a run keeps index.csv and what else is of all pictures.

    path: on this machine; where the results go behind a URL, ``remote``, it stands for that one.
    """

    path: Path
    remote: RemoteFolder | None = None

    @property
    def shown(self) -> str:
        """What messages call it."""
        return str(self.path) if self.remote is None else self.remote.url

    def publish(self, path: Path) -> None:
        """Put a file of it where it belongs, if that is elsewhere."""
        if self.remote is not None:
            self.remote.write(path.name, path.read_bytes())

    def write_coco(self) -> None:
        """Write the pictures whose polygons are kept, sorted by file, as one COCO file.

        A second run makes it anew of all that is there, so that it is whole whatever was
        interrupted. Raises InputError when it cannot be written, DatasetError for an annotation
        that cannot be read.
        """
        rows = read_index(self.path / INDEX).values()
        saved = [row for row in rows if not row.failed and "polygons" in row.saved.split()]
        ready = {
            row.file: row
            for row in sorted(saved, key=lambda row: row.file)
            if self.remote is not None or self._annotation(row.file).is_file()
        }
        pictures = [
            CocoPicture(
                row.file,
                (int(row.width), int(row.height)),
                float(row.trust) if row.trust else None,
            )
            for row in ready.values()
        ]
        path = self.path / COCO
        with tempfile.TemporaryDirectory(prefix="roadtorch-") as scratch:

            def mask_of(file: str) -> np.ndarray:
                """bool (H,W), as the annotation of a picture draws it."""
                annotation = self._annotation(file)
                if self.remote is not None:
                    annotation = Path(scratch, "annotation.json")
                    annotation.write_bytes(self.remote.read(annotation_name(file)) or b"")
                size = int(ready[file].height), int(ready[file].width)
                drawings = read_annotation(annotation, size)
                shapes = [(one.fill, int(one.name == ROAD)) for one in drawings]
                return filled_shapes(shapes, size) > 0

            with atomic(path) as temporary, temporary.open("w", encoding="utf-8") as text:
                text.writelines(coco_text(pictures, mask_of))
        self.publish(path)

    def _annotation(self, file: str) -> Path:
        """Where the outline is of a frame, whose name has no suffix, or else of a picture."""
        of_frame = self.path / (file + POLYGONS)
        return of_frame if of_frame.is_file() else self.path / annotation_name(file)


@contextmanager
def result_folder(
    out: Path | RemoteFolder, effective: str, overwrite: bool
) -> Iterator[ResultFolder]:
    """The folder of a run's results, for this run alone, with its settings, ``effective``, in it.

    Behind a URL nobody is kept out; there, a folder of this machine stands for it meanwhile, with
    what an earlier run kept beside its results. Raises as ``output_lock``, and ConfigError if
    earlier settings were different, unless ``overwrite``: a second run with another detector would
    skip what the first one did, and the folder would mix the results of both.
    """
    with ExitStack() as stack:
        if isinstance(out, Path):
            stack.enter_context(output_lock(out))
            folder = ResultFolder(out)
        else:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="roadtorch-")))
            out.tidy()
            for name in (INDEX, CONFIG):
                if (data := out.read(name)) is not None:
                    write_text(path / name, data.decode("utf-8", "surrogateescape"))
            folder = ResultFolder(path, out)
        config, effective = folder.path / CONFIG, effective + "\n"
        try:
            is_other = config.exists() and read_regular(config) != printable(effective).encode()
        except OSError as problem:
            raise InputError(config, f"cannot be read: {problem.strerror}", ELSEWHERE) from None
        if is_other and (folder.path / INDEX).exists() and not overwrite:
            what = f"holds results of other settings ({CONFIG})"
            raise ConfigError(folder.shown, what, "give another --out, or --overwrite")
        write_text(config, effective)
        folder.publish(config)
        yield folder


def annotation_name(file: str) -> str:
    """The annotation file of a picture that index.csv calls ``file``, below the results."""
    return PurePath(file).with_suffix("").as_posix() + POLYGONS


# --- run.json ---------------------------------------------------------------------------


@dataclass(frozen=True)
class RunRecord:
    """What is known when a run begins.

    files: the pictures of this run, as index.csv names them. given: what else is to be kept of
    how it was started.
    """

    folder: ResultFolder
    detector: Detector
    files: Sequence[str]
    given: Mapping[str, object]

    def around(self, run: Callable[[], int], has_polygons: bool) -> int:
        """Do the run, which gives the exit code; write run.json, and coco.json, however it ends.

        What it was, with which versions, on what, and how it ended.
        """
        started, status = _now(), ExitCode.SOME_FAILED
        try:
            try:
                status = run()
            finally:
                if has_polygons:
                    self.folder.write_coco()
        except KeyboardInterrupt as stop:
            status = ExitCode.TERMINATED if isinstance(stop, Terminated) else ExitCode.INTERRUPTED
            raise
        except RoadtorchError:
            status = ExitCode.WRONG_USAGE
            raise
        finally:
            path = self.folder.path / RUN
            write_json(path, self._document(started, status))
            self.folder.publish(path)
        return status

    def _document(self, started: str, status: int) -> dict[str, object]:
        index = self.folder.path / INDEX
        rows = read_index(index)
        own = [rows[file] for file in self.files if file in rows]
        done = sorted((row for row in own if not row.failed), key=lambda row: row.file)
        inputs = "".join(f"{row.sha256}  {row.file}\n" for row in done)
        settings = self.detector.settings.model_dump(mode="json")
        return {
            "versions": {  # those that results may depend on
                "roadtorch": __version__,
                "torch": torch.__version__,
                "numpy": np.__version__,
                "opencv": cv2.__version__,
                "python": platform.python_version(),
                "platform": platform.platform(),
            },
            "command": shlex.join(["roadtorch", *sys.argv[1:]]),
            "detector": self.detector.name,
            "settings": settings,
            "corrected_pictures": corrected_pictures(settings),
            "weights_sha256": tensors_hash(self.detector.state_dict()),
            "threads": vars(Threads.of_now()),
            "options": self.given,
            "inputs_sha256": hashlib.sha256(inputs.encode()).hexdigest(),
            "index_sha256": digest_of(index),
            "started": started,
            "ended": _now(),
            "pictures": {
                "all": len(self.files),
                "done": len(done),
                "doubtful": sum(row.status.startswith(DOUBTFUL) for row in own),
                "failed": len(own) - len(done),
                "not_tried": len(self.files) - len(own),
            },
            "exit_status": status,
        }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
