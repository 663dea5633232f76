"""P3, Figs. 3 and 4: the training area, what classifiers make of it, and how areas differ."""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, pstdev
from typing import NamedTuple

import torch
from matplotlib.axes import Axes as Panel
from torch import Tensor

from roadtorch.data.dataset import Dataset, Item, every_kth
from roadtorch.imaging.color import REPRESENTATIONS, plane, planes
from roadtorch.io.image import write_jpeg
from roadtorch.oneclass import CLASSIFIERS, Fitted, axes_of, fit
from roadtorch.oneclass.samples import (
    AllSampleSettings,
    SampleSettings,
    WideSeedArea,
    road_samples,
    sample_area,
)
from scripts.figures.chart import area_of, chart, open_sets, tell

PLANES = REPRESENTATIONS["nrng"]
GRID = 160  # points along each side of a panel
SHOWN = 1500  # pixels of each kind in a scatter
MARGIN = 0.02  # of nr and ng around the pixels shown
PICTURES = 36  # of a set, for the measures
RED = (1.0, 0.0, 0.0)
BINS = 64  # of grey
WHOLE = 0.99  # share of an area from which it counts as road

LEARNED = {
    "e) Gaussian": ("gaussian", AllSampleSettings()),
    "f) mixture of 2": ("mog2", AllSampleSettings()),
    "g) SVDD": ("svdd", SampleSettings()),
    "h) k-centres": ("kcentres", SampleSettings()),
    "i) k-means": ("kmeans", SampleSettings()),
    "j) dLP": ("dlp", SampleSettings()),
}
"""Fig. 3's panels: the classifier, and whether it learns from all pixels or from superpixels."""


# --- Fig. 3 -----------------------------------------------------------------------------


class Window(NamedTuple):
    """Part of the plane (nr, ng)."""

    left: float
    right: float
    bottom: float
    top: float


def window_of(values: Tensor) -> Window:
    """Where the middle 98 % of values (2,n) lie, with a margin."""
    low, high = torch.quantile(values, torch.tensor([0.01, 0.99]), dim=1)
    (left, bottom), (right, top) = (low - MARGIN).tolist(), (high + MARGIN).tolist()
    return Window(left, right, bottom, top)


def likelihood_map(fitted: Fitted, window: Window, steps: int = GRID) -> Tensor:
    """What a classifier of two planes says of every place in a window: (steps,steps), row = ng."""
    across = torch.linspace(window.left, window.right, steps)
    up = torch.linspace(window.bottom, window.top, steps)
    places = torch.cartesian_prod(up, across).flip(1)
    return fitted.likelihood(places).view(steps, steps)


def variance_kept(image: Tensor) -> float:
    """Total variance of the superpixels' samples over that of the area's pixels, in (nr, ng)."""
    few, every = (
        road_samples(image, PLANES, one) for one in (SampleSettings(), AllSampleSettings())
    )
    return float(few.var(0).sum() / every.var(0).sum())


def marked(image: Tensor) -> Tensor:
    """The image (3,H,W) with the training area in a red frame, a copy."""
    rows, columns = sample_area(image.shape, WideSeedArea())
    frame = torch.zeros(image.shape[1:], dtype=torch.bool)
    frame[rows, columns] = True
    frame[rows.start + 2 : rows.stop - 2, columns.start + 2 : columns.stop - 2] = False
    return torch.where(frame, torch.tensor(RED)[:, None, None], image)


def _some(values: Tensor) -> Tensor:
    """At most ``SHOWN`` of the columns of (2,n), evenly."""
    return values[:, :: max(1, values.shape[1] // SHOWN)]


def _scatter(panel: Panel, title: str, parts: Sequence[tuple[Tensor, str]]) -> None:
    panel.set_title(title)
    for values, colour in parts:
        panel.plot(*_some(values).numpy(), ".", markersize=1, color=colour, alpha=0.5)


def _learned(panel: Panel, title: str, image: Tensor, window: Window) -> None:
    name, reduction = LEARNED[title]
    samples = road_samples(image, PLANES, reduction)
    found = likelihood_map(fit(CLASSIFIERS[name], samples, axes_of(PLANES)), window)
    panel.set_title(title)
    panel.imshow(found, origin="lower", extent=window, cmap="Greys", vmin=0, vmax=1, aspect="auto")
    panel.contour(found, [0.5], origin="lower", extent=window, colors="#d55e00", linewidths=1.4)
    panel.plot(*_some(samples.T).numpy(), ".", markersize=1, color="#0072b2")


def draw_fig3(path: Path, image: Tensor, road: Tensor, valid: Tensor) -> None:
    """Panels b to j of one picture: road blue, the rest orange; from d on, the training area near.

    Darker is likelier; the line is the boundary, at 0.5.
    """
    values = planes(image, PLANES)
    every = road_samples(image, PLANES, AllSampleSettings()).T
    wide, near = window_of(values.flatten(1)), window_of(every)
    with chart(path, 6.4, 5.4) as figure:
        panels = figure.subplots(3, 3)
        both = [(values[:, valid & ~road], "#e69f00"), (values[:, road], "#0072b2")]
        _scatter(panels[0, 0], "b) road and background", both)
        _scatter(panels[0, 1], "c) training area", [(every, "#0072b2")])
        panels[0, 2].set_title("d) its joint histogram")
        panels[0, 2].hist2d(*every.numpy(), bins=48, range=(near[:2], near[2:]), cmap="Greys")
        for panel, title in zip(panels[1:].flat, LEARNED, strict=True):
            _learned(panel, title, image, near)
        for place, panel in enumerate(panels.flat):
            window = wide if place < 2 else near
            panel.set(xlim=window[:2], ylim=window[2:])
            panel.grid(visible=place < 2)
            panel.locator_params(nbins=4)
        panels[2, 1].set_xlabel("nr")
        panels[1, 0].set_ylabel("ng")


def fig3(data: Path, out: Path) -> None:
    """P3, Fig. 3: one picture's training area in (nr, ng), and what six classifiers make of it."""
    (camvid,) = open_sets(data, "camvid")
    image, truth = camvid.read(camvid.items[-1])
    write_jpeg(out / "p3-fig3a.jpg", marked(image))
    draw_fig3(out / "p3-fig3.png", image, truth.road, truth.valid)
    rows = [
        {
            "panel": title,
            "samples": len(road_samples(image, PLANES, reduction)),
            "auc": area_of(
                f"oneclass:{name}:nrng", image, truth.road, truth.valid,
                samples={"reduction": reduction.reduction},
            ),
        }
        for title, (name, reduction) in LEARNED.items()
    ]  # fmt: skip
    tell(out / "p3-fig3.csv", ("panel", "samples", "auc"), rows)
    few = every_kth(camvid, PICTURES)
    kept = [variance_kept(few.read(item)[0]) for item in few.items]
    print(f"\nVariance of superpixels' medians over that of pixels, {len(kept)} pictures:")
    print(f"mean {fmean(kept):.2f}, from {min(kept):.2f} to {max(kept):.2f}")


# --- Fig. 4 -----------------------------------------------------------------------------


class Area(NamedTuple):
    """Of a training area: mean and standard deviation of its grey, share of it that is road."""

    mean: float
    deviation: float
    road: float


def area_grey(image: Tensor) -> Tensor:
    """The grey of the training area of an image (3,H,W): (n,)."""
    return plane(image, "grey")[sample_area(image.shape, WideSeedArea())].flatten()


def area_measures(image: Tensor, road: Tensor) -> Area:
    """What Fig. 4 shows of one picture."""
    grey = area_grey(image)
    inside = road[sample_area(image.shape, WideSeedArea())]
    return Area(float(grey.mean()), float(grey.std()), float(inside.double().mean()))


def set_row(name: str, areas: Sequence[Area]) -> dict[str, object]:
    """How the areas of some pictures differ, and how often they are road."""
    means = [one.mean for one in areas]
    return {
        "pictures of": name,
        "n": len(areas),
        "mean grey": fmean(means),
        "between pictures": pstdev(means),
        "inside a picture": fmean(one.deviation for one in areas),
        "road in the area": fmean(one.road for one in areas),
        "all road": fmean(one.road >= WHOLE for one in areas),
    }


def conditions_of(dataset: Dataset) -> dict[str, Item]:
    """The first picture of each condition that has no other; by the condition."""
    alone = [item for item in dataset.items if len(item.conditions) == 1]
    return {item.conditions[0]: item for item in reversed(alone)}


def _read_areas(dataset: Dataset, items: Sequence[Item]) -> list[Area]:
    read = (dataset.read(item) for item in items)
    return [area_measures(image, truth.road) for image, truth in read]


def fig4(data: Path, out: Path) -> None:
    """P3, Fig. 4: the grey of training areas under different conditions."""
    sets = open_sets(data, "camvid", "idd-lite", "folder")
    camvid, idd, many = (every_kth(one, PICTURES * 3) for one in sets)
    chosen = {"CamVid, dusk": (camvid, camvid.items[0]), "CamVid, day": (camvid, camvid.items[-1])}
    chosen |= {name: (many, item) for name, item in conditions_of(many).items()}
    with chart(out / "p3-fig4.png", 6.4, 2.0) as figure:
        for panel, (title, (dataset, item)) in zip(
            figure.subplots(1, len(chosen), sharex=True), chosen.items(), strict=True
        ):
            image, _ = dataset.read(item)
            write_jpeg(out / f"p3-fig4-{title.replace(', ', '-')}.jpg", marked(image))
            panel.hist(area_grey(image).numpy(), bins=BINS, range=(0, 1), color="#7f7f7f")
            panel.set(title=title, yticks=[], xlim=(0, 1), xticks=[0, 0.5, 1])
        figure.supxlabel("grey", fontsize=8)
    rows = [
        set_row(name, _read_areas(camvid, [one for one in camvid.items if one.group == name]))
        for name in camvid.groups()
    ]
    rows += [set_row("IDD", _read_areas(idd, idd.items))]
    rows += [set_row("many cameras", _read_areas(many, many.items))]
    tell(out / "p3-fig4.csv", tuple(rows[0]), rows)
