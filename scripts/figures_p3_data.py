"""P3, Figs. 5 to 7: how much of a picture is road, groups by it, and how truth is drawn."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.data.annotations import read_annotation
from roadtorch.data.dataset import Dataset, Item, every_kth
from roadtorch.data.labelme import AGREEMENTS, PolygonLabels, open_labelme
from roadtorch.data.polygons import Polygon
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.metrics import count_mask, iou
from roadtorch.io.atomic import atomic
from roadtorch.io.image import read_image, tint_mask, to_pixels, write_colours, write_jpeg
from roadtorch.scenes.street import render_scene
from scripts.figures_p3_chart import chart, open_sets, tell
from scripts.figures_p3_table3 import HUBER, measured

GROUPS = {"at most 30 %": 0.30, "30 to 45 %": 0.45, "45 to 55 %": 0.55, "more than 55 %": 1.0}
"""P3's groups of Fig. 6 by their upper bound, which belongs to the group."""

STEP = 5  # per cent of a histogram's bar
PICTURES = 60  # of a set, where detectors look at them
TILES = 4  # pictures of a group on the sheet
TILE = (160, 120)  # width and height in pixels
CELLS: Mapping[str, Mapping[str, Any]] = {
    "gaussian:RGB": {},
    "gaussian:HS": {},
    "robust_gaussian:RGB": HUBER,
    "mog2:HSV": {},
    "nn:HSV": {},
}
"""The cells whose AUC is told by group, with their settings."""


class Share(NamedTuple):
    """A picture and the share of it that is road."""

    item: Item
    road: float


# --- Fig. 5 -----------------------------------------------------------------------------


def road_share_of(dataset: Dataset) -> list[Share]:
    """The share of road among all pixels of each picture of a set, void ones too."""
    return [Share(item, float(dataset.truth(item).road.double().mean())) for item in dataset.items]


def group_of(share: float) -> str:
    """P3's group for a share of road."""
    return next(name for name, most in GROUPS.items() if share <= most)


def share_row(name: str, shares: Sequence[float]) -> dict[str, object]:
    """How many pictures a set has, what of them is road, and how many are in each group."""
    counts = {group: sum(group_of(one) == group for one in shares) for group in GROUPS}
    centre = {"mean": 100 * fmean(shares), "median": 100 * median(shares)}
    return {"set": name, "pictures": len(shares), **centre, **counts}


def fig5(data: Path, out: Path) -> None:
    """P3, Fig. 5: how many pictures have how much road, set by set."""
    sets = open_sets(data, "camvid", "idd-lite", "folder")
    found = {one.name: [share.road for share in road_share_of(one)] for one in sets}
    with chart(out / "p3-fig5.png", 6.4, 1.9) as figure:
        for panel, (name, shares) in zip(
            figure.subplots(1, len(found), sharex=True), found.items(), strict=True
        ):
            edges = range(0, 105, STEP)
            panel.hist([100 * one for one in shares], bins=list(edges), color="#0072b2")
            panel.axvline(100 * fmean(shares), color="#d55e00", linewidth=1)
            panel.set(title=f"{name}, {len(shares)} pictures", xlabel="% of the picture is road")
    rows = [share_row(name, shares) for name, shares in found.items()]
    tell(out / "p3-fig5.csv", tuple(rows[0]), rows)


# --- Fig. 6 -----------------------------------------------------------------------------


def by_group(shares: Sequence[Share]) -> dict[str, list[Item]]:
    """The items of P3's groups; groups without any are left out."""
    found: dict[str, list[Item]] = {}
    for share in sorted(shares, key=lambda one: one.road):
        found.setdefault(group_of(share.road), []).append(share.item)
    return found


def group_sheet(dataset: Dataset, groups: Mapping[str, Sequence[Item]]) -> Tensor:
    """A row of tiles for each group, road tinted: (3,H,W)."""
    rows = []
    for items in groups.values():
        some = [items[int((place + 0.5) * len(items) / TILES)] for place in range(TILES)]
        read = (dataset.read(item) for item in some)
        tiles = [tint_mask(to_pixels(image), truth.road.numpy()) for image, truth in read]
        rows.append(
            np.hstack([cv2.resize(one, TILE, interpolation=cv2.INTER_AREA) for one in tiles])
        )
    return torch.from_numpy(np.vstack(rows)).permute(2, 0, 1) / 255


def group_rows(
    dataset: Dataset, groups: Mapping[str, Sequence[Item]]
) -> Iterator[dict[str, object]]:
    """By group, the mean AUC of its pictures in percent for each of ``CELLS``."""
    detectors = {
        name: load_detector(f"oneclass:{name}", **settings) for name, settings in CELLS.items()
    }
    for name, items in groups.items():
        few = every_kth(replace(dataset, items=tuple(items)), PICTURES // len(groups))
        cells = measured(few, detectors)
        areas = {
            key: 100 * float(torch.cat([one.areas for one in drives.values()]).mean())
            for key, drives in cells.items()
        }
        sizes = {"pictures": len(items), "seen": len(few.items)}
        yield {"set": dataset.name, "group": name, **sizes, **areas}


def fig6(data: Path, out: Path) -> None:
    """P3, Fig. 6: pictures in P3's groups by their share of road, and AUC group by group."""
    rows: list[dict[str, object]] = []
    for dataset in open_sets(data, "camvid", "idd-lite"):
        groups = by_group(road_share_of(dataset))
        write_jpeg(out / f"p3-fig6-{dataset.name}.jpg", group_sheet(dataset, groups))
        rows += group_rows(dataset, groups)
    tell(out / "p3-fig6.csv", tuple(rows[0]), rows)


# --- Fig. 7 -----------------------------------------------------------------------------

PEOPLE = ("anna", "ben", "eva")
HAND = 2.0  # pixels by which a corner is drawn amiss
CORNERS = 1.5  # pixels that an outline may be simplified by
SIZE = (120, 160)
INKS = ("#0072b2", "#d55e00", "#009e73")


def outlines(road: Tensor) -> list[np.ndarray]:
    """The outlines of the parts of a mask bool (H,W), as corners (n,2) in pixels."""
    mask = road.numpy().astype(np.uint8)
    found, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    simple = [cv2.approxPolyDP(one, CORNERS, closed=True)[:, 0] for one in found]
    return [one for one in simple if len(one) > 2]


def annotation_xml(blobs: Mapping[str, Sequence[np.ndarray]], size: tuple[int, int]) -> bytes:
    """LabelMe's XML: one object "road" a person, one polygon a blob (P3, section IV)."""
    root = Element("annotation")
    sizes = SubElement(root, "imagesize")
    for tag, value in zip(("nrows", "ncols"), size, strict=True):
        SubElement(sizes, tag).text = str(value)
    for person, polygons in blobs.items():
        drawn = SubElement(root, "object")
        SubElement(drawn, "name").text = "road"
        for corners in polygons:
            polygon = SubElement(drawn, "polygon")
            SubElement(polygon, "username").text = person
            for x, y in corners:
                point = SubElement(polygon, "pt")
                SubElement(point, "x").text, SubElement(point, "y").text = f"{x:.1f}", f"{y:.1f}"
    return tostring(root)


def write_annotated(folder: Path, seed: int) -> Tensor:
    """A rendered street and what three people drew on it; returns the exact road bool (H,W)."""
    scene = render_scene(seed, *SIZE)
    generator = np.random.default_rng(seed)
    blobs = {
        person: [one + generator.normal(0, HAND, one.shape) for one in outlines(scene.road)]
        for person in PEOPLE
    }
    write_colours(folder / "street.png", scene.image)
    with atomic(folder / "street.xml") as temporary:
        temporary.write_bytes(annotation_xml(blobs, SIZE))
    return scene.road


def agreement_rows(folder: Path, road: Tensor) -> list[dict[str, object]]:
    """Intersection over union with the exact road: each person alone, then what they agree on."""
    every = torch.ones_like(road)

    def row(who: str, drawn: Tensor) -> dict[str, object]:
        return {"truth": who, "iou": float(iou(count_mask(drawn, road, every)))}

    alone = [PolygonLabels(user=person) for person in PEOPLE]
    together = [PolygonLabels(agreement=how) for how in AGREEMENTS]
    (item,) = open_labelme(folder, "all").items
    rows = [row(str(one.user), one.truth(item).road) for one in alone]
    return [*rows, *(row(one.agreement, one.truth(item).road) for one in together)]


def draw_annotated(folder: Path, path: Path) -> None:
    """The picture with everybody's blobs, and what most say is road."""
    (item,) = open_labelme(folder, "all").items
    image, truth = read_image(item.image), PolygonLabels().truth(item)
    with chart(path, 6.4, 2.5) as figure:
        left, right = figure.subplots(1, 2)
        left.imshow(to_pixels(image))
        for drawing in read_annotation(item.label).drawings:
            if isinstance(drawing.shape, Polygon):
                corners = np.array([*drawing.shape.points, drawing.shape.points[0]])
                ink = INKS[PEOPLE.index(drawing.user)]
                left.plot(*corners.T, color=ink, linewidth=1)
        left.set_title(f"drawn by {', '.join(PEOPLE)}")
        right.imshow(tint_mask(to_pixels(image), truth.road.numpy()))
        right.set_title("what most of them say")
        for panel in (left, right):
            panel.set_axis_off()


def fig7(data: Path, out: Path) -> None:
    """P3, Fig. 7: an annotation file of several people and blobs, read as truth."""
    folder = out / "p3-fig7"
    folder.mkdir(exist_ok=True)
    road = write_annotated(folder, 3)
    tell(out / "p3-fig7.csv", ("truth", "iou"), agreement_rows(folder, road))
    draw_annotated(folder, out / "p3-fig7.png")


FIGURES: Mapping[str, Callable[[Path, Path], None]] = {
    "p3-fig5": fig5,
    "p3-fig6": fig6,
    "p3-fig7": fig7,
}
