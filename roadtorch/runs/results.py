"""What ``infer`` writes for one picture, and for a folder of them."""

from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from time import perf_counter
from typing import Literal

import torch
from torch import Tensor

from roadtorch.camera.camera import Camera
from roadtorch.data.maps import CONFIG, MASK
from roadtorch.detector import Detection, Detector
from roadtorch.errors import ConfigError, InputError
from roadtorch.io.atomic import digest_of, make_folder, write_json, write_text
from roadtorch.io.bounded import printable, read_regular
from roadtorch.io.image import (
    read_image,
    write_colours,
    write_map,
    write_mask,
    write_npy,
    write_overlay,
)
from roadtorch.layout.classes import LAYOUT_COLOURS, layout_colours
from roadtorch.layout.weights import tensors_hash
from roadtorch.runs.batch import Job, Method, method_of
from roadtorch.runs.claim import ELSEWHERE
from roadtorch.runs.index import DONE, DOUBTFUL, INDEX, Row
from roadtorch.sinks.polygons import labelme_document
from roadtorch.version import __version__

SUFFIXES = {
    "likelihood": ".likelihood.png",
    "mask": MASK,
    "overlay": ".overlay.jpg",
    "npy": ".likelihood.npy",
    "polygons": ".labelme.json",
    "json": ".json",
}

CUE_SUFFIXES = {"cues": ".cue.{}.png", "npy": ".{}.npy"}
"""Of the kinds that write a file a cue."""

GOLDEN = 0.6180339887  # the fractional step that spreads neighbouring labels over the colours


def suffixes(kinds: Iterable[str]) -> dict[str, str]:
    """How the files of each kind end; the cues' names are known only after detection."""
    return {kind: SUFFIXES[kind] for kind in kinds if kind in SUFFIXES}


def cue_suffixes(kinds: Iterable[str]) -> list[str]:
    """How the files of the cues end, of all kinds that have them."""
    return [CUE_SUFFIXES[kind] for kind in kinds if kind in CUE_SUFFIXES]


def keep_config(out: Path, effective: str, overwrite: bool) -> None:
    """Write the settings beside the results; ConfigError if earlier ones were different.

    Otherwise a second run with another detector would skip what the first one did, and
    the folder would mix the results of both.
    """
    path = out / CONFIG
    effective += "\n"
    is_other = path.exists() and _bytes_of(path) != printable(effective).encode()
    if is_other and (out / INDEX).exists() and not overwrite:
        raise ConfigError(
            out,
            f"holds results of other settings ({CONFIG})",
            "give another --out, or --overwrite",
        )
    write_text(path, effective)


def _bytes_of(config: Path) -> bytes:
    try:
        return read_regular(config)
    except OSError as problem:
        raise InputError(config, f"cannot be read: {problem.strerror}", ELSEWHERE) from None


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

    def __call__(self, job: Job) -> Row:
        """Write the results of one picture; the row for index.csv."""
        start = perf_counter()
        image = read_image(job.picture.path)
        if self.camera is not None:
            self.camera.check(image)
        detection = self.detector.to(self.device).detect(image.to(self.device))
        make_folder(job.output("").parent, ELSEWHERE)
        write_files(job.output, self.kinds, self.depth, image, detection)
        write_documents(job.output, self.kinds, job.file, detection, self.detector)
        row = row_of(job.file, detection, 1000 * (perf_counter() - start))
        return replace(row, cues="/".join(detection.cues))


def row_of(file: str, detection: Detection, ms: float) -> Row:
    """The row for index.csv of what was written; ms: what it took."""
    height, width = detection.mask.shape
    share = float(detection.mask.to(torch.float64).mean())
    trust = "" if detection.trust is None else f"{detection.trust:.2f}"
    status = f"{DOUBTFUL}: {detection.doubt}" if detection.doubt else DONE
    return Row(file, str(width), str(height), f"{ms:.0f}", f"{share:.4f}", trust, status)


def write_files(
    output: Callable[[str], Path],
    kinds: Container[str],
    depth: Literal[8, 16],
    image: Tensor,
    detection: Detection,
) -> None:
    """Write the results of an image (3,H,W) as files; output: what a name ends with → the path."""
    if "likelihood" in kinds:
        write_map(output(SUFFIXES["likelihood"]), detection.likelihood, depth)
    if "mask" in kinds:
        write_mask(output(SUFFIXES["mask"]), detection.mask)
    if "overlay" in kinds:
        path, ego = output(SUFFIXES["overlay"]), detection.cues.get("ego")
        write_overlay(path, image, detection.mask, ego, detection.caption)
    if "npy" in kinds:
        write_npy(output(SUFFIXES["npy"]), detection.likelihood)
    for name, cue in detection.cues.items():
        if "cues" in kinds:
            write_colours(output(CUE_SUFFIXES["cues"].format(name)), cue_picture(name, cue.cpu()))
        if "npy" in kinds:
            write_npy(output(CUE_SUFFIXES["npy"].format(name)), cue)


def write_documents(
    output: Callable[[str], Path],
    kinds: Container[str],
    file: str,
    detection: Detection,
    detector: Detector,
) -> None:
    """Write what is said of a picture in JSON: its outline, its figures. file: as in index.csv."""
    if "polygons" in kinds:
        outline = labelme_document(detection.mask.cpu().numpy(), PurePath(file).name)
        write_json(output(SUFFIXES["polygons"]), outline)
    if "json" in kinds:
        write_json(output(SUFFIXES["json"]), facts(file, detection, detector))


def facts(file: str, detection: Detection, detector: Detector) -> dict[str, object]:
    """What is known about one picture in numbers; nothing in it depends on the run.

    road_share: of the mask, in [0,1]. trust: the expected F, None where the detector does not say.
    """
    height, width = detection.mask.shape
    return {
        "file": file,
        "width": width,
        "height": height,
        "road_share": round(float(detection.mask.to(torch.float64).mean()), 6),
        "trust": None if detection.trust is None else round(detection.trust, 4),
        "doubt": detection.doubt,
        "threshold": detector.settings.threshold,
        "detector": detector.name,
        "roadtorch": __version__,
    }


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
    if cue.ndim == 2:
        return _label_colours(cue) if is_label else _stretched(cue).expand(3, -1, -1)
    if len(cue) != 3:
        return _stretched(cue.float().mean(0)).expand(3, -1, -1)
    return _potential_colours(cue) if name.startswith("layout") else _stretched(cue)


def _stretched(values: Tensor) -> Tensor:
    """Values of any shape over [0,1], black where they are not finite."""
    values = values.float()
    is_finite = values.isfinite()
    low, high = values[is_finite].aminmax() if is_finite.any() else values.new_zeros(2)
    return ((values - low) / (high - low).clamp_min(1e-12)).where(is_finite, 0)


def _potential_colours(potentials: Tensor) -> Tensor:
    """Potentials (3,H,W) of sky, vertical and horizontal as a mixture of their colours."""
    colours = torch.tensor(LAYOUT_COLOURS) / 255
    return torch.einsum("chw,cd->dhw", potentials.clamp(0, 1).float(), colours).clamp(0, 1)


def _label_colours(labels: Tensor) -> Tensor:
    """Labels int (H,W) as colours (3,H,W): each channel a different irrational stride."""
    strides = torch.tensor([GOLDEN, GOLDEN**2, GOLDEN**3]).view(3, 1, 1)
    return ((labels.float() + 1) * strides).frac()
