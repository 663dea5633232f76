"""Submissions to the KITTI road benchmark: maps in bird's-eye view and their archive."""

import hashlib
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from roadtorch.base.atomic import atomic_write, file_digest
from roadtorch.base.image import write_map
from roadtorch.camera.birds_eye import warp_to_birds_eye
from roadtorch.camera.calibration import read_calibration
from roadtorch.data.kitti_road import result_name
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.run.ledger import DONE

SUBMISSION_FILE = "submission.zip"
MAP_SUFFIX = ".png"
WORLD_READABLE = 0o644 << 16  # zip's field for Unix permissions


def find_submission_images(images: Path, calib: Path, out: Path) -> list[Item]:
    """Find the images of a KITTI road folder, named as the server expects their results.

    The digest of each covers its calibration file in ``calib``. Raises as ``find_images``, and
    DatasetError for an image that is not named CATEGORY_NUMBER.
    """
    return [
        replace(
            item,
            name=result_name(item.name),
            digest=partial(_digest, item.path, calib / f"{item.path.stem}.txt"),
        )
        for item in find_images([images], out)
    ]


def _digest(image: Path, calibration: Path, data: bytes | None = None) -> str:
    """Return the SHA-256 of two files, the first by its bytes; empty where one cannot be read."""
    digests = [file_digest(image, data), file_digest(calibration)]
    return hashlib.sha256("".join(digests).encode()).hexdigest() if all(digests) else ""


@dataclass(frozen=True)
class BirdsEyeWriter:
    """A writer of 8-bit maps, 800 rows by 400 columns, round(255 p); calib: calibration folder."""

    folder: Path
    calib: Path
    suffixes: Sequence[str] = (MAP_SUFFIX,)

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Warp the likelihood of an image to bird's-eye view and write it."""
        calibration = read_calibration(self.calib / f"{item.path.stem}.txt")
        birds_eye = warp_to_birds_eye(detection.likelihood, calibration)
        write_map(self.folder / f"{item.name}{MAP_SUFFIX}", birds_eye)
        return {"trust": "", "status": DONE}


def pack_submission(items: Iterable[Item], folder: Path) -> Path:
    """Write the maps of all items to a reproducible zip archive, without folders."""
    path = folder / SUBMISSION_FILE
    with atomic_write(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for item in items:
            entry = zipfile.ZipInfo(f"{item.name}{MAP_SUFFIX}")  # dated 1980: reproducible bytes
            entry.external_attr = WORLD_READABLE
            archive.writestr(entry, (folder / entry.filename).read_bytes())
    return path
