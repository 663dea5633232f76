"""Files of one image: likelihood, mask, overlay, cues, polygons, JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from roadtorch.base.atomic import write_json, write_text
from roadtorch.base.image import (
    MASK_ENDING,
    write_map,
    write_mask,
    write_npy,
    write_pixels,
    write_rgb,
)
from roadtorch.base.version import __version__
from roadtorch.data.polygons import coco_annotation
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import LAYOUT_COLOURS, colour_layout
from roadtorch.run.ledger import DOUBTFUL, IndexRow
from roadtorch.run.writers.coco import POLYGONS_SUFFIX, coco_text
from roadtorch.run.writers.grid import GRID_SUFFIXES, GridWriter

MAP_SUFFIXES = {
    "likelihood": ".likelihood.png",
    "mask": MASK_ENDING,
    "overlay": ".overlay.jpg",
    "npy": ".likelihood.npy",
    "polygons": POLYGONS_SUFFIX,
    "json": ".json",
}

CUE_SUFFIXES = {"cues": ".cue.{}.png", "npy": ".{}.npy"}
"""Suffixes of the kinds that write a file for each cue."""

GOLDEN_RATIO = 0.6180339887  # its multiples modulo 1 spread neighbouring labels over the colours


@dataclass(frozen=True)
class MapWriter:
    """A writer of the files of an image."""

    folder: Path
    kinds: frozenset[str]  # see ``MAP_SUFFIXES``, ``CUE_SUFFIXES`` and ``GRID_SUFFIXES``
    detector: str  # for the JSON, as is the threshold
    threshold: float
    depth: Literal[8, 16] = 8  # bits of likelihood maps
    grids: GridWriter | None = None

    @property
    def suffixes(self) -> Sequence[str]:
        """Suffixes of its files; ``{}`` stands for the name of a cue."""
        tables = (MAP_SUFFIXES, CUE_SUFFIXES)
        maps = [table[kind] for table in tables for kind in table if kind in self.kinds]
        return [*maps, *(end for kind in self.kinds for end in GRID_SUFFIXES.get(kind, ()))]

    def write(self, item: Item, detection: Detection) -> Mapping[str, str]:
        """Write the files; return the names of cues, for single images, and doubts of the grid.

        Raises:
            InputError: where a file cannot be written, or the grid lacks a pitch.
        """
        kinds, stem = self.kinds, self.folder / item.name

        def path(suffix: str) -> Path:
            return stem.with_name(stem.name + suffix)

        if "likelihood" in kinds:
            write_map(path(MAP_SUFFIXES["likelihood"]), detection.likelihood, self.depth)
        if "mask" in kinds:
            write_mask(path(MAP_SUFFIXES["mask"]), detection.mask)
        if "overlay" in kinds:
            write_pixels(path(MAP_SUFFIXES["overlay"]), detection.overlay())
        if "npy" in kinds:
            write_npy(path(MAP_SUFFIXES["npy"]), detection.likelihood)
        for name, cue in detection.cues.items() if kinds & CUE_SUFFIXES.keys() else ():
            if "cues" in kinds:
                write_rgb(path(CUE_SUFFIXES["cues"].format(name)), cue_image(name, cue.cpu()))
            if "npy" in kinds:
                write_npy(path(CUE_SUFFIXES["npy"].format(name)), cue)
        if "polygons" in kinds:
            mask = detection.mask.cpu().numpy()
            regions = [coco_annotation(mask, 1, 1, 1)] if mask.any() else []
            row = IndexRow(item.row_name, *map(str, reversed(mask.shape)))
            write_text(path(MAP_SUFFIXES["polygons"]), "".join(coco_text([row], lambda _: regions)))
        if "json" in kinds:
            write_json(path(MAP_SUFFIXES["json"]), self._figures(item.row_name, detection))
        columns = {} if item.digest is None else {"cues": "/".join(detection.cues)}
        doubt = self.grids.write(stem, kinds, item, detection) if self.grids else ""
        if doubt:
            columns["status"] = f"{DOUBTFUL}: {', '.join(filter(None, (detection.doubt, doubt)))}"
        return columns

    def _figures(self, file: str, detection: Detection) -> dict[str, object]:
        """Return the values for NAME.json, which depend on the image and the detector alone."""
        height, width = detection.mask.shape
        return {
            "file": file,
            "width": width,
            "height": height,
            "road_fraction": round(float(detection.mask.double().mean()), 6),
            "trust": None if detection.trust is None else round(detection.trust, 4),
            "doubt": detection.doubt,
            "threshold": self.threshold,
            "detector": self.detector,
            "roadtorch": __version__,
        }


def cue_image(name: str, cue: Tensor) -> Tensor:
    """Draw a cue, float (H, W) or (C, H, W) or integer labels (H, W), as an image (3, H, W).

    ``layout_labels`` and three-channel cues named ``layout…`` get the class colours; other labels
    get different colours for neighbouring numbers. Of other cues, three channels become red, green
    and blue, any other number is averaged; values are stretched to [0, 1], NaN and inf black.
    """
    if name == "layout_labels":
        return colour_layout(cue)
    is_label = not cue.is_floating_point() and cue.dtype != torch.bool
    if cue.ndim == 2 and is_label:  # each channel a different irrational stride
        strides = torch.tensor([GOLDEN_RATIO, GOLDEN_RATIO**2, GOLDEN_RATIO**3]).view(3, 1, 1)
        return ((cue.float() + 1) * strides).frac()
    if cue.ndim == 3 and len(cue) == 3 and name.startswith("layout"):  # mix the class colours
        colours = torch.tensor(LAYOUT_COLOURS) / 255
        return torch.einsum("chw,cd->dhw", cue.clamp(0, 1).float(), colours).clamp(0, 1)
    if cue.ndim == 3 and len(cue) != 3:
        cue = cue.float().mean(0)
    values = cue.float()
    is_finite = values.isfinite()
    low, high = values[is_finite].aminmax() if is_finite.any() else values.new_zeros(2)
    stretched = ((values - low) / (high - low).clamp_min(1e-12)).where(is_finite, 0)
    return stretched if cue.ndim == 3 else stretched.expand(3, -1, -1)
