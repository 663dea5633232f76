"""The folder of a training run: settings, checkpoint, results."""

import csv
import io
import json
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch

from roadtorch.base.atomic import (
    OUT_HINT,
    atomic_write,
    claim_results,
    csv_text,
    file_digest,
    lock_folder,
    remove_leftovers,
    write_text,
)
from roadtorch.base.bounded import read_regular, regular_file_size
from roadtorch.base.decoding import suppress_warnings
from roadtorch.base.errors import ConfigError, InputError, WeightsError
from roadtorch.base.version import __version__
from roadtorch.inputs.item import Item
from roadtorch.run.memo import cache_key, file_digests
from roadtorch.train.prepared import PreparedImage, image_file_name

CHECKPOINT_FORMAT = 2
"""Format of checkpoints; raised when older code could not resume from them."""

RUN, CHECKPOINT, LOG, CURVE = "run.json", "checkpoint.pt", "log.csv", "curve.png"
IMAGES, WEIGHTS, ADAPTATION_PAGE = "images.csv", "weights.safetensors", "adaptation.html"
LABELS = "labels-"
"""Beginning of the names of folders of a network's labels; the number of the round follows."""

ROUND_WEIGHTS, SHEET = "round-{}.safetensors", "sheet-{}.jpg"
"""Weights of a round, and target images with the road that its network finds."""

CARD, PREPARED, CORRECTIONS = "weights.md", "prepared", "corrections"

RUN_FILES = (
    *(RUN, CHECKPOINT, LOG, CURVE, IMAGES, WEIGHTS, CARD, ADAPTATION_PAGE),
    *(ROUND_WEIGHTS, SHEET),
    *(f"{PREPARED}/", f"{CORRECTIONS}/", f"{LABELS}{{}}"),
)

BAD_CHECKPOINT = ("is damaged or no checkpoint", "start again in another --out")


def config_hash(values: Mapping[str, object]) -> str:
    """Return the SHA-256 of nested settings, independent of their order."""
    return sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def make_record(
    config: Mapping[str, object],
    images: Sequence[Item],
    corrections: Mapping[str, object] | None,
    source: Sequence[Path] = (),
) -> dict[str, Any]:
    """Return the content of run.json: settings, images and corrections, with a key of each.

    source: files of source images and their truth.
    """
    files = [(image_file_name(image), file_digest(image.path)) for image in images]
    return {
        "roadtorch": __version__,
        "config": config,
        "count": len(images),
        "corrections": corrections,
        "keys": {
            "settings": cache_key(config, file_digests(config)),
            "images": cache_key(files),
            "corrections": cache_key(corrections),
            "source": cache_key(*source),
        },
    }


@dataclass(frozen=True)
class RunFolder:
    """The files of one run."""

    path: Path

    @contextmanager
    def lock(self, names: Iterable[str] = RUN_FILES) -> Iterator[None]:
        """Create the folder, lock it and claim its files; InputError if another run has the lock.

        Their input is not compared: see ``check``.
        """
        with lock_folder(self.path), claim_results(self.path, dict.fromkeys(names, "")):
            yield

    def check(self, record: Mapping[str, Any]) -> None:
        """Check that the folder has no run, or a run with this record.

        record: of ``make_record``. Nothing is written. Raises ConfigError, InputError.
        """
        previous = self._read_record()
        if previous is None:
            return
        if previous["roadtorch"] != record["roadtorch"]:
            message = f"holds a run of roadtorch {previous['roadtorch']}"
            raise ConfigError(self.path, message, OUT_HINT)
        for part, key in record["keys"].items():
            if previous["keys"].get(part) != key:
                message = f"holds a run with other {part}"
                raise ConfigError(self.path, message, f"give those of {RUN}, or another --out")

    def begin(self, record: Mapping[str, object]) -> None:
        """Remove half-written files of killed runs, and write the record of this run."""
        remove_leftovers(self.path.glob(f"{LABELS}*"))
        write_text(self.path / RUN, json.dumps(record, indent=1) + "\n")

    def _read_record(self) -> dict[str, Any] | None:
        """Read the record of the run in the folder; None without one."""
        path = self.path / RUN
        if not path.exists():
            return None
        try:
            record = json.loads(read_regular(path).decode())
            if isinstance(record["keys"], dict) and isinstance(record["roadtorch"], str):
                return record
        except (ValueError, KeyError, TypeError, OSError, RecursionError):
            pass
        raise InputError(path, "is no record of a training run", OUT_HINT)

    # --- checkpoint -------------------------------------------------------------------------

    def write_checkpoint(self, state: Mapping[str, object]) -> None:
        """Write the state of a run atomically."""
        data = io.BytesIO()  # torch would raise an error of its own for a full disk
        torch.save({"format": CHECKPOINT_FORMAT, **state}, data)
        with atomic_write(self.path / CHECKPOINT) as temporary:
            temporary.write_bytes(data.getvalue())

    def read_checkpoint(self) -> dict[str, Any] | None:
        """Read the state of the run; None before the first checkpoint.

        Raises WeightsError for a file that is damaged or of another format.
        """
        path = self.path / CHECKPOINT
        if not path.exists():
            return None
        try:
            regular_file_size(path)
            with suppress_warnings():  # about damaged files
                state = torch.load(path, map_location="cpu", weights_only=True)
            number = int(state["format"])
        except Exception:  # zipfile, pickle and torch raise anything for foreign bytes
            raise WeightsError(path, *BAD_CHECKPOINT) from None
        if number != CHECKPOINT_FORMAT:
            message = f"has the format {number}; this roadtorch reads {CHECKPOINT_FORMAT}"
            raise WeightsError(path, message, "use the roadtorch that made it")
        return state

    # --- results ----------------------------------------------------------------------------

    def write_images(
        self, prepared: Iterable[PreparedImage], held_out: Container[str] = ()
    ) -> None:
        """Write the list of images: used, held out, or the reason why one was skipped."""
        rows = (
            {
                "file": item.name,
                "status": item.error or ("held out" if item.name in held_out else "used"),
            }
            for item in prepared
        )
        write_text(self.path / IMAGES, csv_text(["file", "status"], rows))

    def write_log(self, rows: Sequence[Mapping[str, object]]) -> None:
        """Write the epochs as CSV."""
        write_text(self.path / LOG, csv_text(list(rows[0]), rows))

    def read_log(self) -> list[dict[str, float]]:
        """Read round, epoch, loss and held-out F, where there is one, of each epoch.

        Rounds are halves of an adaptation.
        """
        parsers = {"round": int, "epoch": int, "loss": float, "held_out_f": float}
        with (self.path / LOG).open(newline="", encoding="utf-8") as file:
            return [
                {key: parse(row[key]) for key, parse in parsers.items() if key in row}
                for row in csv.DictReader(file)
            ]

    def write_curve(self, rows: Sequence[Mapping[str, float]]) -> None:
        """Write a chart of the loss by epoch."""
        from matplotlib.figure import Figure

        from roadtorch.evaluation.report.adaptation import draw_epochs

        figure = Figure(figsize=(6, 4), layout="constrained")
        draw_epochs(figure, rows)
        with atomic_write(self.path / CURVE) as temporary:
            figure.savefig(temporary, format="png", dpi=120)
