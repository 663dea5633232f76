"""Detections: the result for one image, which can be shown, saved and converted."""

import importlib
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from PIL import Image, ImageShow
from torch import Tensor

from roadtorch.base.atomic import atomic_write
from roadtorch.base.compute import one_torch_thread
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import (
    jpeg_bytes,
    overlay_pixels,
    shrink_pixels,
    write_map,
    write_mask,
    write_pixels,
)
from roadtorch.imaging.resize import resize_to_image

NOTEBOOK_SIDE, NOTEBOOK_QUALITY = 960, 85  # ours: pixels of a page's width; of JPEG


@dataclass(frozen=True, eq=False)
class Cues(Mapping[str, Tensor]):
    """Cues of an image, stored at the size of the analysis and enlarged when they are accessed.

    maps: by name, (h, w) or (C, h, w). size: height and width of the image.
    """

    maps: Mapping[str, Tensor]
    size: tuple[int, int]

    @one_torch_thread()
    def __getitem__(self, name: str) -> Tensor:
        """Return the cue of that name at the size of the image."""
        return resize_to_image(self.maps[name], self.size)

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the cues."""
        return iter(self.maps)

    def __len__(self) -> int:
        """Return the number of cues."""
        return len(self.maps)

    def __repr__(self) -> str:
        """Return a line for each cue: name, shape, range."""
        parts = [f"{name} {_describe_map(map)}" for name, map in self.maps.items()]
        height, width = self.size
        return "\n".join([f"<Cues {width}×{height}, stored as", *parts]) + ">"

    __eq__ = object.__eq__  # two tensors have no one truth value
    __hash__ = object.__hash__  # type: ignore[assignment]  # a Mapping has none


def _describe_map(map: Tensor) -> str:
    """Return shape, type and range of a map."""
    low, high = (float(end) for end in map.float().aminmax())
    return f"{tuple(map.shape)} {str(map.dtype).removeprefix('torch.')} {low:.3g} to {high:.3g}"


@dataclass(frozen=True, eq=False)
class Detection:
    """Result of a detector for one image; the maps are torch tensors.

    Attributes:
        likelihood: road likelihood, float32 in [0, 1], shape (H, W).
        mask: road mask, bool, shape (H, W).
        cues: maps that the mask is based on, by name, shape (H, W) or (C, H, W).
        trust: predicted F-score of the mask in [0, 1]; None: the detector does not predict it.
        doubt: reason to check the mask before it is used; empty where there is none.
        name: of the frame, if it comes from a source.
        seconds: time of the frame since its source began.
        image: the image in [0, 1], shape (3, H, W); None for a Detection made without one.

    >>> from roadtorch import load_detector
    >>> detection = load_detector("prior:rows")("street.jpg")
    >>> detection
    <Detection 320×240, road 50%>
    >>> detection.mask.numpy().shape  # of one map; numpy() converts all
    (240, 320)
    >>> sorted(detection.numpy())
    ['likelihood', 'mask']
    >>> detection.save("street.mask.png")
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
        """Caption of the overlay: the trust; empty where there is none."""
        return "" if self.trust is None else f"trust {self.trust:.2f}"

    def numpy(self) -> dict[str, np.ndarray]:
        """Return all maps as NumPy arrays by name: ``likelihood``, ``mask`` and the cues."""
        maps = {"likelihood": self.likelihood, "mask": self.mask, **self.cues}
        return {name: map.detach().cpu().numpy() for name, map in maps.items()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a file; the end of its name determines what is written.

        Args:
            path: ends in ``mask.png`` (road 255, else 0), ``likelihood.png`` (0 to 255),
                ``overlay.jpg``, ``overlay.png``, or ``.npz`` (arrays of ``numpy`` and the trust).

        Raises:
            ConfigError: The name has another end.
            InputError: The file cannot be written.
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
            with atomic_write(path) as temporary, temporary.open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **self.numpy(), **trust)
        else:
            hint = "end it with .mask.png, .likelihood.png, .overlay.jpg or .npz"
            raise ConfigError(path, "has no known ending", hint)

    def show(self) -> None:
        """Show the overlay in the notebook or the system's image viewer.

        Raises:
            InputError: There is neither.
        """
        if "ipykernel" in sys.modules:
            importlib.import_module("IPython.display").display(self)
        elif not ImageShow.show(Image.fromarray(self.overlay())):
            raise InputError("show()", "finds no display", "use save(), or a notebook")

    def overlay(self) -> np.ndarray:
        """Return the image with its road tinted and outlined, as RGB uint8, shape (H, W, 3).

        Raises:
            InputError: The detection has no image.
        """
        if self.image is None:
            raise InputError("image", "is not part of this detection", "give Detection(image=…)")
        return overlay_pixels(self.image, self.mask, self.cues.get("ego"), self.caption)

    # --- conversion for other packages ------------------------------------------------------

    def polygons(self) -> list[list[np.ndarray]]:
        """Return the road regions as polygons: of each its border, then those of its holes.

        Borders have shape (N, 2), int, as (x, y). They pass through the centres of the outermost
        pixels of a region, or of the road around a hole: ``shapely.Polygon(rings[0], rings[1:])``,
        if rings have at least four corners.
        """
        pixels = self.mask.cpu().numpy().astype(np.uint8)
        borders, tree = cv2.findContours(pixels, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        parents = tree[0, :, 3].tolist() if len(borders) else []  # of a hole: its region; or -1
        rings = [border.reshape(-1, 2) for border in borders]
        regions = {n: [ring] for n, ring in enumerate(rings) if parents[n] < 0}
        for ring, region in zip(rings, parents, strict=True):
            if region >= 0:
                regions[region].append(ring)
        return list(regions.values())

    def __repr__(self) -> str:
        """Return one line: size, fraction of road, trust and doubt."""
        height, width = self.mask.shape
        parts = [f"{width}×{height}", f"road {float(self.mask.double().mean()):.0%}", self.caption]
        doubt = f" ({self.doubt})" if self.doubt else ""
        return f"<Detection {', '.join(filter(None, parts))}{doubt}>"

    def _repr_jpeg_(self) -> bytes | None:
        """Return the overlay as JPEG for notebooks."""
        if self.image is None:
            return None
        return jpeg_bytes(shrink_pixels(self.overlay(), NOTEBOOK_SIDE), NOTEBOOK_QUALITY)
