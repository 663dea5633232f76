"""What a person can say about a pixel, and what several sayings come to.

A pixel has one of eight labels. Each means something for the road (road, not road, void) and for
the layout (sky, vertical, horizontal); what was not said stays open. Ours: the two questions are
asked with one set of keys, and what follows is drawn: road is horizontal, sky and vertical things
are not road.
"""

import numpy as np

from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL

NOT_ROAD, ROAD_SAID, VOID_SAID, OPEN = 0, 1, 254, 255
"""The values of ``road_layer``; ``OPEN`` is where nobody said anything."""

_MEANING = {
    "untouched": (OPEN, UNLABELLED),
    "road": (ROAD_SAID, HORIZONTAL),
    "not_road": (NOT_ROAD, UNLABELLED),
    "void": (VOID_SAID, UNLABELLED),
    "sky": (NOT_ROAD, SKY),
    "vertical": (NOT_ROAD, VERTICAL),
    "horizontal": (OPEN, HORIZONTAL),
    "not_road_horizontal": (NOT_ROAD, HORIZONTAL),
}

LABELS = tuple(_MEANING)
"""The names of the labels; a label's number is its place."""

SAYINGS = LABELS[1:7]
"""What a person says; the last label is what two sayings come to: a pavement, a verge."""

_ROAD, _LAYOUT = np.array(list(_MEANING.values()), np.uint8).T

# The label after a saying, by the label before. Road, void, sky and vertical replace what was
# there; "not road" leaves a layout that agrees with it, "horizontal" a road or a "not road".
_AFTER = {
    "road": (1,) * 8,
    "not_road": (2, 2, 2, 2, 4, 5, 7, 7),
    "void": (3,) * 8,
    "sky": (4,) * 8,
    "vertical": (5,) * 8,
    "horizontal": (6, 1, 7, 6, 6, 6, 6, 7),
}


def road_layer(labels: np.ndarray) -> np.ndarray:
    """uint8, of labels of any shape: 1 road, 0 not road, 254 void, 255 where nothing is said."""
    return _ROAD[labels]


def layout_layer(labels: np.ndarray) -> np.ndarray:
    """uint8, of labels of any shape: 0 sky, 1 vertical, 2 horizontal, 255 where not said."""
    return _LAYOUT[labels]


def after_saying(labels: np.ndarray, saying: str) -> np.ndarray:
    """The labels, uint8 of any shape, after one of ``SAYINGS`` was said about all of them."""
    return np.array(_AFTER[saying], np.uint8)[labels]
