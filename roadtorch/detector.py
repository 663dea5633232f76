"""What a detector is: a picture in, a likelihood, a mask and cues out.

Everything that all detectors share (checking the picture, deciding on the mask, batching) is
here, once. It knows none of them: they are in ``detectors``, and found by name there.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from roadtorch.errors import InputError
from roadtorch.seed_area import SeedArea, remove_isolated, seed_area
from roadtorch.settings import Settings
from roadtorch.working_size import WorkingSize

SMALLEST_SIDE = 16  # pixels; below it, superpixels and the seed area have no meaning

Analysis = Callable[[Tensor], Mapping[str, Tensor]]
"""An image (3,H,W) in, named cues out; ``likelihood`` (H,W) in [0,1] is one of them."""


class Cues(Mapping[str, Tensor]):
    """What an analysis found beside the likelihood, by name; maps are made when asked for."""

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


@dataclass(frozen=True)
class Detection:
    """What a detector says about one image.

    likelihood: float32 (H,W) in [0,1], higher is more road-like.
    mask: bool (H,W), the decision.
    cues: the maps the decision rests on, by name; (H,W) or (C,H,W).
    """

    likelihood: Tensor
    mask: Tensor
    cues: Mapping[str, Tensor]


@dataclass(frozen=True)
class Grid:
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

    name: ``family[:option[:option]]``.
    summary: one line for lists.
    settings: the model of its settings; it has ``threshold``, a float in [0,1]. A field
        ``isolated`` equal to ``"drop"`` asks for the removal of road regions that do
        not touch the seed area, whose size a field ``seed`` may set.
    build: makes the analysis from the settings. An analysis that is an ``nn.Module``
        becomes part of the detector, so that its weights are saved with it.
    grid: where it is one of many.
    floor: whether it is a floor, a detector that never looks at the picture.
    """

    name: str
    summary: str
    settings: type[Settings]
    build: Callable[[Any], Analysis]
    grid: Grid | None = None
    floor: bool = False


class Detector(nn.Module):
    """A detector that is ready to look at images; made by ``load_detector``."""

    def __init__(self, entry: Entry, settings: Settings) -> None:
        super().__init__()
        self.name = entry.name
        self.settings = settings
        self.analysis = entry.build(settings)

    @torch.no_grad()
    def detect(self, image: Tensor) -> Detection:
        """Find the road in one image (3,H,W), floating point in [0,1], from 16×16 up.

        Raises InputError when the image is anything else.
        """
        image = checked_image(image)
        found = self.analysis(image)
        likelihood = found["likelihood"]
        return Detection(likelihood, decide(likelihood, self.settings), Cues(found))

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
        return torch.stack([self.analysis(checked_image(image))["likelihood"] for image in images])

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


def decide(likelihood: Tensor, settings: Settings) -> Tensor:
    """The mask bool (H,W): likelihood ≥ threshold, isolated regions dropped if asked for."""
    mask = likelihood >= getattr(settings, "threshold")  # noqa: B009  (see Entry.settings)
    if getattr(settings, "isolated", "keep") != "drop":
        return mask
    height, width = mask.shape
    rows, columns = seed_area(height, width, getattr(settings, "seed", SeedArea()))
    return remove_isolated(mask, rows, columns)


THRESHOLD = "road from this likelihood on; the default has the best F on CamVid's three drives"

ISOLATED = "what becomes of road regions that do not touch the seed area"


class Decision(Settings):
    """Working size, seed area, and how the likelihood becomes a mask."""

    threshold: float = Field(default=0.5, ge=0, le=1, description=THRESHOLD)
    isolated: Literal["drop", "keep"] = Field(default="drop", description=ISOLATED)
    seed: SeedArea = Field(default=SeedArea(), description="the area taken to be road")
    working: WorkingSize = WorkingSize()
