"""What the server of the KITTI road benchmark wants: maps from above, and their archive."""

import hashlib
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from roadtorch.base.atomic import atomic, digest_of
from roadtorch.base.image import write_map
from roadtorch.camera.birds_eye import to_birds_eye
from roadtorch.camera.calibration import read_calibration
from roadtorch.data.kitti import result_name
from roadtorch.detectors.detector import Detection
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.run.ledger import DONE

ARCHIVE = "submission.zip"
SUFFIX = ".png"
READABLE_BY_ALL = 0o644 << 16  # where zip keeps the Unix permissions


def images_to_submit(images: Path, calib: Path, out: Path) -> list[Item]:
    """The images of a folder of KITTI road, named as the server wants their results.

    The calibration file of each, in ``calib``, is part of its bytes. Raises what ``find_images``
    raises, and DatasetError for an image that is not named CATEGORY_NUMBER.
    """
    return [
        replace(
            item,
            name=result_name(item.name),
            digest=partial(_digest, item.path, calib / f"{item.path.stem}.txt"),
        )
        for item in find_images([images], out)
    ]


def _digest(*files: Path) -> str:
    """SHA-256 of the files together; empty where one cannot be read."""
    digests = [digest_of(file) for file in files]
    return hashlib.sha256("".join(digests).encode()).hexdigest() if all(digests) else ""


@dataclass(frozen=True)
class BirdsEyeMaps:
    """Maps of 8 bits, 800 rows, 400 columns, round(255 p); calib: the folder of calibrations."""

    folder: Path
    calib: Path

    @property
    def suffixes(self) -> Sequence[str]:
        """How the names of its files end."""
        return [SUFFIX]

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the map of one image."""
        calibration = read_calibration(self.calib / f"{item.path.stem}.txt")
        birds_eye = to_birds_eye(detection.likelihood, calibration)
        write_map(self.folder / f"{item.name}{SUFFIX}", birds_eye)
        return {"trust": "", "status": DONE}


def pack(items: Iterable[Item], folder: Path) -> Path:
    """Write the maps of all items as a zip archive, files at its root; same maps, same bytes."""
    path = folder / ARCHIVE
    with atomic(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for item in items:
            entry = zipfile.ZipInfo(f"{item.name}{SUFFIX}")  # dated 1980, not now
            entry.external_attr = READABLE_BY_ALL
            archive.writestr(entry, (folder / entry.filename).read_bytes())
    return path
