"""Filling a polygon with its outline, one pixel at a time."""

from fractions import Fraction

Point = tuple[int, int]


def edges(corners: list[Point]) -> list[tuple[Point, Point]]:
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def is_on(x: int, y: int, edge: tuple[Point, Point]) -> bool:
    (x1, y1), (x2, y2) = edge
    in_line = (x2 - x1) * (y - y1) == (y2 - y1) * (x - x1)
    return in_line and min(x1, x2) <= x <= max(x1, x2) and min(y1, y2) <= y <= max(y1, y2)


def contains(x: int, y: int, corners: list[Point]) -> bool:
    """Return whether a point is inside by the even-odd rule, or on the border."""
    if any(is_on(x, y, edge) for edge in edges(corners)):
        return True
    inside = False
    for (x1, y1), (x2, y2) in edges(corners):
        if (y1 > y) != (y2 > y) and x < x1 + Fraction((y - y1) * (x2 - x1), y2 - y1):
            inside = not inside
    return inside


def is_on_drawn_border(x: int, y: int, corners: list[Point]) -> bool:
    """Return whether a pixel is within half a pixel of an edge, across its longer axis."""
    for (x1, y1), (x2, y2) in edges(corners):
        if abs(x2 - x1) >= abs(y2 - y1) and x1 != x2 and min(x1, x2) <= x <= max(x1, x2):
            aside = y - (y1 + Fraction((x - x1) * (y2 - y1), x2 - x1))
        elif y1 != y2 and min(y1, y2) <= y <= max(y1, y2):
            aside = x - (x1 + Fraction((y - y1) * (x2 - x1), y2 - y1))
        else:
            continue
        if abs(aside) <= Fraction(1, 2) + Fraction(1, 1000):
            return True
    return False
