"""The detector's view of one image, and its road and layout after corrections."""

import threading
from collections import OrderedDict
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from scipy import sparse
from torch import Tensor

from roadtorch.annotate.propagation import SegmentGraph, propagate, segment_graph
from roadtorch.base.image import read_image
from roadtorch.base.image_cache import image_cache
from roadtorch.data.events import (
    NO_ROAD_LABEL,
    NOT_ROAD,
    ROAD_LABEL,
    layout_layer,
    road_layer,
)
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.resize import (
    WorkingSize,
    resize_maps,
    resize_to_image,
    resize_to_work,
    spatial_size,
)
from roadtorch.imaging.segments import measure_segments, segment_mean, segment_size
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import NUM_CLASSES, UNLABELLED
from roadtorch.road.bayes import log_odds
from roadtorch.run.loop import Inference
from roadtorch.run.memo import cache_key, read_cached, write_cached

EXCLUDED_LOG_ODDS = 0.05
"""Magnitude of the negative log odds of pixels above the threshold that the mask excludes."""

VIEWS_FOLDER = ".views"  # name of the folder of views in the folder of corrections
MAX_VIEWS = 12  # in memory; each takes a few megabytes

PAGE_SIZE, PAGE_SUPERPIXELS = WorkingSize(pixels=640 * 480), Superpixels(pixels=64)
MIN_LABELLED = 0.5  # fraction of a superpixel labelled for it to count


@dataclass(frozen=True, eq=False)
class ImageView:
    """The detector's result on one image, at the page's working size (h, w)."""

    size: tuple[int, int]  # (H, W) of the image
    odds: Tensor  # log odds of road, float32 (h, w), 0 at the threshold
    labels: Tensor  # n superpixels, int64 (h, w)
    segment_odds: Tensor  # mean log odds of each superpixel, (n,)
    graph: SegmentGraph  # of the superpixels
    layout: Tensor  # log odds of the classes of each superpixel, (n, 3), or (n, 0) without a layout
    trust: float | None  # predicted F-score of the mask, 0 to 1

    @property
    def shape(self) -> tuple[int, int]:
        """Working size (h, w)."""
        return self.labels.shape[0], self.labels.shape[1]


def compute_view(image: Tensor, detector: Detector) -> ImageView:
    """Detect the road in an image (3, H, W), and compute its superpixels and their graph."""
    size = spatial_size(image)
    with image_cache():
        detection = Inference(detector)(image)
        small = resize_to_work(image, PAGE_SIZE)
        shape = spatial_size(small)
        labels = PAGE_SUPERPIXELS.cut(small)
        segments = measure_segments(small, labels)
    threshold = torch.tensor(detector.settings.threshold)
    odds = log_odds(resize_maps(detection.likelihood, shape)) - log_odds(threshold)
    is_excluded = (odds >= 0) & ~resize_to_image(detection.mask, shape)
    odds = torch.where(is_excluded, -EXCLUDED_LOG_ODDS, odds)  # positive where the mask is road
    layout = torch.zeros(len(segments.size), 0)
    if (potentials := detection.cues.get("layout")) is not None and len(potentials) == NUM_CLASSES:
        mean = segment_mean(resize_maps(potentials, shape), labels, segments.pixels)
        layout = log_odds(mean.T)
    mean = segment_mean(odds[None], labels, segments.pixels)[0]
    graph = segment_graph(segments)
    return ImageView(size, odds, labels, mean, graph, layout, detection.trust)


def corrected_log_odds(view: ImageView, labels: np.ndarray) -> Tensor:
    """Return the log odds of road (h, w), with labels (H, W) propagated."""
    road = road_layer(resize_labels(labels, view.shape))
    evidence = _segment_votes(road == ROAD_LABEL, road == NOT_ROAD, view)
    shift = propagate(view.segment_odds, evidence, view.graph)
    return view.odds + shift[view.labels]


def corrected_layout(view: ImageView, labels: np.ndarray) -> np.ndarray:
    """Return the layout, uint8 (h, w), with labels (H, W) propagated; 255 without a layout."""
    if not view.layout.shape[1]:
        return np.full(view.labels.shape, UNLABELLED, np.uint8)
    layer = layout_layer(resize_labels(labels, view.shape))
    odds = []
    for number, prior in enumerate(view.layout.unbind(1)):
        is_other = (layer != number) & (layer != UNLABELLED)
        evidence = _segment_votes(layer == number, is_other, view)
        odds.append(prior + propagate(prior, evidence, view.graph))
    return torch.stack(odds).argmax(0)[view.labels].numpy().astype(np.uint8)


def _segment_votes(yes: np.ndarray, no: np.ndarray, view: ImageView) -> Tensor:
    """Return 1 or -1, (n,), by majority of masks (h, w), 0 where too few pixels are labelled."""
    index, count = view.labels.reshape(-1).numpy(), len(view.segment_odds)
    size = np.bincount(index, minlength=count)
    votes, against = (np.bincount(index[mask.reshape(-1)], minlength=count) for mask in (yes, no))
    is_labelled = votes + against >= MIN_LABELLED * size
    return torch.from_numpy(np.where(is_labelled, np.where(votes >= against, 1.0, -1.0), 0.0))


def resize_labels(labels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Resize labels (H, W) by nearest neighbour."""
    return resize_to_image(torch.from_numpy(labels), size).numpy()


def corrected_road(odds: Tensor, labels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the road at a size, bool (H, W): human labels, else log odds; void is no road."""
    layer = road_layer(resize_labels(labels, size))
    road = resize_maps(odds, size).numpy() >= 0
    return np.where(layer == NO_ROAD_LABEL, road, layer == ROAD_LABEL)


# --- views on disk ----------------------------------------------------------------------


@dataclass(eq=False)
class ViewStore:
    """A cache of views in memory and in ``folder``, valid while image and detector are the same."""

    folder: Path
    detector: Detector
    _views: OrderedDict[str, tuple[str, ImageView]] = field(default_factory=OrderedDict, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, repr=False)
    _computing: threading.RLock = field(default_factory=threading.RLock, repr=False)

    def view(self, name: str, image: Path) -> ImageView:
        """Return the view of an image, computed if necessary; InputError for an unreadable one."""
        key = cache_key(self._detector_key, image)
        with self._lock:
            entry = self._views.get(name)
        if entry is None or entry[0] != key:
            with self._computing:  # one image at a time: a detector uses all cores
                view = read_view(path := view_path(self.folder, name), key)
                if view is None:
                    view = compute_view(read_image(image), self.detector)
                    write_view(path, view, key)
                entry = key, view
        with self._lock:
            self._views[name] = entry
            self._views.move_to_end(name)
            while len(self._views) > MAX_VIEWS:
                self._views.popitem(last=False)
        return entry[1]

    @cached_property
    def _detector_key(self) -> str:
        """Cache key of the detector, which is slow to compute."""
        return cache_key(self.detector)


def view_path(folder: Path, name: str) -> Path:
    """Return the file of an image's view."""
    return folder / f"{name}.npz"


def write_view(path: Path, view: ImageView, key: str) -> None:
    """Write a view to disk with its cache key."""
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
    write_cached(path, key, arrays)


def read_view(path: Path, key: str | None = None) -> ImageView | None:
    """Read a view, with this cache key if not None; None where there is none."""
    arrays = read_cached(path, key)
    if arrays is None:
        return None
    count = len(arrays["indptr"]) - 1
    parts = (arrays["data"].double().numpy(), arrays["indices"].numpy(), arrays["indptr"].numpy())
    odds, labels = arrays["odds"].to(torch.float32), arrays["labels"].to(torch.int64)
    height, width = arrays["size"].tolist()
    trust, layout = float(arrays["trust"]), arrays["layout"].to(torch.float32)
    mean = segment_mean(odds[None], labels, segment_size(labels, count))[0]
    graph = sparse.csr_matrix(parts, shape=(count, count))
    trust = None if np.isnan(trust) else trust
    return ImageView((height, width), odds, labels, mean, graph, layout, trust)
