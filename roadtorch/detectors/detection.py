"""What a detector says about one image: shown, saved, handed on as arrays."""

import importlib
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from PIL import Image, ImageShow
from torch import Tensor

from roadtorch.base.atomic import atomic
from roadtorch.base.compute import one_thread
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import overlay_pixels, png_bytes, write_map, write_mask, write_pixels
from roadtorch.imaging.resize import at_image_size

NOTEBOOK_SIDE = 960  # pixels of the longer side of what notebooks show; ours: the width of a page


@dataclass(frozen=True, eq=False)
class Cues(Mapping[str, Tensor]):
    """The cues of an image, kept at the size at which they were found, enlarged when asked for.

    maps: by name, (h,w) or (C,h,w). size: rows and columns of the image.
    """

    maps: Mapping[str, Tensor]
    size: tuple[int, int]

    @one_thread()
    def __getitem__(self, name: str) -> Tensor:
        """The cue of that name at the size of the image; KeyError where there is none."""
        return at_image_size(self.maps[name], self.size)

    def __iter__(self) -> Iterator[str]:
        """The names of all cues."""
        return iter(self.maps)

    def __len__(self) -> int:
        """How many cues there are."""
        return len(self.maps)


@dataclass(frozen=True)
class Detection:
    """What a detector says about one image.

    likelihood: float32 (H,W) in [0,1], higher is more road-like.
    mask: bool (H,W), the decision.
    cues: the maps the decision rests on, by name; (H,W) or (C,H,W).
    trust: the expected F of the mask, in [0,1]; None where the detector does not say.
    doubt: why the mask should be looked at before it is used, in words; empty where it need not.
    name, seconds: of the frame, where a source gave it: its name, the time since the source began.
    image: (3,H,W) in [0,1], what was looked at; None where a Detection is made without one.

        >>> from roadtorch import load_detector
        >>> detection = load_detector("prior:rows")("street.jpg")
        >>> detection
        <Detection 320×240, road 50%>
        >>> detection.save("street.mask.png")
        >>> sorted(detection.numpy())
        ['likelihood', 'mask']
    """

    likelihood: Tensor
    mask: Tensor
    cues: Mapping[str, Tensor]
    trust: float | None = None
    doubt: str = ""
    name: str = ""
    seconds: float | None = None
    image: Tensor | None = None

    @property
    def caption(self) -> str:
        """What an overlay says of it; nothing where the detector does not judge itself."""
        return "" if self.trust is None else f"trust {self.trust:.2f}"

    def numpy(self) -> dict[str, np.ndarray]:
        """The maps as arrays by name: ``likelihood``, ``mask`` and the cues."""
        maps = {"likelihood": self.likelihood, "mask": self.mask, **self.cues}
        return {name: map.detach().cpu().numpy() for name, map in maps.items()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write what the end of the file's name says.

        ``….mask.png`` (road 255, the rest 0), ``….likelihood.png`` (0 to 255), ``….overlay.jpg`` or
        ``….overlay.png``, or ``….npz`` with the arrays of ``numpy`` and the trust. Raises
        ConfigError for another end, and InputError where the file cannot be written.
        """
        name = os.fspath(path)
        if name.endswith("mask.png"):
            write_mask(path, self.mask)
        elif name.endswith("likelihood.png"):
            write_map(path, self.likelihood)
        elif name.endswith(("overlay.jpg", "overlay.png")):
            write_pixels(path, self.overlay())
        elif name.endswith(".npz"):
            trust = {} if self.trust is None else {"trust": np.float32(self.trust)}
            with atomic(path) as temporary, temporary.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **self.numpy(), **trust)
        else:
            hint = "end it with .mask.png, .likelihood.png, .overlay.jpg or .npz"
            raise ConfigError(path, "does not say what to write", hint)

    def show(self) -> None:
        """Show the overlay: in the notebook, or else in the computer's viewer of images.

        Raises InputError where there is neither.
        """
        if "ipykernel" in sys.modules:
            importlib.import_module("IPython.display").display(self)
        elif not ImageShow.show(Image.fromarray(self.overlay())):
            raise InputError("show()", "finds no display", "use save(), or a notebook")

    def overlay(self) -> np.ndarray:
        """The image with its road tinted and outlined, uint8 (H,W,3) RGB, as ``infer`` draws it.

        Raises InputError where there is no image.
        """
        if self.image is None:
            raise InputError("image", "is not part of this detection", "give Detection(image=…)")
        return overlay_pixels(self.image, self.mask, self.cues.get("ego"), self.caption)

    # --- in the forms of other packages -----------------------------------------------------

    def polygons(self) -> list[list[np.ndarray]]:
        """The regions of road: of each its border and those of its holes, int (N,2) as (x, y).

        Borders go through the centres of a region's outermost pixels, those of holes through the
        road around them: ``shapely.Polygon(rings[0], rings[1:])`` where rings have four corners.
        """
        pixels = self.mask.cpu().numpy().astype(np.uint8)
        borders, tree = cv2.findContours(pixels, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        outside = tree[0, :, 3].tolist() if len(borders) else []  # of a hole: its region; or -1
        rings = [border.reshape(-1, 2) for border in borders]
        regions = {n: [ring] for n, ring in enumerate(rings) if outside[n] < 0}
        for ring, region in zip(rings, outside, strict=True):
            if region >= 0:
                regions[region].append(ring)
        return list(regions.values())

    def to_supervision(self) -> Any:
        """``supervision.Detections``: the road as one object, none where there is none.

        Its confidence is the trust. Raises ConfigError where supervision is not installed.
        """
        supervision = _package("supervision")
        mask = self.mask.cpu().numpy()
        if not mask.any():
            return supervision.Detections.empty()
        rows, columns = (np.flatnonzero(mask.any(axis)) for axis in (1, 0))
        trust = None if self.trust is None else np.array([self.trust], np.float32)
        return supervision.Detections(
            xyxy=np.array([[columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]], np.float32),
            mask=mask[None],
            confidence=trust,
            class_id=np.array([0]),
            data={"class_name": np.array(["road"])},
        )

    def __repr__(self) -> str:
        """One line: size, share of road, and how far it can be trusted."""
        height, width = self.mask.shape
        parts = [f"{width}×{height}", f"road {float(self.mask.double().mean()):.0%}", self.caption]
        doubt = f" ({self.doubt})" if self.doubt else ""
        return f"<Detection {', '.join(filter(None, parts))}{doubt}>"

    def _repr_png_(self) -> bytes | None:
        """What notebooks show."""
        return None if self.image is None else png_bytes(self.overlay(), NOTEBOOK_SIDE)


def to_pandas(detections: Iterable[Detection]) -> Any:
    """A ``pandas.DataFrame`` with a row for each detection, in their order.

    Columns: name, seconds, width, height, road_share (0 to 1), trust, doubt. Raises ConfigError
    where pandas is not installed. ``index.csv`` of ``infer`` has the same of a folder.
    """
    rows = [
        {
            "name": detection.name,
            "seconds": detection.seconds,
            "width": detection.mask.shape[1],
            "height": detection.mask.shape[0],
            "road_share": float(detection.mask.double().mean()),
            "trust": detection.trust,
            "doubt": detection.doubt,
        }
        for detection in detections
    ]
    return _package("pandas").DataFrame(rows)


def _package(name: str) -> Any:
    """A package that roadtorch does not need itself; ConfigError where it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ConfigError(name, "is not installed", f"pip install {name}") from None
