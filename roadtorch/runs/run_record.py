"""run.json: what a run was, with which versions, on what, and how it ended."""

import hashlib
import platform
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy
import torch

from roadtorch.detector import Detector
from roadtorch.errors import ExitCode, RoadtorchError
from roadtorch.io.atomic import digest_of, write_json
from roadtorch.layout.weights import corrected_pictures, tensors_hash
from roadtorch.runs.index import DOUBTFUL, INDEX, Publish, Row, read_index
from roadtorch.runtime.signals import Terminated
from roadtorch.runtime.threads import Threads
from roadtorch.version import __version__

RUN = "run.json"


@dataclass(frozen=True)
class RunRecord:
    """Where run.json goes, and what is known when a run begins.

    folder: of the results; index.csv is there. files: the pictures of this run, as index.csv
    names them. given: what else is to be kept of how it was started. publish: is given the file.
    """

    folder: Path
    detector: Detector
    files: tuple[str, ...]
    given: Mapping[str, object]
    publish: Publish

    def around(self, run: Callable[[], int]) -> int:
        """Do the run, which gives the exit code; write run.json however it ends."""
        started, status = _now(), ExitCode.SOME_FAILED
        try:
            status = run()
        except KeyboardInterrupt as stop:
            status = ExitCode.TERMINATED if isinstance(stop, Terminated) else ExitCode.INTERRUPTED
            raise
        except RoadtorchError:
            status = ExitCode.WRONG_USAGE
            raise
        finally:
            write_json(self.folder / RUN, self._document(started, status))
            self.publish(self.folder / RUN)
        return status

    def _document(self, started: str, status: int) -> dict[str, object]:
        rows = read_index(self.folder / INDEX)
        own = [rows[file] for file in self.files if file in rows]
        settings = self.detector.settings.model_dump(mode="json")
        return {
            "versions": versions(),
            "command": shlex.join(["roadtorch", *sys.argv[1:]]),
            "detector": self.detector.name,
            "settings": settings,
            "corrected_pictures": corrected_pictures(settings),
            "weights_sha256": tensors_hash(self.detector.state_dict()),
            "threads": vars(Threads.of_now()),
            "options": self.given,
            "inputs_sha256": inputs_hash(own),
            "index_sha256": digest_of(self.folder / INDEX),
            "started": started,
            "ended": _now(),
            "pictures": _counts(own, len(self.files)),
            "exit_status": status,
        }


def versions() -> dict[str, str]:
    """The versions that results may depend on."""
    return {
        "roadtorch": __version__,
        "torch": torch.__version__,
        "numpy": numpy.__version__,
        "opencv": cv2.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
    }


def inputs_hash(rows: Iterable[Row]) -> str:
    """SHA-256 over the lines ``<sha256 of the picture>  <file>`` of finished rows, sorted."""
    done = sorted((row for row in rows if not row.failed), key=lambda row: row.file)
    return hashlib.sha256(
        "".join(f"{row.sha256}  {row.file}\n" for row in done).encode()
    ).hexdigest()


def _counts(rows: list[Row], total: int) -> dict[str, int]:
    failed = sum(row.failed for row in rows)
    return {
        "all": total,
        "done": len(rows) - failed,
        "doubtful": sum(row.status.startswith(DOUBTFUL) for row in rows),
        "failed": failed,
        "not_tried": total - len(rows),
    }


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
