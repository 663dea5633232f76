"""The page on which two methods disagree: pictures side by side, the worst first."""

import base64
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from roadtorch.data.dataset import Dataset, Item
from roadtorch.evaluation.disagreement import Disagreement
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.result import Failure
from roadtorch.io.atomic import csv_text, write_text
from roadtorch.io.image import read_image, tint_mask, to_pixels
from roadtorch.report.montage import BLUE, TILE_WIDTH, VERMILLION, captioned
from roadtorch.report.screen import align
from roadtorch.report.templates import template
from roadtorch.runtime.image_cache import image_cache
from roadtorch.version import __version__

QUALITY = 80  # of JPEG

SHARES = ("differs", "first", "second", "only_first", "only_second")

COLUMNS = ("image", "differs", "road_first", "road_second", "only_first", "only_second", "status")


@dataclass(frozen=True)
class Disagreements:
    """Two methods on a set without labels. pictures: the worst first."""

    dataset: Dataset
    first: Method
    second: Method
    pictures: Sequence[Disagreement]
    failures: Sequence[Failure]


def disagreement_text(seen: Disagreements, most: int = 10) -> str:
    """The screen: how much differs in all, and the pictures that differ most."""
    first, second = seen.first.name, seen.second.name
    rows = [["picture", "differs", f"road {first}", f"road {second}", "only A", "only B"]]
    for one in seen.pictures[:most]:
        rows.append([one.item.name, *(_percent(getattr(one, share)) for share in SHARES)])
    differs = [one.differs for one in seen.pictures]
    lines = [
        f"{len(differs)} pictures: {_percent(statistics.mean(differs))} of the pixels differ, "
        f"median {_percent(statistics.median(differs))}",
        f"only A: {_percent(statistics.mean(one.only_first for one in seen.pictures))}, "
        f"only B: {_percent(statistics.mean(one.only_second for one in seen.pictures))} (means)",
    ]
    return "\n".join([align(rows), "", *lines])


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def write_disagreement(out: Path, seen: Disagreements, worst: int, command: str = "") -> None:
    """Write disagreement.html with the ``worst`` first pictures, and disagreement.csv with all."""
    rows: list[dict[str, str]] = []
    for one in seen.pictures:
        shares = [f"{getattr(one, share):.6f}" for share in SHARES]
        rows.append(dict(zip(COLUMNS, [one.item.name, *shares, "ok"], strict=True)))
    rows += [{"image": one.image, "status": one.reason} for one in seen.failures]
    write_text(out / "disagreement.csv", csv_text(COLUMNS, rows))
    items = [one.item for one in seen.pictures[:worst]]
    caption = "only A blue, only B orange"
    sheets = both_sheets(seen.dataset, (seen.first, seen.second), items, caption)
    page = template("disagreement.html").render(
        seen=seen,
        shown=list(zip(seen.pictures, sheets, strict=False)),
        percent=_percent,
        summary=disagreement_text(seen, 0).rsplit("\n\n", 1)[-1],
        version=__version__,
        command=command,
    )
    write_text(out / "disagreement.html", page)


def both_sheets(
    dataset: Dataset, methods: tuple[Method, Method], items: Iterable[Item], caption: str
) -> list[str]:
    """A JPEG in base64 for each item: the overlays of both, and what differs, so captioned."""
    looks = {one.name: one.prepare(dataset) for one in methods}
    sheets = []
    for item in items:
        image = read_image(item.image)
        with image_cache():
            masks = {name: look(image, item).mask.numpy() for name, look in looks.items()}
        pixels = to_pixels(image)
        tiles = {name: tint_mask(pixels, mask) for name, mask in masks.items()}
        tiles[caption] = differing(pixels, *masks.values())
        height = round(pixels.shape[0] * TILE_WIDTH / pixels.shape[1])
        sheet = np.concatenate([captioned(t, text, height) for text, t in tiles.items()], axis=1)
        options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
        encoded = cv2.imencode(".jpg", np.ascontiguousarray(sheet[..., ::-1]), options)[1]
        sheets.append(base64.b64encode(encoded.tobytes()).decode())
    return sheets


def differing(pixels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Pixels uint8 (H,W,3), grey, with what one mask bool (H,W) alone has in blue or orange."""
    grey = np.repeat(pixels.mean(2, keepdims=True), 3, axis=2) * 0.7
    for mask, colour in ((first & ~second, BLUE), (second & ~first, VERMILLION)):
        grey[mask] = 0.35 * grey[mask] + 0.65 * np.array(colour)
    return grey.round().astype(np.uint8)
