"""The page on which two methods disagree: pictures side by side, the worst first."""

import statistics
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from roadtorch.base.atomic import csv_text, write_text
from roadtorch.base.image import read_image, tint_mask, to_pixels
from roadtorch.base.image_cache import image_cache
from roadtorch.data.dataset import LabelledItem
from roadtorch.evaluation.disagreement import Disagreements
from roadtorch.evaluation.report.montage import BLUE, TILE_WIDTH, VERMILLION, captioned, jpeg_uri
from roadtorch.evaluation.report.table import Cell, Table, page_text, percent

ON_SCREEN = 10  # pictures

SHARES = ("differs", "first", "second", "only_first", "only_second")

COLUMNS = (
    *("image", "differs", "road_first", "road_second", "only_first", "only_second", "iou"),
    "status",
)


def disagreement_text(seen: Disagreements) -> str:
    """The screen: how much differs in all, and the pictures that differ most."""
    return f"{_table(seen, ON_SCREEN).text()}\n\n{_summary(seen)}"


def _table(seen: Disagreements, most: int | None = None) -> Table:
    """The shares of each picture, or of the ``most`` first."""
    pictures = seen.pictures[:most]
    table = Table("picture", [picture.item.name for picture in pictures])
    first, second = (f"road {contender.name}" for contender in seen.methods)
    headers = ("differs", first, second, "only A", "only B")
    for header, key in zip(headers, SHARES, strict=True):
        shares = [getattr(picture, key) for picture in pictures]
        table.add(header, [Cell(percent(share)) for share in shares])
    return table


def _summary(seen: Disagreements) -> str:
    differs = [picture.differs for picture in seen.pictures]
    only_first = statistics.mean(picture.only_first for picture in seen.pictures)
    only_second = statistics.mean(picture.only_second for picture in seen.pictures)
    return (
        f"{len(differs)} pictures: {percent(statistics.mean(differs))} of the pixels differ, "
        f"median {percent(statistics.median(differs))}\n"
        f"only A: {percent(only_first)}, only B: {percent(only_second)} (means)"
    )


def write_disagreement(out: Path, seen: Disagreements, worst: int, command: str = "") -> None:
    """Write disagreement.html with the ``worst`` first pictures, and disagreement.csv with all."""
    rows: list[dict[str, str]] = []
    for picture in seen.pictures:
        shares = [f"{getattr(picture, key):.6f}" for key in (*SHARES, "iou")]
        rows.append(dict(zip(COLUMNS, [picture.item.name, *shares, "ok"], strict=True)))
    rows += [{"image": failure.image, "status": failure.reason} for failure in seen.failures]
    write_text(out / "disagreement.csv", csv_text(COLUMNS, rows))
    items = [picture.item for picture in seen.pictures[:worst]]
    caption = "only A blue, only B orange"
    sheets = both_sheets(seen, items, caption)
    values = {
        "seen": seen,
        "shown": list(zip(seen.pictures, sheets, strict=False)),
        "summary": _summary(seen),
        "table": _table(seen),
    }
    write_text(out / "disagreement.html", page_text("disagreement.html", command, values))


def both_sheets(seen: Disagreements, items: Iterable[LabelledItem], caption: str) -> list[str]:
    """For each item a JPEG for the page: the overlays of both, and what differs, so captioned."""
    looks = {contender.name: contender.prepare(seen.dataset) for contender in seen.methods}
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
        sheets.append(jpeg_uri(sheet))
    return sheets


def differing(pixels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Pixels uint8 (H,W,3), grey, with what one mask bool (H,W) alone has in blue or orange."""
    grey = np.repeat(pixels.mean(2, keepdims=True), 3, axis=2) * 0.7
    for mask, colour in ((first & ~second, BLUE), (second & ~first, VERMILLION)):
        grey[mask] = 0.35 * grey[mask] + 0.65 * np.array(colour)
    return grey.round().astype(np.uint8)
