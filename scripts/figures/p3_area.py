"""P3, Figs. 1 to 4: streets, the steps, the seed area and its classifiers, how areas differ."""

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, pstdev
from typing import NamedTuple

import torch
from matplotlib.axes import Axes
from matplotlib.colors import PowerNorm
from torch import Tensor

from roadtorch.base.image import read_image, tint_mask, to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, subsample_dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.report.montage import apply_colormap
from roadtorch.evaluation.uncertainty import mean_interval
from roadtorch.imaging.color import REPRESENTATIONS, color_plane, color_planes
from roadtorch.oneclass import CLASSIFIERS, FittedClassifier, fit, make_axes
from roadtorch.oneclass.samples import AllSampleSettings, SampleSettings, road_samples, sample_area
from scripts.figures.chart import chart, show_table
from scripts.figures.sheets import write_sheet

CONDITIONS = {
    "sun and shade": "udadv_test5.jpg",
    "overcast": "driveai_us_019.jpg",
    "cobbles": "lund_0006.jpg",
    "shadows": "dnit_br_008.jpg",
    "rain": "pothole8_009.jpg",
    "country": "rseg_0125.jpg",
    "village": "rddmix_0025.jpg",
    "night": "brno_0035.jpg",
}
"""Free images of unlabelled_free/, by what is difficult in them."""

STREET = CONDITIONS["overcast"]
PLANES = REPRESENTATIONS["nrng"]
SETS = {"camvid": "camvid", "idd-lite": "idd_lite", "folder": "many"}
"""By name of the set: its folder in the data."""

IMAGES = 36  # of a set, for the measures
RED = (1.0, 0.0, 0.0)
BLUE, ORANGE, BORDER = "#0072b2", "#e69f00", "#d55e00"
TILE = 150, 100


def read_free(data: Path, name: str) -> Tensor:
    """Read an image (3, H, W) of unlabelled_free/."""
    return read_image(data / "unlabelled_free" / name)


def frame_area(image: Tensor) -> Tensor:
    """Return a copy of an image (3, H, W) with the seed area in a red frame."""
    rows, columns = sample_area(image.shape)
    line = max(1, round(image.shape[1] / 120))
    frame = torch.zeros(image.shape[1:], dtype=torch.bool)
    frame[rows, columns] = True
    inside = (slice(rows.start + line, rows.stop - line),)
    frame[(*inside, slice(columns.start + line, columns.stop - line))] = False
    return torch.where(frame, torch.tensor(RED)[:, None, None], image)


def fig1(data: Path, out: Path) -> None:
    """Write P3's Fig. 1: streets under changing conditions."""
    names = list(CONDITIONS)
    rows = {
        ", ".join(part): [to_pixels(read_free(data, CONDITIONS[name])) for name in part]
        for part in (names[:4], names[4:])
    }
    write_sheet(out / "p3-fig1.jpg", rows, TILE)


def fig2(data: Path, out: Path) -> None:
    """Write P3's Fig. 2: the steps, for one Gaussian in hue and saturation."""
    image = read_free(data, STREET)
    detection = load_detector("oneclass:gaussian:HS").detect(image)
    row = [
        to_pixels(frame_area(image)),
        *(apply_colormap(color_plane(image, name)) for name in "HS"),
        apply_colormap(detection.likelihood),
        tint_mask(to_pixels(image), detection.mask.numpy()),
    ]
    caption = "input, seed area; hue; saturation; likelihood of one Gaussian; its mask"
    write_sheet(out / "p3-fig2.jpg", {caption: row}, TILE)


# --- Fig. 3 -----------------------------------------------------------------------------

GRID = 160  # points along each side of a panel
MAX_POINTS = 1500  # pixels of each kind in a scatter plot
MARGIN = 0.02  # of nr and ng around the pixels shown

LEARNED = {
    "e) Gaussian": ("gaussian", AllSampleSettings()),
    "f) mixture of 2": ("mog2", AllSampleSettings()),
    "g) SVDD": ("svdd", SampleSettings()),
    "h) k-centres": ("kcentres", SampleSettings()),
    "i) k-means": ("kmeans", SampleSettings()),
    "j) dLP": ("dlp", SampleSettings()),
}
"""Panels of Fig. 3: the classifier, and whether it learns from all pixels or from superpixels."""


class Window(NamedTuple):
    """Part of the plane (nr, ng)."""

    left: float
    right: float
    bottom: float
    top: float


def central_window(values: Tensor) -> Window:
    """Return where the central 98 % of values (2, n) lie, with a margin."""
    low, high = torch.quantile(values, torch.tensor([0.01, 0.99]), dim=1)
    (left, bottom), (right, top) = (low - MARGIN).tolist(), (high + MARGIN).tolist()
    return Window(left, right, bottom, top)


def likelihood_map(fitted: FittedClassifier, window: Window, steps: int = GRID) -> Tensor:
    """Return the likelihood of every point of a window, (steps, steps), rows by ng."""
    across = torch.linspace(window.left, window.right, steps)
    up = torch.linspace(window.bottom, window.top, steps)
    points = torch.cartesian_prod(up, across).flip(1)
    return fitted.likelihood(points).view(steps, steps)


def variance_ratio(image: Tensor) -> float:
    """Return the variance of superpixels' samples over that of the area's pixels, in (nr, ng)."""
    few, every = (
        road_samples(image, PLANES, settings)
        for settings in (SampleSettings(), AllSampleSettings())
    )
    return float(few.var(0).sum() / every.var(0).sum())


def thin(values: Tensor) -> Tensor:
    """Return at most ``MAX_POINTS`` of the columns of (2, n), evenly spaced."""
    return values[:, :: max(1, values.shape[1] // MAX_POINTS)]


def draw_points(axes: Axes, values: Tensor, colour: str) -> None:
    """Draw values (2, n) as points."""
    axes.plot(*thin(values).numpy(), ".", markersize=1, color=colour, alpha=0.5)


def draw_classifier(axes: Axes, title: str, image: Tensor, window: Window) -> None:
    """Draw the likelihood of a panel of ``LEARNED``, its boundary and its samples."""
    name, settings = LEARNED[title]
    samples = road_samples(image, PLANES, settings)
    values = likelihood_map(fit(CLASSIFIERS[name], samples, make_axes(PLANES)), window)
    place = {"origin": "lower", "extent": window}
    axes.imshow(values.numpy(), cmap="Greys", vmin=0, vmax=1, aspect="auto", **place)
    axes.contour(values.numpy(), [0.5], colors=BORDER, linewidths=1.4, **place)
    draw_points(axes, samples.T, BLUE)


def draw_fig3(path: Path, image: Tensor, road: Tensor) -> None:
    """Draw panels b to j of an image: road blue, the rest orange; from d on, the seed area near.

    Darker is likelier; the line is the boundary, at 0.5.
    """
    values = color_planes(image, PLANES)
    area = road_samples(image, PLANES, AllSampleSettings()).T
    wide, near = central_window(values.flatten(1)), central_window(area)
    with chart(path, 6.4, 5.2) as figure:
        panels = figure.subplots(3, 3)
        draw_points(panels[0, 0], values[:, ~road], ORANGE)
        draw_points(panels[0, 0], values[:, road], BLUE)
        draw_points(panels[0, 1], area, BLUE)
        bounds, shades = (near[:2], near[2:]), {"cmap": "Greys", "norm": PowerNorm(0.4)}
        panels[0, 2].hist2d(*area.numpy(), bins=32, range=bounds, **shades)
        for axes, title in zip(panels[1:].flat, LEARNED, strict=True):
            draw_classifier(axes, title, image, near)
        titles = ("b) road and background", "c) seed area", "d) its joint histogram", *LEARNED)
        for place, (axes, title) in enumerate(zip(panels.flat, titles, strict=True)):
            window = wide if place < 2 else near
            axes.set(xlim=window[:2], ylim=window[2:], title=title)
            axes.grid(visible=place < 2)
            axes.locator_params(nbins=4)
        panels[2, 1].set_xlabel("nr")
        panels[1, 0].set_ylabel("ng")


def fig3(data: Path, out: Path) -> None:
    """Write P3's Fig. 3: the seed area of a free image in (nr, ng), and six classifiers of it.

    Road and background are by `fusion`. The table measures on CamVid how much of the pixels'
    variance the superpixels' medians keep.
    """
    image = read_free(data, STREET)
    write_sheet(out / "p3-fig3a.jpg", {"a)": [to_pixels(frame_area(image))]}, (300, 170))
    draw_fig3(out / "p3-fig3.png", image, load_detector("fusion").detect(image).mask)
    few = subsample_dataset(open_dataset("camvid", data / "camvid"), IMAGES)
    ratios = [variance_ratio(few.read(item)[0]) for item in few.items]
    low, high = mean_interval(torch.tensor(ratios))
    row = {"images": len(ratios), "variance ratios": fmean(ratios), "low": low, "high": high}
    show_table(out / "p3-fig3.csv", [row])


# --- Fig. 4 -----------------------------------------------------------------------------

SHOWN = ("overcast", "cobbles", "shadows", "country", "night")
BINS = 64  # of grey
WHOLE = 0.99  # fraction of an area from which it counts as road


class AreaMeasures(NamedTuple):
    """Mean and deviation of a seed area's grey, and the fraction of it that is road."""

    mean: float
    deviation: float
    road: float


def area_grey(image: Tensor) -> Tensor:
    """Return the grey of the seed area of an image (3, H, W): (n,)."""
    return color_plane(image, "grey")[sample_area(image.shape)].flatten()


def measure_areas(dataset: Dataset, items: Sequence[LabelledItem]) -> list[AreaMeasures]:
    """Measure the seed areas of some items."""
    areas = []
    for item in items:
        image, truth = dataset.read(item)
        grey, road = area_grey(image), truth.road[sample_area(image.shape)]
        areas.append(
            AreaMeasures(float(grey.mean()), float(grey.std()), float(road.double().mean()))
        )
    return areas


def area_row(name: str, areas: Sequence[AreaMeasures]) -> dict[str, object]:
    """Return how the areas of some images differ, and how often they are road."""
    means = [area.mean for area in areas]
    return {
        "images of": name,
        "n": len(areas),
        "mean grey": fmean(means),
        "between images": pstdev(means),
        "inside an image": fmean(area.deviation for area in areas),
        "road in the area": fmean(area.road for area in areas),
        "all road": fmean(area.road >= WHOLE for area in areas),
    }


def fig4(data: Path, out: Path) -> None:
    """Write P3's Fig. 4: seed areas of free images and their grey; areas of labelled sets."""
    images = [read_free(data, CONDITIONS[name]) for name in SHOWN]
    sheet = {", ".join(SHOWN): [to_pixels(frame_area(image)) for image in images]}
    write_sheet(out / "p3-fig4.jpg", sheet, TILE)
    with chart(out / "p3-fig4.png", 7.5, 1.2) as figure:
        panels = figure.subplots(1, len(images), sharex=True)
        for axes, name, image in zip(panels, SHOWN, images, strict=True):
            axes.hist(area_grey(image).numpy(), bins=BINS, range=(0, 1), color="#7f7f7f")
            axes.set(title=name, yticks=[], xlim=(0, 1), xticks=[0, 0.5, 1])
    camvid, idd, many = (
        subsample_dataset(open_dataset(name, data / folder), 3 * IMAGES)
        for name, folder in SETS.items()
    )
    parts = [
        (name, camvid, [i for i in camvid.items if i.group == name]) for name in camvid.groups()
    ]
    parts += [("IDD", idd, idd.items), ("fourteen cameras", many, many.items)]
    rows = [area_row(name, measure_areas(dataset, items)) for name, dataset, items in parts]
    show_table(out / "p3-fig4.csv", rows)
