"""The machine's views of pictures, made once: in memory for a few, on disk for all."""

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from scipy import sparse

from roadtorch.annotate.machine import AnnotationSettings, PictureView, look_at_picture
from roadtorch.base.image import read_image
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.segments import segment_mean, segment_size
from roadtorch.run.memo import keep, kept, key_of

VIEWS = ".machine"
"""The folder of views in the folder of corrections."""

HELD = 12  # views in memory; each has some megabytes


@dataclass
class ViewStore:
    """Views by the name of the picture, kept in ``folder`` while picture and settings are the same.

    detector: the one that looks.
    """

    folder: Path
    detector: Detector
    settings: AnnotationSettings
    _held: OrderedDict[str, tuple[str, PictureView]] = field(
        default_factory=OrderedDict, repr=False
    )
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)
    _looking: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def view(self, name: str, picture: Path) -> PictureView:
        """The view of a picture, looked at now if it has to be; InputError if it cannot be."""
        key = self._key(picture)
        with self._lock:
            held = self._held.get(name)
        if held is None or held[0] != key:
            with self._looking:  # one at a time: a look takes all cores
                view = read_view(path := view_path(self.folder, name), key)
                if view is None:
                    view = look_at_picture(read_image(picture), self.detector, self.settings)
                    write_view(path, view, key)
                held = key, view
        with self._lock:
            self._held[name] = held
            self._held.move_to_end(name)
            while len(self._held) > HELD:
                self._held.popitem(last=False)
        return held[1]

    def _key(self, picture: Path) -> str:
        return key_of(self._detector_key, self.settings, picture)

    @cached_property
    def _detector_key(self) -> str:
        """Of the detector alone, which takes a while."""
        return key_of(self.detector)


def view_path(folder: Path, name: str) -> Path:
    """The file of a picture's view in the folder of all views."""
    return folder / f"{name}.npz"


def write_view(path: Path, view: PictureView, key: str) -> None:
    """Keep a view on disk under the key of what it was made of."""
    arrays = {
        "size": torch.tensor(view.size),
        "odds": view.odds.to(torch.float16),
        "labels": view.labels.to(torch.int32),
        "layout": view.layout.to(torch.float16),
        "trust": torch.tensor(np.nan if view.trust is None else view.trust, dtype=torch.float64),
        "data": torch.from_numpy(view.graph.data.astype(np.float32)),
        "indices": torch.from_numpy(view.graph.indices),
        "indptr": torch.from_numpy(view.graph.indptr),
    }
    keep(path, key, arrays)


def read_view(path: Path, key: str | None = None) -> PictureView | None:
    """The view that was kept, under this key if one is given; None where there is none."""
    arrays = kept(path, key)
    if arrays is None:
        return None
    count = len(arrays["indptr"]) - 1
    parts = (arrays["data"].double().numpy(), arrays["indices"].numpy(), arrays["indptr"].numpy())
    odds, labels = arrays["odds"].to(torch.float32), arrays["labels"].to(torch.int64)
    height, width = arrays["size"].tolist()
    trust, layout = float(arrays["trust"]), arrays["layout"].to(torch.float32)
    mean = segment_mean(odds[None], labels, segment_size(labels, count))[0]
    graph = sparse.csr_matrix(parts, shape=(count, count))
    known = None if np.isnan(trust) else trust
    return PictureView((height, width), odds, labels, mean, graph, layout, known)
