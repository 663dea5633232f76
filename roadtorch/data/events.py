"""What a person did to the labels of a picture, one event at a time, as it is kept on disk.

Positions are in pixels of the picture, x to the right, y down, pixel centres at whole numbers.
Regions are runs: start, length, start, length, … of pixels counted row by row.
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

import cv2
import numpy as np
import pydantic
from pydantic import Field

from roadtorch.data.correction_labels import LABELS, after_saying
from roadtorch.data.imported import first_mistake
from roadtorch.data.polygons import fill_polygon
from roadtorch.errors import InputError
from roadtorch.settings import Settings

MAX_POINTS = 20_000  # of one stroke; ours: a hand draws some hundreds

MAX_RADIUS = 2000  # pixels of a brush

MAX_SECONDS = 600.0  # seconds that one event may have taken; the page counts no idle minute

Point = tuple[
    Annotated[float, Field(ge=-1e5, le=1e5)],
    Annotated[float, Field(ge=-1e5, le=1e5)],
]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
Saying = Literal["road", "not_road", "void", "sky", "vertical", "horizontal"]
Number = Annotated[int, Field(ge=0, lt=2**31)]  # of a pixel or a superpixel
Runs = Annotated[tuple[Number, ...], Field(description="start, length, …")]
Label = Annotated[str, Field(pattern=f"^({'|'.join(LABELS)})$")]


class Event(Settings):
    """One line of a log.

    id: made where it was done; the same id twice is the same event, sent again. time: seconds
    since 1970. seconds: how long the person was at it.
    """

    id: Name
    time: float = Field(default=0.0, ge=0)
    seconds: float = Field(default=0.0, ge=0, le=MAX_SECONDS)


class SuperpixelStroke(Event):
    """Superpixels clicked or dragged over; ``runs`` are their pixels, whoever cuts them later."""

    kind: Literal["superpixel"]
    saying: Saying
    segments: tuple[Number, ...]
    cut: str = Field(default="", max_length=64, description="digest of the segmentation")
    runs: Runs = ()


class PolygonStroke(Event):
    """A closed polygon, its border included."""

    kind: Literal["polygon"]
    saying: Saying
    points: tuple[Point, ...] = Field(min_length=3, max_length=MAX_POINTS)


class BrushStroke(Event):
    """A line drawn with a round brush."""

    kind: Literal["brush"]
    saying: Saying
    points: tuple[Point, ...] = Field(min_length=1, max_length=MAX_POINTS)
    radius: float = Field(gt=0, le=MAX_RADIUS)


class Confirm(Event):
    """ "Right as it is": what was not said is as shown; ``runs`` are the pixels shown as road."""

    kind: Literal["right"]
    runs: Runs = ()


class Import(Event):
    """Labels from another program: the runs of each label, by its name."""

    kind: Literal["brought"]
    labels: dict[Label, Runs]


class Copy(Event):
    """ "Same as last frame": the road of an earlier picture is shown here; nothing is said by it.

    picture: whose it is. runs: its pixels. They become the person's own when the person confirms.
    """

    kind: Literal["copied"]
    picture: str = Field(default="", max_length=4096)
    runs: Runs = ()


class Review(Event):
    """A second person calls a confirmation right; it says nothing of the labels."""

    kind: Literal["reviewed"]
    of: Name
    by: Name


class Undo(Event):
    """Takes an event back. by: the second person who did it; None for the log's own."""

    kind: Literal["undo"]
    of: Name
    by: Name | None = None


class Redo(Event):
    """Does an event again that was taken back; ``by`` as there."""

    kind: Literal["redo"]
    of: Name
    by: Name | None = None


Stroke = SuperpixelStroke | PolygonStroke | BrushStroke
LastingEvent = Stroke | Confirm | Import | Copy | Review
AnyEvent = LastingEvent | Undo | Redo

_ADAPTER: pydantic.TypeAdapter[AnyEvent] = pydantic.TypeAdapter(
    Annotated[AnyEvent, Field(discriminator="kind")]
)


def parse_event(text: str | bytes, where: object) -> AnyEvent:
    """An event from its JSON; InputError naming ``where`` and the first thing that is wrong."""
    try:
        return _ADAPTER.validate_json(text)
    except pydantic.ValidationError as problem:
        what = f"is no event of a correction: {first_mistake(problem)}"
        raise InputError(where, what, "give one as docs/annotate.md has it") from None


# --- regions ----------------------------------------------------------------------------


def runs_of(mask: np.ndarray) -> tuple[int, ...]:
    """The runs of a mask bool (H,W)."""
    flat = np.concatenate([[False], mask.reshape(-1), [False]])
    edges = np.flatnonzero(flat[1:] != flat[:-1])
    starts, ends = edges[::2], edges[1::2]
    return tuple(np.stack([starts, ends - starts], 1).reshape(-1).tolist())


def mask_of(runs: Sequence[int], size: tuple[int, int]) -> np.ndarray:
    """The mask bool (H,W) of runs; InputError where they do not fit the picture, or overlap."""
    if len(runs) % 2:
        raise InputError("runs", "have an odd number of values", "give start, length, …")
    borders = np.array(runs, np.int64).reshape(-1, 2).cumsum(1).reshape(-1)
    lengths = np.diff(borders, prepend=0, append=size[0] * size[1])
    if (lengths < 0).any():
        what = f"overlap, or reach beyond {size[0] * size[1]} pixels"
        raise InputError("runs", what, "give those of this picture, in order")
    return np.repeat(np.arange(len(lengths)) % 2 == 1, lengths).reshape(size)


def stroke_mask(stroke: Stroke, size: tuple[int, int]) -> np.ndarray:
    """The mask bool (H,W) that a stroke speaks of; what is outside the picture is cut off."""
    if isinstance(stroke, SuperpixelStroke):
        return mask_of(stroke.runs, size)
    height, width = size
    points = np.array(stroke.points, np.float64)
    points = points.clip([-width, -height], [2 * width, 2 * height])
    canvas = np.zeros(size, np.uint8)
    if isinstance(stroke, PolygonStroke):
        fill_polygon(points, canvas, 1)
        return canvas > 0
    corners, radius = np.floor(points + 0.5).astype(np.int32), round(stroke.radius)
    cv2.polylines(canvas, [corners], isClosed=False, color=1, thickness=2 * radius + 1)
    for corner in (corners[0], corners[-1]):
        cv2.circle(canvas, (int(corner[0]), int(corner[1])), radius, 1, -1)
    return canvas > 0


# --- folding ----------------------------------------------------------------------------


def standing(events: Iterable[AnyEvent]) -> list[LastingEvent]:
    """The events that hold, in their order: each once, without those taken back."""
    kept: dict[str, LastingEvent] = {}
    undone: set[str] = set()
    for event in events:
        if isinstance(event, Undo):
            undone.add(event.of)
        elif isinstance(event, Redo):
            undone.discard(event.of)
        else:
            kept.setdefault(event.id, event)
    return [event for event in kept.values() if event.id not in undone]


def taken_back(events: Iterable[AnyEvent]) -> list[str]:
    """The events that can be done again: taken back last comes last, none after a new one."""
    stack: list[str] = []
    for event in events:
        stack = [one for one in stack if one != event.of] if isinstance(event, Undo | Redo) else []
        if isinstance(event, Undo):
            stack.append(event.of)
    return stack


def reviewers(events: Iterable[LastingEvent]) -> tuple[str, ...]:
    """Who called the work right since it was changed last, of the events that hold; sorted."""
    found: set[str] = set()
    for event in events:
        found = {*found, event.by} if isinstance(event, Review) else set()
    return tuple(sorted(found))


def apply_event(labels: np.ndarray, event: LastingEvent) -> None:
    """Change labels uint8 (H,W) in place as one event says; InputError for what does not fit."""
    size = (labels.shape[0], labels.shape[1])
    if isinstance(event, Confirm):
        road = mask_of(event.runs, size)
        for silent, other in (("untouched", "not_road"), ("horizontal", "not_road_horizontal")):
            where = labels == LABELS.index(silent)
            labels[where & road] = LABELS.index("road")
            labels[where & ~road] = LABELS.index(other)
    elif isinstance(event, Import):
        for name, runs in event.labels.items():
            labels[mask_of(runs, size)] = LABELS.index(name)
    elif isinstance(event, Copy):
        mask_of(event.runs, size)  # it has to fit, and says nothing
    elif not isinstance(event, Review):
        where = stroke_mask(event, size)
        labels[where] = after_saying(labels[where], event.saying)


def folded(events: Iterable[AnyEvent], size: tuple[int, int]) -> np.ndarray:
    """The labels uint8 (H,W) that all events of one person come to."""
    labels = np.zeros(size, np.uint8)
    for event in standing(events):
        apply_event(labels, event)
    return labels
