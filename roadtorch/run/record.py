"""run.json: the command, settings, versions, inputs and exit status of a run."""

import hashlib
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib import import_module

from roadtorch.base.atomic import write_json
from roadtorch.base.bounded import strip_password
from roadtorch.base.compute import Threads
from roadtorch.base.errors import ExitCode, RoadtorchError
from roadtorch.base.signals import SigtermInterrupt
from roadtorch.detectors.detector import Detector
from roadtorch.layout.weights import count_corrected_images, hash_tensors
from roadtorch.run.ledger import RUN_FILE, Ledger, index_text


@contextmanager
def record_run(
    ledger: Ledger,
    detector: Detector,
    files: Sequence[str],
    options: Mapping[str, object],
    command: str,
) -> Iterator[None]:
    """Write run.json when the block ends in any way; files: names of the images in index.csv."""
    started, status = _now(), ExitCode.SOME_FAILED
    try:
        yield
        status = None
    except KeyboardInterrupt as stop:
        status = ExitCode.TERMINATED if isinstance(stop, SigtermInterrupt) else ExitCode.INTERRUPTED
        raise
    except RoadtorchError as error:
        status = error.exit_code
        raise
    finally:
        tried = [ledger.rows[file] for file in files if file in ledger.rows]
        done = sorted((row for row in tried if not row.failed), key=lambda row: row.file)
        inputs = "".join(f"{row.sha256}  {row.file}\n" for row in done)
        settings = detector.settings.model_dump(mode="json")
        index = index_text(ledger.rows.values())
        document = {
            "versions": {  # results may depend on these
                **{
                    name: _version(name)
                    for name in ("roadtorch", detector.runtime, "torch", "numpy")
                },
                "opencv": _version("cv2"),
                "python": platform.python_version(),
                "platform": platform.platform(),
            },
            "command": command,
            "detector": detector.name,
            "runtime": detector.runtime,
            "settings": settings,
            "corrected_images": count_corrected_images(settings),
            "tensors_sha256": hash_tensors(detector.state_dict()),
            "threads": vars(Threads.current()),
            "options": {
                name: strip_password(value) if isinstance(value, str) else value
                for name, value in options.items()
            },
            "inputs_sha256": hashlib.sha256(inputs.encode()).hexdigest(),
            "index_sha256": hashlib.sha256(index.encode()).hexdigest(),
            "started": started,
            "ended": _now(),
            "images": {
                "all": len(files),
                "done": len(done),
                "doubtful": sum(row.doubtful for row in tried),
                "failed": len(tried) - len(done),
                "not_tried": len(files) - len(tried),
            },
            "exit_status": int(len(done) < len(tried)) if status is None else status,
        }
        if ledger.folder.is_dir():  # else it was moved during the run
            write_json(ledger.folder / RUN_FILE, document)


def _version(module: str) -> str:
    """Return the version of a module, whatever package it is of; onnxruntime has many."""
    try:
        return str(import_module(module).__version__)
    except (ImportError, AttributeError):
        return "unknown"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
