"""Detectors: an image in; a likelihood, a mask and cues out.

``Detector`` is what all share around the analysis of an entry: checking the image, the ego car,
full size, batches and footage.
"""

import math
import os
import reprlib
from collections.abc import Generator, Iterable, Iterator, Mapping
from functools import reduce
from typing import Any, cast, get_args, overload

import numpy as np
import torch
from torch import Tensor, nn

from roadtorch.base.compute import one_torch_thread
from roadtorch.base.errors import ConfigError, InputError, check_unit_range
from roadtorch.base.image import ColourOrder, ImageLike, as_image, check_order
from roadtorch.base.settings import merge
from roadtorch.detectors.detection import Cues, Detection
from roadtorch.detectors.entry import DetectorSettings, Entry, Judge, WorkingSettings
from roadtorch.detectors.mask import Evidence, decide_mask
from roadtorch.detectors.stream import detect_stream
from roadtorch.imaging.resize import resize_to_image, resize_to_work, spatial_size
from roadtorch.inputs.item import Selection
from roadtorch.layout.runtimes import REFERENCE, use_runtime
from roadtorch.road.ego import any_pixel, ego_car, extrapolate_over_ego, has_ego_car, read_ego_mask
from roadtorch.road.outlines import refine
from roadtorch.road.temporal_filter import TemporalFilter

RANGE_TOLERANCE = 1e-5  # by which a likelihood may leave [0, 1]
MIN_IMAGE_SIDE = 16  # pixels; superpixels and the seed area make no sense in smaller images


class Detector(nn.Module):
    """Road detector, ready to use; made by ``load_detector``.

    Attributes:
        name: of the detector.
        settings: all of them.
        order: colour order of NumPy arrays that come without one.
        device: device for which it was loaded. Images are moved to the one of its weights; without
            weights, to this one; None: they stay where they are.
        analysis: module that computes the cues, with its networks as attributes.

    >>> from roadtorch import load_detector
    >>> detector = load_detector("fusion", threshold=0.6)
    >>> detector
    <Detector fusion, threshold=0.6>
    >>> detector("street.jpg").mask.numpy().shape
    (240, 320)
    """

    def __init__(
        self,
        entry: Entry,
        settings: DetectorSettings,
        order: ColourOrder | None = None,
        device: str | None = None,
        runtime: str = REFERENCE,
    ) -> None:
        super().__init__()
        self.device, self.runtime = device, runtime
        self.order: ColourOrder | None = None if order is None else check_order(order)
        self.name = entry.name
        self.settings = settings
        self._defaults = entry.defaults
        # Read here, so that errors in the file are reported before any image is analysed.
        self._has_ego_car = has_ego_car(settings.ego)
        self._ego_mask = read_ego_mask(settings.ego.mask) if settings.ego.mask else None
        analysis = entry.build(settings)
        if not isinstance(analysis, nn.Module):
            problem = f"builds {type(analysis).__name__}"
            hint = "build an nn.Module whose forward(image) gives the cues"
            raise ConfigError(entry.name, problem, hint)
        self.analysis = analysis.to(device)
        use_runtime(entry.name, analysis, runtime)

    @overload
    def __call__(self, images: Tensor, order: ColourOrder | None = None) -> Any: ...

    @overload
    def __call__(self, images: ImageLike, order: ColourOrder | None = None) -> Detection: ...

    @overload
    def __call__(
        self, images: Iterable[ImageLike], order: ColourOrder | None = None
    ) -> list[Detection]: ...

    def __call__(self, images: Any, order: ColourOrder | None = None) -> Any:
        """Return the Detection of an image, as ``detect``, or those of several, as a list.

        Several are a list, a stack of arrays or a tensor of shape (B, 3, H, W). Unlike
        in other modules this is not ``forward``, which returns likelihoods alone.
        """
        if isinstance(images, (Tensor, np.ndarray)):
            several = images.ndim == 4
        else:
            single = isinstance(images, (str, bytes)) or hasattr(images, "read")  # an open file
            several = isinstance(images, Iterable) and not single
        if several:
            return list(self.detect_many(images, order))
        return self.detect(cast("ImageLike", images), order)

    @one_torch_thread()  # once for both halves: it takes a millisecond
    def detect(self, image: ImageLike, order: ColourOrder | None = None) -> Detection:
        """Detect the road in one image of at least 16×16 pixels.

        Args:
            image: path, URL, bytes of a file, or open binary file; NumPy array of shape (H, W, 3),
                (H, W, 4) with alpha or (H, W) grey, uint8, uint16 or floating point in [0, 1];
                Pillow image; or RGB tensor of shape (3, H, W), floating point in [0, 1] or uint8.
            order: colour order of an array, ``"rgb"`` or ``"bgr"`` (OpenCV's), unless
                ``load_detector`` got it.

        Returns:
            A detection with torch tensors on the detector's device; ``detection.mask.numpy()`` is
            an array, ``detection.numpy()`` has them all, from any device.

        Raises:
            InputError: The image cannot be used, or its likelihood is not finite.
            ConfigError: ``order`` is not a colour order.
        """
        bgr = order is not None and check_order(order) == "bgr"
        if isinstance(image, str) and image in get_args(ColourOrder) and not os.path.exists(image):
            raise InputError("image", "is a colour order", f'write detect(image, "{image}")')
        if bgr and isinstance(image, Tensor):
            raise InputError("order", "is for NumPy arrays; tensors are RGB", "give image.flip(0)")
        return self.conclude(self.find_evidence(as_image(image, order or self.order)))

    def detect_many(
        self, images: str | os.PathLike[str] | Iterable[ImageLike], order: ColourOrder | None = None
    ) -> Generator[Detection]:
        """Detect the road in several images, one after the other, in order.

        Args:
            images: list or generator of images as ``detect`` takes them, or a stack of arrays of
                one size; or a folder or a glob, as ``stream`` takes it, without smoothing. Images
                are read and a generator is advanced only as results are needed.
            order: colour order of arrays, as in ``detect``.

        Raises:
            InputError: As in ``detect``, naming the image ``images[3]``; the generator ends there.

        >>> import numpy
        >>> from roadtorch import load_detector
        >>> detector = load_detector("prior:rows", order="bgr")
        >>> frames = (numpy.zeros((60, 80 + n, 3), numpy.uint8) for n in range(2))
        >>> [detection.mask.shape[1] for detection in detector.detect_many(frames)]
        [80, 81]
        """
        if isinstance(images, (str, os.PathLike)):
            return self.stream(images, smoothing=False)
        if isinstance(images, bytes) or not isinstance(images, Iterable):
            hint = "give a list, a folder or a glob; detect takes one image"
            raise InputError("images", f"are {type(images).__name__}", hint)
        return self._detections(images, order)

    def _detections(
        self, images: Iterable[ImageLike], order: ColourOrder | None
    ) -> Generator[Detection]:
        for number, image in enumerate(images):
            try:
                yield self.detect(image, order)
            except InputError as error:
                if error.where != "image":
                    raise
                raise InputError(f"images[{number}]", error.problem, error.hint) from None

    def stream(
        self, source: str | os.PathLike[str], *, smoothing: bool = True, **selection: Any
    ) -> Generator[Detection]:
        """Detect the road in each frame of footage; ``detect_stream`` with this detector.

        Args:
            source: path of a video, bag or folder of images, camera number ("0"), or address.
            smoothing: whether likelihoods of footage are smoothed over time, as ``roadtorch infer``
                does unless it gets ``--no-smoothing``.
            **selection: frames to process: ``every=5``, ``start`` and ``end`` in seconds,
                ``limit``; ``topic`` of a bag. See ``roadtorch.inputs.item.Selection``.

        >>> from roadtorch import load_detector
        >>> for detection in load_detector("prior:rows").stream("street.jpg"):
        ...     print(detection.name, detection)
        street <Detection 320×240, road 50%>
        """
        return detect_stream(source, self, Selection(**selection), smoothing=smoothing)

    @one_torch_thread()
    def forward(self, images: Tensor) -> Tensor:
        """Return likelihoods alone, (B, H, W) for a batch (B, 3, H, W); calls return Detections."""
        if images.ndim != 4:
            problem = f"have the shape {tuple(images.shape)}"
            raise InputError("images", problem, "give a batch (B, 3, height, width)")
        if not len(images):
            return images.new_empty((0, *images.shape[-2:]), dtype=torch.float32)
        return torch.stack([self._find(image).likelihood for image in images])

    @one_torch_thread()
    @torch.no_grad()
    def find_evidence(self, image: Tensor) -> Evidence:
        """Compute likelihood and cues of an image (3, H, W) in [0, 1]: first half of ``detect``."""
        return self._find(image)

    def _find(self, image: Tensor) -> Evidence:
        """Analyse an image without autocast; ConfigError inside ``torch.compile``.

        Its ego car is the union of the settings' and the cue ``ego``.
        """
        if torch.compiler.is_compiling():
            hint = "compile its backbone: detector.analysis.network.backbone = torch.compile(…)"
            raise ConfigError("torch.compile", "takes no detector", hint)
        device = next((weights.device for weights in self.parameters()), self.device)
        image = validate_image(image).to(device)
        cars, ground, size = [], image, (image.shape[1], image.shape[2])
        with torch.autocast("cuda" if image.is_cuda else "cpu", enabled=False):
            if self._has_ego_car:
                cars = [ego_car(image, self.settings.ego, self._ego_mask)]
                ground = extrapolate_over_ego(image, cars[0])
            outputs, likelihood = self.find_maps(ground)
            cues = {name: map for name, map in outputs.items() if name != "likelihood"}
            if "ego" in cues:
                cars.append(resize_to_image(cues.pop("ego"), size))
            ego = reduce(torch.logical_or, cars) if cars else None
            if ego is not None and any_pixel(ego):
                likelihood = likelihood.masked_fill(ego, 0)
                if "seed_area" in cues:
                    seed = resize_to_image(cues["seed_area"], size)
                    cues["seed_area"] = seed.masked_fill(ego, 0)
        return Evidence(outputs, likelihood, ego, Cues(cues, size), image)

    def find_maps(self, image: Tensor) -> tuple[Mapping[str, Tensor], Tensor]:
        """Return the maps of an image's analysis, and the likelihood (H, W) at its full size."""
        settings = self.settings if isinstance(self.settings, WorkingSettings) else None
        small = resize_to_work(image, settings.working) if settings else image
        outputs = self.analysis(small)
        if not isinstance(outputs, Mapping) or "likelihood" not in outputs:
            problem = f"returns no likelihood from {type(self.analysis).__name__}.forward"
            raise ConfigError(self.name, problem, "return a mapping with likelihood (H, W)")
        self._check_likelihood(outputs["likelihood"], None if settings else spatial_size(image))
        likelihood = outputs["likelihood"].clamp(0, 1)  # of what RANGE_TOLERANCE lets pass
        if settings:
            if settings.outlines == "guided":
                likelihood = refine(outputs, small, image, settings.working, settings.threshold)
            likelihood = resize_to_image(likelihood, spatial_size(image))
        return outputs, likelihood

    def _check_likelihood(self, likelihood: Tensor, size: tuple[int, int] | None) -> None:
        """Raise ConfigError for a likelihood of a wrong shape or range, InputError for NaN."""
        shape, hint = tuple(likelihood.shape), "return (height, width) of the image it was given"
        if len(shape) != 2 or shape != (size or shape):
            raise ConfigError(self.name, f"returns a likelihood of the shape {shape}", hint)
        low, high = (float(bound) for bound in likelihood.aminmax())
        if not math.isfinite(high - low):
            problem = f"gives {self.name} a likelihood that is not finite"
            raise InputError("image", problem, "check the weights and the settings; else report it")
        if low < -RANGE_TOLERANCE or high > 1 + RANGE_TOLERANCE:
            problem = f"returns likelihoods from {low:g} to {high:g}"
            raise ConfigError(self.name, problem, "scale them to [0, 1]")

    @one_torch_thread()
    @torch.no_grad()
    def conclude(
        self, evidence: Evidence, temporal_filter: TemporalFilter | None = None
    ) -> Detection:
        """Decide on the mask and predict its trust: second half of ``detect``.

        temporal_filter: smooths likelihood and ego car of a source's frames, in order, for the
        mask; the trust is predicted from those of the frame alone.
        """
        outputs, seed = evidence.outputs, evidence.outputs.get("seed_area")
        likelihood, ego = evidence.likelihood, evidence.ego
        if temporal_filter is not None:
            likelihood = temporal_filter(evidence.image, likelihood, ego, evidence.motion)
            ego = temporal_filter.hidden
        if seed is not None:
            seed = resize_to_image(seed, spatial_size(likelihood))
        mask = decide_mask(likelihood, self.settings, seed, ego)
        trust, doubt = self.judge(mask, outputs, ego)
        cues = evidence.cues
        if ego is not None:
            cues = Cues({**cues.maps, "ego": ego}, cues.size)
        return Detection(likelihood, mask, cues, trust, doubt, image=evidence.image)

    def judge(
        self, mask: Tensor, outputs: Mapping[str, Tensor], ego: Tensor | None
    ) -> tuple[float | None, str]:
        """Predict the trust in a mask (H, W), and its doubt; None if the detector predicts none."""
        judge: Judge | None = getattr(self.analysis, "judge", None)
        if judge is None:
            return None, ""
        size = spatial_size(outputs["likelihood"])
        hidden = torch.zeros_like(mask) if ego is None else ego
        return judge(resize_to_image(mask, size), {**outputs, "ego": resize_to_image(hidden, size)})

    def __repr__(self) -> str:
        """Return one line: the name, and the settings that differ from the detector's defaults."""
        defaults = type(self.settings).model_construct().model_dump(warnings=False)
        settings = _changes(self.settings.model_dump(), merge(defaults, self._defaults))
        runtime = None if self.runtime == REFERENCE else self.runtime
        values = {**dict(settings), "order": self.order, "device": self.device, "runtime": runtime}
        changes = [f", {k}={reprlib.repr(v)}" for k, v in values.items() if v is not None]
        return f"<Detector {self.name}{''.join(changes)}>"


def _changes(
    settings: Mapping[str, Any], defaults: Mapping[str, Any], group: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the settings that differ from the defaults, by their full key."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _changes(value, defaults.get(key) or {}, f"{group}{key}.")
        elif value != defaults.get(key):
            yield f"{group}{key}", value


def validate_image(image: Tensor) -> Tensor:
    """Return an image (3, H, W) as float32; InputError unless in [0, 1] and at least 16×16."""
    if not isinstance(image, Tensor) or not image.is_floating_point():
        kind = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise InputError("image", f"is {kind}", "give float32 RGB in [0, 1], as read_image does")
    if image.ndim != 3 or image.shape[0] != 3:
        problem = f"has the shape {tuple(image.shape)}"
        raise InputError("image", problem, "give RGB as (3, height, width)")
    height, width = image.shape[1:]
    if min(height, width) < MIN_IMAGE_SIDE:
        hint = f"give at least {MIN_IMAGE_SIDE}×{MIN_IMAGE_SIDE}"
        raise InputError("image", f"is {width}×{height} pixels", hint)
    low, high = (float(bound) for bound in torch.aminmax(image))
    check_unit_range("image", low, high, "scale it to [0, 1]")
    return image.to(torch.float32)
