"""Colour planes of one pixel, by their definitions, in Python's floats."""

import colorsys
import math


def planes_of_pixel(red: float, green: float, blue: float) -> dict[str, float]:
    """Return all planes but Lab."""
    total = red + green + blue
    hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
    return {
        "R": red,
        "G": green,
        "B": blue,
        "nr": red / total if total else 1 / 3,
        "ng": green / total if total else 1 / 3,
        "O1": (red - green) / math.sqrt(2),
        "O2": (red + green - 2 * blue) / math.sqrt(6),
        "O3": total / math.sqrt(3),
        "H": hue,
        "S": saturation,
        "V": value,
        "grey": 0.299 * red + 0.587 * green + 0.114 * blue,
    }
