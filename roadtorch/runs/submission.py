"""What ``submit`` writes: one bird's-eye map a picture, and the archive of them all."""

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

from roadtorch.camera.birds_eye import read_calibration, to_birds_eye
from roadtorch.data.kitti import result_name
from roadtorch.detector import Detector
from roadtorch.io.atomic import atomic
from roadtorch.io.image import read_image, write_map
from roadtorch.runs import batch
from roadtorch.runs.batch import Job
from roadtorch.runs.index import Row
from roadtorch.sources.pictures import Picture

ARCHIVE = "submission.zip"
SUFFIX = ".png"
READABLE_BY_ALL = 0o644 << 16  # where zip keeps the Unix permissions


def plan_maps(images: Path, calib: Path, out: Path) -> list[Job]:
    """The jobs for a folder of KITTI road pictures, their results named as the server wants.

    A picture whose calibration file in ``calib`` has changed is done anew.

    Raises what ``batch.plan`` raises, and DatasetError for a picture that is not named
    CATEGORY_NUMBER.
    """
    jobs = batch.plan([str(images)], out, {"map": SUFFIX})
    return [
        replace(
            job,
            picture=Picture(job.picture.path, result_name(job.picture.name)),
            beside=(calibration_file(calib, job.picture.path),),
        )
        for job in jobs
    ]


def calibration_file(calib: Path, picture: Path) -> Path:
    """The calibration of a picture, in the folder of all of them."""
    return calib / f"{picture.stem}.txt"


@dataclass(frozen=True)
class Submission:
    """The work on one picture: detect the road, look at it from above, write."""

    detector: Detector
    calib: Path

    def __call__(self, job: Job) -> Row:
        """Write the map of one picture: 8 bits, 800 rows, 400 columns, round(255 p)."""
        start = perf_counter()
        source = job.picture.path
        calibration = read_calibration(calibration_file(self.calib, source))
        detection = self.detector.detect(read_image(source))
        write_map(job.output(SUFFIX), to_birds_eye(detection.likelihood, calibration))
        height, width = detection.mask.shape
        share = float(detection.mask.double().mean())
        ms = 1000 * (perf_counter() - start)
        return Row(job.file, str(width), str(height), f"{ms:.0f}", f"{share:.4f}")


def pack(jobs: Sequence[Job], path: Path) -> None:
    """Write the maps of all jobs as a zip archive, files at its root; same maps, same bytes."""
    with atomic(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for job in jobs:
            output = job.output(SUFFIX)
            entry = zipfile.ZipInfo(output.name)  # dated 1980, not now
            entry.external_attr = READABLE_BY_ALL
            archive.writestr(entry, output.read_bytes())
