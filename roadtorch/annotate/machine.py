"""What the machine says about one image before anybody corrects it, and after."""

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from pydantic import Field
from scipy import sparse
from torch import Tensor

from roadtorch.annotate.propagation import (
    Graph,
    PropagationSettings,
    propagated,
    segment_graph,
)
from roadtorch.base.image import read_image
from roadtorch.base.image_cache import image_cache
from roadtorch.base.settings import Settings
from roadtorch.data.events import (
    NOT_ROAD,
    OPEN,
    ROAD_SAID,
    VOID_SAID,
    layout_layer,
    road_layer,
)
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.resize import WorkingSize, at_image_size, resized, size_of, working_size
from roadtorch.imaging.segments import measure_segments, segment_mean, segment_size
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import CLASSES, UNLABELLED
from roadtorch.road.fusion import log_odds
from roadtorch.run.memo import keep, kept, key_of

BARELY = 0.05
"""Log odds of what the threshold says road and the mask leaves out, so that it stays out."""

VIEWS = ".machine"
"""The folder of views in the folder of corrections."""

HELD = 12  # views in memory; each has some megabytes


class AnnotationSettings(Settings):
    """What the page works with: an image's working size, its superpixels, and the inference."""

    working: WorkingSize = WorkingSize(pixels=640 * 480)
    superpixels: Superpixels = Superpixels(pixels=64)
    propagation: PropagationSettings = PropagationSettings()
    spoken: float = Field(
        default=0.5, gt=0, le=1, description="share of a superpixel said before it counts as said"
    )


@dataclass(frozen=True, eq=False)
class ImageView:
    """One image as the machine sees it, at the page's working size (h,w).

    size: (H,W) of the image. odds: float32 (h,w), log odds of road, 0 at the threshold. labels:
    int64 (h,w), the superpixels. segment_odds: (n,). graph: of the n superpixels. layout: (n,3),
    log odds of the classes, (n,0) where the machine has none. trust: the expected F, if known.
    """

    size: tuple[int, int]
    odds: Tensor
    labels: Tensor
    segment_odds: Tensor
    graph: Graph
    layout: Tensor
    trust: float | None

    @property
    def shape(self) -> tuple[int, int]:
        """(h,w) of the page's working size."""
        return self.labels.shape[0], self.labels.shape[1]


def look_at_image(image: Tensor, detector: Detector, settings: AnnotationSettings) -> ImageView:
    """What a detector sees in an image (3,H,W), and the superpixels that a person clicks."""
    size = size_of(image)
    with image_cache():
        detection = detector.detect(image)
        small = resized(image, working_size(*size, settings.working)).clamp(0, 1)
        shape = size_of(small)
        labels = settings.superpixels.cut(small)
        segments = measure_segments(small, labels)
    threshold = torch.tensor(detector.settings.threshold)
    odds = log_odds(resized(detection.likelihood, shape)) - log_odds(threshold)
    left_out = (odds >= 0) & ~at_image_size(detection.mask, shape)
    odds = torch.where(left_out, -BARELY, odds)  # positive where the mask is road
    layout = torch.zeros(len(segments.size), 0)
    if (potentials := detection.cues.get("layout")) is not None and len(potentials) == CLASSES:
        mean = segment_mean(resized(potentials, shape), labels, segments.pixels)
        layout = log_odds(mean.T)
    mean = segment_mean(odds[None], labels, segments.pixels)[0]
    graph = segment_graph(segments, settings.propagation)
    return ImageView(size, odds, labels, mean, graph, layout, detection.trust)


def mended_odds(view: ImageView, said: Tensor, settings: PropagationSettings) -> Tensor:
    """Log odds (h,w) of road after the rest was inferred from what was said.

    said: (n,), 1 road, -1 not road, 0 nothing, for each superpixel.
    """
    moved = propagated(view.segment_odds, said, view.graph, settings)
    return view.odds + moved[view.labels]


def mended_layout(view: ImageView, labels: np.ndarray, settings: AnnotationSettings) -> np.ndarray:
    """The layout uint8 (h,w), 255 where the machine has none, inferred from labels (H,W)."""
    if not view.layout.shape[1]:
        return np.full(view.labels.shape, UNLABELLED, np.uint8)
    layer = layout_layer(at_size(labels, view.shape))
    odds = []
    for number, own in enumerate(view.layout.unbind(1)):
        said = _said(layer == number, (layer != number) & (layer != UNLABELLED), view, settings)
        odds.append(own + propagated(own, said, view.graph, settings.propagation))
    return torch.stack(odds).argmax(0)[view.labels].numpy().astype(np.uint8)


def said_of_segments(labels: np.ndarray, view: ImageView, settings: AnnotationSettings) -> Tensor:
    """What people's labels uint8 (H,W) say of each superpixel: (n,), 1 road, -1 not, 0 nothing."""
    road = road_layer(at_size(labels, view.shape))
    return _said(road == ROAD_SAID, road == NOT_ROAD, view, settings)


def _said(yes: np.ndarray, no: np.ndarray, view: ImageView, settings: AnnotationSettings) -> Tensor:
    """(n,): 1 or -1 where enough of a superpixel is in the masks (h,w), by which has more."""
    index, count = view.labels.reshape(-1).numpy(), len(view.segment_odds)
    size = np.bincount(index, minlength=count)
    in_favour, against = (
        np.bincount(index[mask.reshape(-1)], minlength=count) for mask in (yes, no)
    )
    known = in_favour + against >= settings.spoken * size
    return torch.from_numpy(np.where(known, np.where(in_favour >= against, 1.0, -1.0), 0.0))


def at_size(labels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Labels (H,W) at another size, pixel by pixel."""
    return at_image_size(torch.from_numpy(labels), size).numpy()


def shown_road(odds: Tensor, labels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Road bool (H,W) at a size: what people said, and the odds where they said nothing."""
    said = road_layer(at_size(labels, size))
    road = resized(odds, size).numpy() >= 0
    return np.where((said == OPEN) | (said == VOID_SAID), road & (said != VOID_SAID), said == 1)


# --- views on disk ----------------------------------------------------------------------


@dataclass
class ViewStore:
    """Views by the name of the image, kept in ``folder`` while image and settings are the same.

    detector: the one that looks.
    """

    folder: Path
    detector: Detector
    settings: AnnotationSettings
    _held: OrderedDict[str, tuple[str, ImageView]] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)
    _looking: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def view(self, name: str, image: Path) -> ImageView:
        """The view of an image, looked at now if it has to be; InputError if it cannot be."""
        key = self._key(image)
        with self._lock:
            held = self._held.get(name)
        if held is None or held[0] != key:
            with self._looking:  # one at a time: a look takes all cores
                view = read_view(path := view_path(self.folder, name), key)
                if view is None:
                    view = look_at_image(read_image(image), self.detector, self.settings)
                    write_view(path, view, key)
                held = key, view
        with self._lock:
            self._held[name] = held
            self._held.move_to_end(name)
            while len(self._held) > HELD:
                self._held.popitem(last=False)
        return held[1]

    def _key(self, image: Path) -> str:
        return key_of(self._detector_key, self.settings, image)

    @cached_property
    def _detector_key(self) -> str:
        """Of the detector alone, which takes a while."""
        return key_of(self.detector)


def view_path(folder: Path, name: str) -> Path:
    """The file of an image's view in the folder of all views."""
    return folder / f"{name}.npz"


def write_view(path: Path, view: ImageView, key: str) -> None:
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


def read_view(path: Path, key: str | None = None) -> ImageView | None:
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
    return ImageView((height, width), odds, labels, mean, graph, layout, known)
