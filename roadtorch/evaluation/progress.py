"""A run that is interrupted goes on where it was: its counts so far, in one file."""

import hashlib
import json
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from roadtorch.data.dataset import Dataset
from roadtorch.errors import ConfigError
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.tally import Scored, Tally
from roadtorch.io.atomic import atomic
from roadtorch.layout.weights import tensors_hash

FILE = "progress.safetensors"
SAVE_EVERY = 20.0  # seconds of work that a power cut may cost, at least
SAVING = 0.05  # the share of the time that saving may take: hundreds of detectors are a gigabyte
REMEDY = "run it as before, or give another --out, or remove that file"


def fingerprint(dataset: Dataset, methods: Sequence[Method]) -> str:
    """What makes two runs the same: pictures, labels, detectors with settings, and our code."""
    files = [
        (item.name, item.group, *(_stamp(path) for path in (item.image, item.label)))
        for item in dataset.items
    ]
    code = sorted(Path(__file__).parents[1].rglob("*.py"))
    about = [(one.name, one.settings, one.threshold) for one in methods]
    groups = sorted(dataset.left_out)  # they teach prior:mean nothing
    parts = [dataset.name, dataset.split, files, groups, about, [_stamp(path) for path in code]]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _stamp(path: Path) -> tuple[str, int, int]:
    stat = path.stat() if path.exists() else None
    return str(path), stat.st_size if stat else -1, stat.st_mtime_ns if stat else -1


class SavedTallies:
    """The tallies of a run, saved now and then if there is a folder to save in."""

    def __init__(self, folder: Path | None, run: str) -> None:
        self.path = folder / FILE if folder else None
        self.run = run
        self.tallies: dict[str, Tally] = {}
        self._saved, self._pause = time.monotonic(), SAVE_EVERY
        if self.path and self.path.is_file():
            self.tallies = _load(self.path, run)

    def add(self, result: Scored) -> None:
        """Count one more picture, if it could be scored; save if the last time is a while ago."""
        for name, score in result.scores.items():
            self.tallies.setdefault(name, Tally()).add(result.item, score)
        if time.monotonic() - self._saved > self._pause:
            self.save()

    def sort(self, names: Sequence[str]) -> None:
        """Bring the pictures' rows into the order of the set, however the run came about."""
        for tally in self.tallies.values():
            tally.sort(names)

    @property
    def done(self) -> Collection[str]:
        """The names of the pictures that are counted."""
        first = next(iter(self.tallies.values()), Tally())
        return {name for name, _ in first.pictures}

    def save(self) -> None:
        """Write everything counted so far, whole or not at all."""
        if self.path is None or not self.tallies:
            return
        start = time.monotonic()
        tensors = {
            f"{index}/{key}": tensor.contiguous()
            for index, tally in enumerate(self.tallies.values())
            for key, tensor in tally.tensors().items()
        }
        pictures = next(iter(self.tallies.values())).pictures
        about = {"run": self.run, "detectors": list(self.tallies), "pictures": pictures}
        about["sha256"] = _digest(about, tensors)
        data = save(tensors, {"roadtorch": json.dumps(about)})
        with atomic(self.path) as temporary:
            temporary.write_bytes(data)
        self._saved = time.monotonic()
        self._pause = max(SAVE_EVERY, (self._saved - start) / SAVING)


def forget(folder: Path) -> None:
    """Remove what a run saved in a folder: its results are safe, and a new run starts anew."""
    (folder / FILE).unlink(missing_ok=True)


def _load(path: Path, run: str) -> dict[str, Tally]:
    """The tallies in a file of the same run.

    Raises ConfigError when it is of another one, or not the file that was saved.
    """
    try:
        with safe_open(path, "pt") as file:
            about = json.loads(file.metadata()["roadtorch"])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        if about["run"] != run:
            what = "holds the beginning of another run (other pictures, settings or code)"
            raise ConfigError(path, what, REMEDY)
        if about.pop("sha256") != _digest(about, tensors):
            raise ValueError("damaged")
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RecursionError):
        raise ConfigError(path, "is not the progress of a run, or damaged", REMEDY) from None
    by_detector: list[dict[str, Tensor]] = [{} for _ in about["detectors"]]
    for key, tensor in tensors.items():
        index, _, name = key.partition("/")
        by_detector[int(index)][name] = tensor
    return {
        name: Tally.of(own, about["pictures"])
        for name, own in zip(about["detectors"], by_detector, strict=True)
    }


def _digest(about: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of all that a file says and counts."""
    text = json.dumps(about, sort_keys=True) + tensors_hash(tensors)
    return hashlib.sha256(text.encode()).hexdigest()
