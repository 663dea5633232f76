"""What is written of one picture: by ``infer``, by ``label`` and by ``submit``."""

import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Literal

import torch
from torch import Tensor

from roadtorch.camera.birds_eye import to_birds_eye
from roadtorch.camera.calibration import read_calibration
from roadtorch.camera.camera import Camera
from roadtorch.data.kitti import result_name
from roadtorch.data.maps import MASK
from roadtorch.detector import Detection, Detector, checked_image
from roadtorch.io.atomic import atomic, digest_of, make_folder, write_json
from roadtorch.io.image import (
    write_colours,
    write_jpeg,
    write_labels,
    write_map,
    write_mask,
    write_npy,
    write_overlay,
)
from roadtorch.layout.classes import HORIZONTAL, LAYOUT_COLOURS, layout_colours
from roadtorch.layout.labeller import LabellerSettings, label_layout
from roadtorch.layout.weights import tensors_hash
from roadtorch.runs.folder import ELSEWHERE, POLYGONS
from roadtorch.runs.index import DONE, DOUBTFUL, Row
from roadtorch.runs.pictures import Job, Method, method_of, plan
from roadtorch.sinks.polygons import labelme_document
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.version import __version__

SUFFIXES = {
    "likelihood": ".likelihood.png",
    "mask": MASK,
    "overlay": ".overlay.jpg",
    "npy": ".likelihood.npy",
    "polygons": POLYGONS,
    "json": ".json",
}

CUE_SUFFIXES = {"cues": ".cue.{}.png", "npy": ".{}.npy"}
"""Of the kinds that write a file a cue."""

GOLDEN = 0.6180339887  # the fractional step that spreads neighbouring labels over the colours


def detector_method(
    detector: Detector, effective: str, kinds: Iterable[str], *parts: bytes
) -> Method:
    """The method of a detector: settings, weights, and the files that its settings name.

    effective: its settings as TOML. parts: what else decides on the results.
    """
    weights = tensors_hash(detector.state_dict()).encode()
    files = [digest_of(Path(text)).encode() for text in _texts(detector.settings.model_dump())]
    return method_of(kinds, effective, *parts, *files, weights)


def _texts(values: object) -> Iterator[str]:
    """The texts in nested settings that may name files."""
    if isinstance(values, Mapping):
        for value in values.values():
            yield from _texts(value)
    elif isinstance(values, str):
        yield values


@dataclass(frozen=True)
class Inference:
    """The work on one picture: read, detect, write.

    camera: the one that its picture has to be of, where it is known. device: where the tensors
    are while the road is looked for; steps of OpenCV fetch what they need.
    """

    detector: Detector
    kinds: frozenset[str]
    depth: Literal[8, 16]
    camera: Camera | None = None
    device: str = "cpu"

    @property
    def ends(self) -> list[str]:
        """How the names of its results end, ``{}`` standing for those of the cues."""
        tables = (SUFFIXES, CUE_SUFFIXES)
        return [table[kind] for table in tables for kind in table if kind in self.kinds]

    def __call__(self, job: Job) -> Row:
        """Write the results of one picture; the row for index.csv."""
        image = job.picture.read()
        if self.camera is not None:
            self.camera.check(image)
        detection = self.detector.to(self.device).detect(image.to(self.device))
        row = self.write(job.file, image, detection, job.output)
        return replace(row, cues="/".join(detection.cues))

    def write(
        self, file: str, image: Tensor, detection: Detection, output: Callable[[str], Path]
    ) -> Row:
        """Write the results of an image (3,H,W); the row for index.csv.

        file: as in index.csv. output: what a name ends with → the path.
        """
        kinds = self.kinds
        if kinds:
            make_folder(output("").parent, ELSEWHERE)
        if "likelihood" in kinds:
            write_map(output(SUFFIXES["likelihood"]), detection.likelihood, self.depth)
        if "mask" in kinds:
            write_mask(output(SUFFIXES["mask"]), detection.mask)
        if "overlay" in kinds:
            path, ego = output(SUFFIXES["overlay"]), detection.cues.get("ego")
            write_overlay(path, image, detection.mask, ego, detection.caption)
        if "npy" in kinds:
            write_npy(output(SUFFIXES["npy"]), detection.likelihood)
        for name, cue in detection.cues.items():
            if "cues" in kinds:
                picture = cue_picture(name, cue.cpu())
                write_colours(output(CUE_SUFFIXES["cues"].format(name)), picture)
            if "npy" in kinds:
                write_npy(output(CUE_SUFFIXES["npy"].format(name)), cue)
        if "polygons" in kinds:
            outline = labelme_document(detection.mask.cpu().numpy(), PurePath(file).name)
            write_json(output(SUFFIXES["polygons"]), outline)
        if "json" in kinds:
            write_json(output(SUFFIXES["json"]), self._facts(file, detection))
        return row_of(file, detection)

    def _facts(self, file: str, detection: Detection) -> dict[str, object]:
        """The figures of a picture alone; nothing in them depends on the run."""
        height, width = detection.mask.shape
        return {
            "file": file,
            "width": width,
            "height": height,
            "road_share": round(float(detection.mask.double().mean()), 6),
            "trust": None if detection.trust is None else round(detection.trust, 4),
            "doubt": detection.doubt,
            "threshold": self.detector.settings.threshold,
            "detector": self.detector.name,
            "roadtorch": __version__,
        }


def row_of(file: str, detection: Detection, share: float | None = None, doubt: str = "") -> Row:
    """The row for index.csv of what was written.

    share: of road, where it is not the mask's. doubt: another one than the detection's.
    """
    height, width = detection.mask.shape
    share = float(detection.mask.double().mean()) if share is None else share
    trust = "" if detection.trust is None else f"{detection.trust:.2f}"
    doubts = ", ".join(filter(None, (detection.doubt, doubt)))
    status = f"{DOUBTFUL}: {doubts}" if doubts else DONE
    return Row(file, str(width), str(height), "", f"{share:.4f}", trust, status)


def cue_picture(name: str, cue: Tensor) -> Tensor:
    """A cue (H,W), (C,H,W) or labels int (H,W) as an image (3,H,W) to look at.

    ``layout_labels`` and three potentials named ``layout…`` get the colours of sky, vertical
    and horizontal, other labels unlike colours where they are neighbours. Of the rest, three
    channels are red, green and blue, and of any other number the mean is shown; values are
    stretched from the least (black) to the greatest (white), those that are not finite black.
    """
    if name == "layout_labels":
        return layout_colours(cue)
    is_label = not cue.is_floating_point() and cue.dtype != torch.bool
    if cue.ndim == 2 and is_label:  # each channel a different irrational stride
        strides = torch.tensor([GOLDEN, GOLDEN**2, GOLDEN**3]).view(3, 1, 1)
        return ((cue.float() + 1) * strides).frac()
    if cue.ndim == 3 and len(cue) == 3 and name.startswith("layout"):  # a mixture of their colours
        colours = torch.tensor(LAYOUT_COLOURS) / 255
        return torch.einsum("chw,cd->dhw", cue.clamp(0, 1).float(), colours).clamp(0, 1)
    if cue.ndim == 3 and len(cue) != 3:
        cue = cue.float().mean(0)
    values = cue.float()
    is_finite = values.isfinite()
    low, high = values[is_finite].aminmax() if is_finite.any() else values.new_zeros(2)
    stretched = ((values - low) / (high - low).clamp_min(1e-12)).where(is_finite, 0)
    return stretched if cue.ndim == 3 else stretched.expand(3, -1, -1)


# --- label ------------------------------------------------------------------------------

LABEL_SUFFIXES = {"labels": ".png", "overlay": ".overlay.jpg"}
LAYOUT_SHARE = 0.5  # of the class's colour; the picture keeps the rest


@dataclass(frozen=True)
class Labelling:
    """The work on one picture: read, label, write."""

    settings: LabellerSettings
    overlay: bool

    @torch.no_grad()
    def __call__(self, job: Job) -> Row:
        """Write the labels of one picture; the row's road share is that of horizontal."""
        image = checked_image(job.picture.read())
        labels = label_layout(image, self.settings).labels
        make_folder(job.output("").parent, ELSEWHERE)
        write_labels(job.output(LABEL_SUFFIXES["labels"]), labels)
        if self.overlay:
            write_jpeg(job.output(LABEL_SUFFIXES["overlay"]), colour_layout(image, labels))
        height, width = labels.shape
        share = float((labels == HORIZONTAL).double().mean())
        return Row(job.file, str(width), str(height), road_share=f"{share:.4f}")


def colour_layout(image: Tensor, labels: Tensor) -> Tensor:
    """The image (3,H,W) tinted by class; unlabelled pixels are darkened to half."""
    return torch.lerp(image, layout_colours(labels), LAYOUT_SHARE)


# --- submit -----------------------------------------------------------------------------

ARCHIVE = "submission.zip"
MAP_SUFFIX = ".png"
READABLE_BY_ALL = 0o644 << 16  # where zip keeps the Unix permissions


def plan_maps(images: Path, calib: Path, out: Path) -> list[Job]:
    """The jobs for a folder of KITTI road pictures, their results named as the server wants.

    A picture whose calibration file in ``calib`` has changed is done anew.

    Raises what ``find_images`` and ``plan`` raise, and DatasetError for a picture that is not named
    CATEGORY_NUMBER.
    """
    jobs = plan(find_images([images], out), out, [MAP_SUFFIX])
    return [
        replace(
            job,
            picture=Picture(job.picture.path, result_name(job.picture.name)),
            beside=(calib / f"{job.picture.path.stem}.txt",),
        )
        for job in jobs
    ]


@dataclass(frozen=True)
class Submission:
    """The work on one picture, its calibration beside: detect, look from above, write."""

    detector: Detector

    def __call__(self, job: Job) -> Row:
        """Write the map of one picture: 8 bits, 800 rows, 400 columns, round(255 p)."""
        calibration = read_calibration(job.beside[0])
        detection = self.detector.detect(job.picture.read())
        write_map(job.output(MAP_SUFFIX), to_birds_eye(detection.likelihood, calibration))
        return replace(row_of(job.file, detection), trust="", status=DONE)


def pack(jobs: Sequence[Job], path: Path) -> None:
    """Write the maps of all jobs as a zip archive, files at its root; same maps, same bytes."""
    with atomic(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for job in jobs:
            output = job.output(MAP_SUFFIX)
            entry = zipfile.ZipInfo(output.name)  # dated 1980, not now
            entry.external_attr = READABLE_BY_ALL
            archive.writestr(entry, output.read_bytes())
