"""What a detector is: a picture in, a likelihood, a mask and cues out.

A detector has two parts. Its own is an ``nn.Module`` that turns an image into cues, of which
``likelihood`` is one: those that come with roadtorch are in ``detectors``, where they are
found by name. What all detectors share (checking the image, deciding on the mask, batches)
is ``Detector``, here, once; it knows none of them.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from roadtorch.ego import Ego, continued, ego_car, is_given, read_ego_mask
from roadtorch.errors import ConfigError, InputError
from roadtorch.seed_area import SeedArea, remove_isolated, seed_area
from roadtorch.settings import Settings
from roadtorch.working_size import WorkingSize, at_working_size

SMALLEST_SIDE = 16  # pixels; below it, superpixels and the seed area have no meaning

Threshold = Annotated[float, Field(ge=0, le=1, description="road from this likelihood on")]
Isolated = Annotated[
    Literal["drop", "keep"],
    Field(description="what becomes of road regions that do not touch the seed area"),
]

TUNED = "road from this likelihood on; the default has the best F on CamVid's three drives"
"""The description of a threshold that was chosen on labelled pictures."""


class DetectorSettings(Settings):
    """What every detector can be told: how its likelihood becomes a mask."""

    renamed: ClassVar[Mapping[str, str]] = {"seed": "seed_area", "random": "random_seed"}

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


class Cues(Mapping[str, Tensor]):
    """What was found beside the likelihood, by name; maps are made when asked for."""

    def __init__(self, found: Mapping[str, Tensor]) -> None:
        self._found = found

    def __getitem__(self, name: str) -> Tensor:
        """The map of that name, (H,W) or (C,H,W); KeyError where there is none."""
        if name == "likelihood":
            raise KeyError(name)
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        """The names of the cues."""
        return (name for name in self._found if name != "likelihood")

    def __len__(self) -> int:
        """How many cues there are."""
        return len(self._found) - 1


class WithoutEgo(Mapping[str, Tensor]):
    """What an analysis found, with no likelihood of road on the ego car bool (H,W): a cue too."""

    def __init__(self, found: Mapping[str, Tensor], ego: Tensor) -> None:
        self._found = found
        self._ego = ego

    def __getitem__(self, name: str) -> Tensor:
        """The map of that name, (H,W) or (C,H,W); KeyError where there is none."""
        if name == "ego":
            return self._ego
        found = self._found[name]
        return found.masked_fill(self._ego, 0) if name == "likelihood" else found

    def __iter__(self) -> Iterator[str]:
        """The names of all maps, ``ego`` the last."""
        yield from (name for name in self._found if name != "ego")
        yield "ego"

    def __len__(self) -> int:
        """How many maps there are."""
        return len(self._found) + ("ego" not in self._found)


@dataclass(frozen=True)
class Detection:
    """What a detector says about one image.

    likelihood: float32 (H,W) in [0,1], higher is more road-like.
    mask: bool (H,W), the decision.
    cues: the maps the decision rests on, by name; (H,W) or (C,H,W).
    trust: the expected F of the mask, in [0,1]; None where the detector does not say.
    """

    likelihood: Tensor
    mask: Tensor
    cues: Mapping[str, Tensor]
    trust: float | None = None


@dataclass(frozen=True)
class DetectorGrid:
    """Many detectors of one family, one for each combination of options.

    Lists show them once, and a wildcard matches them only where it names the family.
    name: ``family:<option>:<option>``, the options by what they are. summary: one line.
    refused: combinations that make no sense, by the name they would have, with the reason.
    """

    name: str
    summary: str
    refused: Mapping[str, str] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """What all their names begin with, the colon included."""
        return self.name.partition(":")[0] + ":"


@dataclass(frozen=True)
class Entry:
    """One detector on offer.

    name: ``family[:option[:option]]``. summary: one line for lists.
    settings: the model of its settings.
    build: makes from them the module whose ``forward(image)`` takes an image (3,H,W) in [0,1]
        and gives named cues, (H,W) or (C,H,W); ``likelihood`` (H,W) in [0,1] is one of them.
        Usually its class.
    grid: where it is one of many. floor: whether it is a floor, which never looks at the picture.
    """

    name: str
    summary: str
    settings: type[DetectorSettings]
    build: Callable[[Any], nn.Module]
    grid: DetectorGrid | None = None
    floor: bool = False


class Detector(nn.Module):
    """A detector that is ready to look at images; made by ``load_detector``.

    name, settings: what it was made from. analysis: the module that finds the cues, its
    parts (networks among them) as attributes.
    """

    def __init__(self, entry: Entry, settings: DetectorSettings) -> None:
        super().__init__()
        self.name = entry.name
        self.settings = settings
        if settings.ego.mask:
            read_ego_mask(settings.ego.mask)  # what is wrong with it is told before any work
        analysis = entry.build(settings)
        if not isinstance(analysis, nn.Module):
            what = f"builds {type(analysis).__name__}"
            remedy = "build an nn.Module whose forward(image) gives the cues"
            raise ConfigError(entry.name, what, remedy)
        self.analysis = analysis

    @torch.no_grad()
    def detect(self, image: Tensor) -> Detection:
        """Find the road in one image (3,H,W), floating point in [0,1], from 16×16 up.

        Raises InputError when the image is anything else.
        """
        image = checked_image(image)
        found = self._find(image)
        likelihood, ego = found["likelihood"], found.get("ego")
        if ego is None:
            return Detection(likelihood, decide(likelihood, self.settings), Cues(found))
        # Road reaches the seed area through the ground that the ego car hides.
        mask = decide(continued(likelihood[None], ego)[0], self.settings) & ~ego
        return Detection(likelihood, mask, Cues(found))

    def forward(self, images: Tensor) -> Tensor:
        """Likelihoods (B,H,W) of a batch (B,3,H,W); each equals that of ``detect``."""
        if images.ndim != 4:
            raise InputError(
                "images",
                f"have the shape {tuple(images.shape)}",
                "give a batch (B, 3, height, width)",
            )
        if not len(images):
            return images.new_empty((0, *images.shape[-2:]), dtype=torch.float32)
        return torch.stack([self._find(checked_image(image))["likelihood"] for image in images])

    def _find(self, image: Tensor) -> Mapping[str, Tensor]:
        """The likelihood and the cues at the size of the image, with the ego car where one is.

        The ego car is what the settings say, and what the analysis itself finds as its cue ``ego``.
        """
        if not is_given(self.settings.ego):
            found = self._analyse(image)
            return WithoutEgo(found, found["ego"]) if "ego" in found else found
        ego = ego_car(image, self.settings.ego)
        found = self._analyse(continued(image, ego))
        return WithoutEgo(found, ego | found["ego"] if "ego" in found else ego)

    def _analyse(self, image: Tensor) -> Mapping[str, Tensor]:
        """What the analysis finds, at the size of the image."""
        if isinstance(self.settings, WorkingSettings):
            return at_working_size(self.analysis, image, self.settings.working)
        return self.analysis(image)

    def extra_repr(self) -> str:
        """The name and settings, for ``print(detector)``."""
        return f"{self.name!r}, {self.settings!r}"


def checked_image(image: Tensor) -> Tensor:
    """The image as float32 (3,H,W), if it is one: floating point, ≥ 16×16, in [0,1].

    Raises InputError naming ``image``, what came and what to do.
    """
    if not isinstance(image, Tensor) or not image.is_floating_point():
        given = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise InputError("image", f"is {given}", "give float32 RGB in [0, 1], as read_image does")
    if image.ndim != 3 or image.shape[0] != 3:
        raise InputError(
            "image", f"has the shape {tuple(image.shape)}", "give RGB as (3, height, width)"
        )
    height, width = image.shape[1:]
    if min(height, width) < SMALLEST_SIDE:
        raise InputError(
            "image",
            f"is {width}×{height} pixels",
            f"give at least {SMALLEST_SIDE}×{SMALLEST_SIDE}",
        )
    low, high = (float(bound) for bound in torch.aminmax(image))
    if not (low >= 0 and high <= 1):  # also true of NaN, which passes through aminmax
        raise InputError("image", f"has values from {low:g} to {high:g}", "scale it to [0, 1]")
    return image.to(torch.float32)


def decide(likelihood: Tensor, settings: DetectorSettings) -> Tensor:
    """The mask bool (H,W): likelihood ≥ threshold, isolated regions dropped if asked for."""
    mask = likelihood >= settings.threshold
    if settings.isolated == "keep":
        return mask
    return remove_isolated(mask, *seed_area(mask.shape[0], mask.shape[1], settings.seed_area))
