"""Annotation events of one image, and the labels that they result in.

A pixel has one of eight labels. Each implies a value for the road (road, not road, void) and for
the layout (sky, vertical, horizontal), or leaves it open. Ours: one set of keys answers both
questions by inference: road is horizontal, and sky and vertical things are not road.

Positions are in pixels of the image, x to the right, y down, pixel centres at whole numbers.
Masks are COCO's counts: pixels outside and inside in turn, column by column.
"""

from collections.abc import Iterable
from typing import Annotated, Literal

import cv2
import numpy as np
import pydantic
from pydantic import Field

from roadtorch.base.documents import describe_validation_error
from roadtorch.base.errors import InputError
from roadtorch.base.settings import Settings
from roadtorch.data.polygons import decode_counts, fill_polygon
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

# --- labels -----------------------------------------------------------------------------

NOT_ROAD, ROAD_LABEL, VOID_LABEL, NO_ROAD_LABEL = 0, 1, 254, 255
"""Values of ``road_layer``; ``NO_ROAD_LABEL`` means that the road is not labelled."""

_LAYERS = {
    "untouched": (NO_ROAD_LABEL, UNLABELLED),
    "road": (ROAD_LABEL, HORIZONTAL),
    "not_road": (NOT_ROAD, UNLABELLED),
    "void": (VOID_LABEL, UNLABELLED),
    "sky": (NOT_ROAD, SKY),
    "vertical": (NOT_ROAD, VERTICAL),
    "horizontal": (NO_ROAD_LABEL, HORIZONTAL),
    "not_road_horizontal": (NOT_ROAD, HORIZONTAL),
}

LABEL_NAMES = tuple(_LAYERS)  # names of the labels; a label's number is its index

_ROAD, _LAYOUT = np.array(list(_LAYERS.values()), np.uint8).T

# Resulting label by previous label, for each label that a stroke applies; the last of
# ``LABEL_NAMES`` (a pavement, a verge) takes two strokes. Road, void, sky and vertical replace it;
# "not road" keeps a consistent layout, "horizontal" a road or a "not road".
_TRANSITIONS = {
    "road": (1,) * 8,
    "not_road": (2, 2, 2, 2, 4, 5, 7, 7),
    "void": (3,) * 8,
    "sky": (4,) * 8,
    "vertical": (5,) * 8,
    "horizontal": (6, 1, 7, 6, 6, 6, 6, 7),
}


def road_layer(labels: np.ndarray) -> np.ndarray:
    """Return 1 for road, 0 not road, 254 void, 255 unlabelled: uint8, of labels of any shape."""
    return _ROAD[labels]


def layout_layer(labels: np.ndarray) -> np.ndarray:
    """Return 0 for sky, 1 vertical, 2 horizontal, 255 unlabelled: uint8, of labels of any shape."""
    return _LAYOUT[labels]


def relabel(labels: np.ndarray, label: str) -> np.ndarray:
    """Return the labels, uint8 of any shape, after a stroke's label was applied to each."""
    return np.array(_TRANSITIONS[label], np.uint8)[labels]


# --- events -----------------------------------------------------------------------------

MAX_POINTS = 20_000  # points of a stroke; ours: drawn by hand, it has some hundreds
MAX_RADIUS = 2000  # radius of a brush, pixels
MAX_SECONDS = 600.0  # working time of one event; the page does not count idle minutes

_Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
_Point = tuple[_Coordinate, _Coordinate]
_EventId = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
_StrokeLabel = Literal["road", "not_road", "void", "sky", "vertical", "horizontal"]
_Index = Annotated[int, Field(ge=0, lt=2**31)]  # of a pixel or a superpixel
_Counts = tuple[_Index, ...]
_LabelName = Annotated[str, Field(pattern=f"^({'|'.join(LABEL_NAMES)})$")]


class Event(Settings):
    """One line of a log."""

    id: _EventId  # created in the browser; a repeated id is the same event, sent again
    time: float = Field(default=0.0, ge=0)  # seconds since 1970
    seconds: float = Field(default=0.0, ge=0, le=MAX_SECONDS)  # working time


class SuperpixelStroke(Event):
    """Superpixels clicked or dragged over; ``counts``: their pixels, valid for any segmentation."""

    kind: Literal["superpixel"]
    label: _StrokeLabel
    segments: tuple[_Index, ...]
    counts: _Counts = ()


class PolygonStroke(Event):
    """A closed polygon, including its border."""

    kind: Literal["polygon"]
    label: _StrokeLabel
    points: tuple[_Point, ...] = Field(min_length=3, max_length=MAX_POINTS)


class BrushStroke(Event):
    """A line drawn with a round brush."""

    kind: Literal["brush"]
    label: _StrokeLabel
    points: tuple[_Point, ...] = Field(min_length=1, max_length=MAX_POINTS)
    radius: float = Field(gt=0, le=MAX_RADIUS)


class Confirm(Event):
    """Confirmation of the remaining pixels as shown; ``counts`` are the pixels shown as road."""

    kind: Literal["confirm"]
    counts: _Counts = ()


class Import(Event):
    """Labels from another program: the counts of each label, by its name."""

    kind: Literal["import"]
    labels: dict[_LabelName, _Counts]


class Undo(Event):
    """Undo of the event with id ``of``."""

    kind: Literal["undo"]
    of: _EventId


class Redo(Event):
    """Redo of an undone event."""

    kind: Literal["redo"]
    of: _EventId


Stroke = SuperpixelStroke | PolygonStroke | BrushStroke
LabelEvent = Stroke | Confirm | Import
AnyEvent = LabelEvent | Undo | Redo

_ADAPTER: pydantic.TypeAdapter[AnyEvent] = pydantic.TypeAdapter(
    Annotated[AnyEvent, Field(discriminator="kind")]
)


def parse_event(text: str | bytes, where: object) -> AnyEvent:
    """Parse an event's JSON; InputError naming ``where`` and the first mistake."""
    try:
        return _ADAPTER.validate_json(text)
    except pydantic.ValidationError as error:
        message = f"is not a correction event: {describe_validation_error(error)}"
        raise InputError(where, message, "see the format in docs/annotate.md") from None


# --- regions ----------------------------------------------------------------------------


def stroke_mask(stroke: Stroke, size: tuple[int, int]) -> np.ndarray:
    """Return the mask bool (H, W) of a stroke, clipped to the image."""
    if isinstance(stroke, SuperpixelStroke):
        return decode_counts(stroke.counts, size)
    height, width = size
    points = np.array(stroke.points, np.float64)
    points = points.clip([-width, -height], [2 * width, 2 * height])
    if isinstance(stroke, PolygonStroke):
        return fill_polygon(points, size)
    canvas = np.zeros(size, np.uint8)
    corners, radius = np.floor(points + 0.5).astype(np.int32), round(stroke.radius)
    cv2.polylines(canvas, [corners], isClosed=False, color=1, thickness=2 * radius + 1)
    for corner in (corners[0], corners[-1]):
        cv2.circle(canvas, (int(corner[0]), int(corner[1])), radius, 1, -1)
    return canvas > 0


# --- replay -----------------------------------------------------------------------------


def effective_events(events: Iterable[AnyEvent]) -> list[LabelEvent]:
    """Return the events that were not undone, in order, each once."""
    by_id: dict[str, LabelEvent] = {}
    undone: set[str] = set()
    for event in events:
        if isinstance(event, Undo):
            undone.add(event.of)
        elif isinstance(event, Redo):
            undone.discard(event.of)
        else:
            by_id.setdefault(event.id, event)
    return [event for event in by_id.values() if event.id not in undone]


def redoable_ids(events: Iterable[AnyEvent]) -> list[str]:
    """Return the ids of the undone events, the latest last; empty after a new event."""
    stack: list[str] = []
    for event in events:
        target = event.of if isinstance(event, Undo | Redo) else None
        stack = [event_id for event_id in stack if event_id != target] if target else []
        if isinstance(event, Undo):
            stack.append(event.of)
    return stack


def count_clicks(events: Iterable[Event]) -> int:
    """Count the strokes, each once, including undone ones."""
    return len({event.id for event in events if isinstance(event, Stroke)})


def apply_event(labels: np.ndarray, event: LabelEvent) -> None:
    """Apply one event to labels uint8 (H, W) in place; InputError if it does not fit the image."""
    size = (labels.shape[0], labels.shape[1])
    try:
        match event:
            case Confirm():
                road = decode_counts(event.counts, size)
                for name, new in (("untouched", "not_road"), ("horizontal", "not_road_horizontal")):
                    is_open = labels == LABEL_NAMES.index(name)
                    labels[is_open & road] = LABEL_NAMES.index("road")
                    labels[is_open & ~road] = LABEL_NAMES.index(new)
            case Import():
                for name, counts in event.labels.items():
                    labels[decode_counts(counts, size)] = LABEL_NAMES.index(name)
            case SuperpixelStroke() | PolygonStroke() | BrushStroke():
                mask = stroke_mask(event, size)
                labels[mask] = relabel(labels[mask], event.label)
    except ValueError as error:
        raise InputError("counts", str(error), "give the counts of this image") from None


def replay(events: Iterable[AnyEvent], size: tuple[int, int]) -> np.ndarray:
    """Return the labels uint8 (H, W) after all events."""
    labels = np.zeros(size, np.uint8)
    for event in effective_events(events):
        apply_event(labels, event)
    return labels
