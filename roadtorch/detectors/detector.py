"""What a detector is: an image in, a likelihood, a mask and cues out.

A detector has two parts. Its own is an ``nn.Module`` that turns an image into cues, of which
``likelihood`` is one: those that come with roadtorch are in ``detectors``, where they are
found by name. What all detectors share (checking the image, deciding on the mask, batches)
is ``Detector``, here, once; it knows none of them.
"""

import os
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import reduce, wraps
from typing import Annotated, Any, Literal, NamedTuple, cast, overload

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn

from roadtorch.base.compute import one_thread
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import ImageLike, Order, as_image, checked_order
from roadtorch.base.settings import Settings, build_settings, merge
from roadtorch.detectors.detection import Cues, Detection
from roadtorch.imaging.levels import at_least
from roadtorch.imaging.resize import WorkingSize, at_image_size, at_work, size_of
from roadtorch.road.ego import Ego, continued, ego_car, is_anywhere, is_given, read_ego_mask
from roadtorch.road.outlines import Outlines, guided
from roadtorch.road.seed_area import SeedArea, remove_isolated, seed_rectangle
from roadtorch.road.trust import Judgement

MIN_SIDE = 16  # pixels; below it, superpixels and the seed area have no meaning

Threshold = Annotated[float, Field(ge=0, le=1, description="road from this likelihood on")]
Isolated = Annotated[
    Literal["drop", "keep"],
    Field(description="what becomes of road regions that do not touch the seed area"),
]

TUNED = "road from this likelihood on; the default has the best F on CamVid's three drives"
"""The description of a threshold that was chosen on labelled images."""


class DetectorSettings(Settings):
    """What every detector can be told: how its likelihood becomes a mask.

    >>> from roadtorch import DetectorSettings, load_detector
    >>> isinstance(load_detector("cpf").settings, DetectorSettings)
    True
    """

    threshold: Threshold = 0.5
    isolated: Isolated = "keep"
    seed_area: SeedArea = Field(
        default=SeedArea(), description="where road is assumed, and what connected road touches"
    )
    ego: Ego = Field(
        default=Ego(), description="the vehicle that carries the camera: never road, never seed"
    )


class WorkingSettings(DetectorSettings):
    """What every detector can be told that thinks at a working size; it drops isolated road.

    Its module sees the image at that size; ``Detector`` brings what it finds back to full size.
    """

    isolated: Isolated = "drop"
    working: WorkingSize = WorkingSize()
    outlines: Outlines = "smooth"


Judge = Callable[[Tensor, Mapping[str, Tensor]], Judgement]
"""What an analysis may have as ``judge``: a mask bool (H,W) made of its likelihood, and its cues of
that size, of which ``ego`` is one → how far the mask can be trusted."""


class Evidence(NamedTuple):
    """What one image shows by itself: all of a detection that needs no other frame.

    analysed: likelihood and cues as the analysis gave them, at the size at which it thinks.
    likelihood: float32 (H,W), without road on the ego car. ego: that, bool (H,W), where the
    settings or the analysis have one. cues: the other ones. image: (3,H,W) in [0,1].
    """

    analysed: Mapping[str, Tensor]
    likelihood: Tensor
    ego: Tensor | None
    cues: Cues
    image: Tensor


@dataclass(frozen=True)
class DetectorGrid:
    """Many detectors of one family, one for each combination of options.

    Lists show them once, and a wildcard matches them only where it names the family, and the
    preset where they have one.
    name: ``family:<option>:<option>[:preset]``, the options by what they are. summary: one line.
    refused: combinations that make no sense, by the name they would have, with the reason.
    """

    name: str
    summary: str
    refused: Mapping[str, str] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """What all their names begin with, the colon included."""
        return self.name.partition(":")[0] + ":"

    @property
    def wildcard(self) -> str:
        """What lists them all: ``family:*``, or ``family:*:preset``."""
        last = self.name.rpartition(":")[2]
        return f"{self.family}*" if last.startswith("<") else f"{self.family}*:{last}"

    def fits(self, pattern: str) -> bool:
        """Whether a pattern names the family and the preset."""
        begin, _, end = self.wildcard.partition("*")
        return pattern.startswith(begin) and pattern.endswith(end)


@dataclass(frozen=True)
class Entry:
    """One detector on offer.

    name: ``family[:option[:option]]``. summary: one line for lists.
    settings: the model of its settings.
    build: makes from them the module whose ``forward(image)`` takes an image (3,H,W) in [0,1]
        and gives named cues, (H,W) or (C,H,W); ``likelihood`` (H,W) in [0,1] is one of them.
        Usually its class.
    grid: where it is one of many. baseline: whether it never looks at the image.
    values: its own defaults where they are not those of the model, nested.
    """

    name: str
    summary: str
    settings: type[DetectorSettings]
    build: Callable[[Any], nn.Module]
    grid: DetectorGrid | None = None
    baseline: bool = False
    values: Mapping[str, Any] = field(default_factory=dict)

    def configured(self, changes: Mapping[str, Any]) -> DetectorSettings:
        """Its settings with changes, nested; ConfigError as ``build_settings``."""
        return build_settings(self.settings, merge(self.values, changes))


class Detector(nn.Module):
    """A detector that is ready to look at images; made by ``load_detector``.

    name, settings: what it was made from. order: of the colours of NumPy arrays, where none is
    told with them. device: to which images are moved; None where they stay. analysis: the module
    that finds the cues, its parts (networks among them) as attributes.
    """

    def __init__(
        self,
        entry: Entry,
        settings: DetectorSettings,
        order: Order | None = None,
        device: str | None = None,
    ) -> None:
        super().__init__()
        self.device = device
        self.order: Order | None = None if order is None else checked_order(order)
        self.name = entry.name
        self.settings = settings
        # Read once, and before any work: what is wrong with it is told now.
        self._ego_mask = read_ego_mask(settings.ego.mask) if settings.ego.mask else None
        analysis = entry.build(settings)
        if not isinstance(analysis, nn.Module):
            problem = f"builds {type(analysis).__name__}"
            hint = "build an nn.Module whose forward(image) gives the cues"
            raise ConfigError(entry.name, problem, hint)
        self.analysis = analysis.to(device)

    @overload
    def __call__(self, images: Tensor, order: Order | None = None) -> Any: ...

    @overload
    def __call__(self, images: ImageLike, order: Order | None = None) -> Detection: ...

    @overload
    def __call__(
        self, images: Iterable[ImageLike], order: Order | None = None
    ) -> list[Detection]: ...

    def __call__(self, images: Any, order: Order | None = None) -> Any:
        """An image's Detection, as ``detect``; those of several as a list, as ``detect_many``.

        Several are a list, a stack of arrays and a tensor (B,3,H,W).
        """
        if isinstance(images, (Tensor, np.ndarray)):
            several = images.ndim == 4
        else:
            one = isinstance(images, (str, bytes)) or hasattr(images, "read")  # an open file
            several = isinstance(images, Iterable) and not one
        if several:
            return list(self.detect_many(images, order))
        return self.detect(cast("ImageLike", images), order)

    def detect(self, image: ImageLike, order: Order | None = None) -> Detection:
        """Find the road in one image, from 16×16 up.

        image: a path or URL, or a file's bytes, or the file opened to read them; a NumPy array
        (H,W,3) with the ``order`` of its colours, also with alpha (H,W,4) or grey (H,W), uint8,
        uint16 or floating point in [0,1]; a Pillow image; an RGB tensor (3,H,W), floating point in
        [0,1] or uint8. Raises InputError when it is anything
        else, and when what the detector makes of it is not finite: there is no decision on NaN.
        """
        if order == "bgr" and isinstance(image, Tensor):
            raise InputError("order", "is of NumPy arrays; tensors are RGB", "give image.flip(0)")
        evidence = self.find(as_image(image, order or self.order))
        return self.conclude(evidence)

    def detect_many(
        self, images: Iterable[ImageLike], order: Order | None = None
    ) -> Generator[Detection]:
        """Find the road in image after image, each given as to ``detect``, in their order.

        images: a list, a generator, which is asked when it is needed, or a stack of arrays of one
        size. Raises what ``detect`` raises, naming the image ``images[3]``, and ends there.

            >>> import numpy
            >>> from roadtorch import load_detector
            >>> detector = load_detector("prior:rows", order="bgr")
            >>> frames = (numpy.zeros((60, 80 + n, 3), numpy.uint8) for n in range(2))
            >>> [detection.mask.shape[1] for detection in detector.detect_many(frames)]
            [80, 81]
        """
        if isinstance(images, (str, os.PathLike, bytes)) or not isinstance(images, Iterable):
            hint = "give a list; detect takes one image"
            raise InputError("images", f"are {type(images).__name__}", hint)
        return self._detected(images, order)

    def _detected(self, images: Iterable[ImageLike], order: Order | None) -> Generator[Detection]:
        for number, image in enumerate(images):
            try:
                yield self.detect(image, order)
            except InputError as error:
                if error.where != "image":
                    raise
                raise InputError(f"images[{number}]", error.problem, error.hint) from None

    @one_thread()
    def forward(self, images: Tensor) -> Tensor:
        """Likelihoods (B,H,W) of a batch (B,3,H,W); each equals that of ``detect``."""
        if images.ndim != 4:
            problem = f"have the shape {tuple(images.shape)}"
            raise InputError("images", problem, "give a batch (B, 3, height, width)")
        if not len(images):
            return images.new_empty((0, *images.shape[-2:]), dtype=torch.float32)
        return torch.stack([self._find(image).likelihood for image in images])

    @one_thread()
    @torch.no_grad()
    def find(self, image: Tensor) -> Evidence:
        """The first half of ``detect``: likelihood and cues of an image (3,H,W) in [0,1]."""
        return self._find(image)

    def _find(self, image: Tensor) -> Evidence:
        """``_found``, in float32 inside autocast, too; ConfigError inside ``torch.compile``."""
        if torch.compiler.is_compiling():
            hint = "compile its network: detector.analysis.network = torch.compile(…)"
            raise ConfigError("torch.compile", "takes no detector", hint)
        image = checked_image(image).to(self.device)
        with torch.autocast("cuda" if image.is_cuda else "cpu", enabled=False):
            return self._found(image)

    def _found(self, image: Tensor) -> Evidence:
        """The ego car is what the settings say, and what the analysis finds as its cue ``ego``."""
        settings = self.settings if isinstance(self.settings, WorkingSettings) else None
        cars, ground = [], image
        if is_given(self.settings.ego):
            cars = [ego_car(image, self.settings.ego, self._ego_mask)]
            ground = continued(image, cars[0])
        small = at_work(ground, settings.working) if settings else ground
        analysed = self.analysis(small)
        if not isinstance(analysed, Mapping) or "likelihood" not in analysed:
            problem = f"gives no likelihood: {type(self.analysis).__name__}.forward has to"
            raise ConfigError(self.name, problem, "let it return a mapping with likelihood (H,W)")
        if not analysed["likelihood"].sum().isfinite():  # one that is not makes the sum so
            problem = f"gives {self.name} a likelihood that is not finite"
            raise InputError("image", problem, "check the weights and the settings; else report it")
        size, cues = size_of(image), dict(analysed)
        likelihood = cues.pop("likelihood")
        if settings:
            if settings.outlines == "guided":
                likelihood = guided(analysed, small, ground, settings.working, settings.threshold)
            likelihood = at_image_size(likelihood, size)
        if "ego" in cues:
            cars.append(at_image_size(cues.pop("ego"), size))
        ego = reduce(torch.logical_or, cars) if cars else None
        if ego is not None and is_anywhere(ego):
            likelihood = likelihood.masked_fill(ego, 0)
            if "seed_area" in cues:
                cues["seed_area"] = at_image_size(cues["seed_area"], size).masked_fill(ego, 0)
        return Evidence(analysed, likelihood, ego, Cues(cues, size), image)

    @one_thread()
    @torch.no_grad()
    def conclude(
        self, evidence: Evidence, likelihood: Tensor | None = None, ego: Tensor | None = None
    ) -> Detection:
        """The second half of ``detect``: the decision, and how far it can be trusted.

        likelihood: float32 (H,W) in [0,1], and ego: the ego car bool (H,W), decided on in the place
        of those of the evidence, as when frames of a video steady one another. Trust still rests on
        the frame's own.
        """
        analysed, seed = evidence.analysed, evidence.analysed.get("seed_area")
        ego = evidence.ego if ego is None else ego
        if likelihood is None:
            likelihood = evidence.likelihood
        elif ego is not None:
            likelihood = likelihood.masked_fill(ego, 0)
        if seed is not None:
            seed = at_image_size(seed, size_of(likelihood))
        mask = decide(likelihood, self.settings, seed, ego)
        trust, doubt, cues = None, "", evidence.cues
        judge: Judge | None = getattr(self.analysis, "judge", None)
        if judge is not None:
            size = size_of(analysed["likelihood"])
            hidden = torch.zeros_like(mask) if ego is None else ego
            small = {**analysed, "ego": at_image_size(hidden, size)}
            trust, doubt = judge(at_image_size(mask, size), small)
        if ego is not None:
            cues = Cues({**cues.maps, "ego": ego}, cues.size)
        return Detection(likelihood, mask, cues, trust, doubt, image=evidence.image)

    def extra_repr(self) -> str:
        """The name and settings, for ``print(detector)``."""
        return f"{self.name!r}, {self.settings!r}"


def lean(find: Callable[..., Mapping[str, Tensor]]) -> Callable[..., dict[str, Tensor]]:
    """Mark what an analysis does: image (3,H,W) in [0,1] and more → maps.

    It runs in inference mode, on the CPU and where no gradients are asked for: what autograd
    notes of a thousand small kernels takes a fifteenth of the time. Its maps are copies, with
    which can be done what can be done with any tensor. For analyses of our own: others may want
    gradients inside.
    """

    @wraps(find)
    def wrapped(*parts: Any) -> dict[str, Tensor]:
        if torch.compiler.is_exporting():
            return dict(find(*parts))
        on_cpu = all(part.device.type == "cpu" for part in parts if isinstance(part, Tensor))
        with torch.inference_mode() if on_cpu and not torch.is_grad_enabled() else nullcontext():
            maps = find(*parts)
        return {name: map.clone() if map.is_inference() else map for name, map in maps.items()}

    return wrapped


class Analysis(nn.Module):
    """An analysis without weights: ``find(image, settings)`` gives the cues."""

    def __init__(self, find: Callable[[Tensor, Any], Mapping[str, Tensor]], settings: Any) -> None:
        super().__init__()
        self.find = find
        self.settings = settings

    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        return self.find(image, self.settings)


def checked_image(image: Tensor) -> Tensor:
    """The image as float32 (3,H,W), if it is one: floating point, ≥ 16×16, in [0,1].

    Raises InputError naming ``image``, what came and what to do.
    """
    if not isinstance(image, Tensor) or not image.is_floating_point():
        kind = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise InputError("image", f"is {kind}", "give float32 RGB in [0, 1], as read_image does")
    if image.ndim != 3 or image.shape[0] != 3:
        problem = f"has the shape {tuple(image.shape)}"
        raise InputError("image", problem, "give RGB as (3, height, width)")
    height, width = image.shape[1:]
    if min(height, width) < MIN_SIDE:
        hint = f"give at least {MIN_SIDE}×{MIN_SIDE}"
        raise InputError("image", f"is {width}×{height} pixels", hint)
    low, high = (float(bound) for bound in torch.aminmax(image))
    if not (low >= 0 and high <= 1):  # also true of NaN, which passes through aminmax
        raise InputError("image", f"has values from {low:g} to {high:g}", "scale it to [0, 1]")
    return image.to(torch.float32)


def decide(
    likelihood: Tensor,
    settings: DetectorSettings,
    seed: Tensor | None = None,
    ego: Tensor | None = None,
) -> Tensor:
    """The mask bool (H,W): likelihood ≥ threshold, isolated regions dropped if asked for.

    seed: the seed area bool (H,W), where a detector has found it; else its rectangle. ego: the ego
    car bool (H,W), no road. Road reaches the seed area through the ground that it hides. Where only
    hidden ground does, that says nothing about which region is the road, and none is dropped.
    """
    if ego is not None and not is_anywhere(ego):
        ego = None
    shown = likelihood if ego is None else continued(likelihood, ego)
    mask = at_least(shown, settings.threshold)
    if settings.isolated == "drop":
        area = seed_rectangle(mask.shape, settings.seed_area) if seed is None else seed
        mask = remove_isolated(mask, area)
    if ego is None:
        return mask
    mask = mask & ~ego
    return mask if mask.any() else at_least(likelihood, settings.threshold) & ~ego
