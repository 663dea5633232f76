"""The machine's views of pictures, made once: in memory for a few, on disk for all."""

import hashlib
import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from scipy import sparse

from roadtorch.annotate.machine import AnnotationSettings, PictureView, look_at_picture
from roadtorch.detector import Detector
from roadtorch.io.atomic import atomic, make_folder
from roadtorch.io.image import read_image
from roadtorch.superpixels.segments import segment_mean, segment_size

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

    def last_view(self, name: str) -> PictureView | None:
        """What was seen last of a picture that is gone, if it is still in memory."""
        held = self._held.get(name)
        return held[1] if held else None

    def trust(self, name: str, picture: Path) -> float | None:
        """The trust of a view that is on disk; NaN where a look gave none, None without a look."""
        try:
            with np.load(view_path(self.folder, name), allow_pickle=False) as found:
                return float(found["trust"]) if str(found["key"]) == self._key(picture) else None
        except (OSError, ValueError, KeyError):
            return None

    def _key(self, picture: Path) -> str:
        detector, found = self.detector, picture.stat()
        said = f"{detector.name} {detector.settings!r} {self.settings!r}"
        text = f"{said} {found.st_size} {found.st_mtime_ns}"
        return hashlib.sha256(text.encode()).hexdigest()[:32]


def view_path(folder: Path, name: str) -> Path:
    """The file of a picture's view in the folder of all views."""
    return folder / f"{name}.npz"


def write_view(path: Path, view: PictureView, key: str) -> None:
    """Keep a view on disk under the key of what it was made of."""
    make_folder(path.parent)
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            key=key,
            size=np.array(view.size),
            odds=view.odds.numpy().astype(np.float16),
            labels=view.labels.numpy().astype(np.int32),
            layout=view.layout.numpy().astype(np.float16),
            trust=np.nan if view.trust is None else view.trust,
            data=view.graph.data.astype(np.float32),
            indices=view.graph.indices,
            indptr=view.graph.indptr,
        )


def read_view(path: Path, key: str | None = None) -> PictureView | None:
    """The view that was kept, under this key if one is given; None where there is none."""
    try:
        with np.load(path, allow_pickle=False) as found:
            if key is not None and str(found["key"]) != key:
                return None
            count = len(found["indptr"]) - 1
            parts = (found["data"].astype(np.float64), found["indices"], found["indptr"])
            odds = torch.from_numpy(found["odds"].astype(np.float32))
            labels = torch.from_numpy(found["labels"].astype(np.int64))
            height, width = found["size"].tolist()
            trust = float(found["trust"])
            layout = torch.from_numpy(found["layout"].astype(np.float32))
    except (OSError, ValueError, KeyError):
        return None
    mean = segment_mean(odds[None], labels, segment_size(labels, count))[0]
    graph = sparse.csr_matrix(parts, shape=(count, count))
    known = None if np.isnan(trust) else trust
    return PictureView((height, width), odds, labels, mean, graph, layout, known)
