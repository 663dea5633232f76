"""P3, Figs. 5 to 7: how much of an image is road, groups by it, and the page for labels."""

import shutil
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import fmean, median

from PIL import Image

from roadtorch.base.atomic import atomic_write
from roadtorch.base.errors import ConfigError
from roadtorch.base.image import tint_mask, to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, subsample_dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measures import AUC_MEAN
from scripts.figures.chart import COLOURS, chart, show_table
from scripts.figures.p3_area import SETS, STREET, TILE
from scripts.figures.sheets import write_sheet

GROUPS = {"at most 30 %": 0.30, "30 to 45 %": 0.45, "45 to 55 %": 0.55, "more than 55 %": 1.0}
"""P3's groups of Fig. 6 by their upper bound, which belongs to the group."""

FREE = ("comma10k", "dn_mcubes", "dn_cat")
"""Folders of many/ that are free for any use: MIT, MIT, CC BY 4.0."""

STEP = 5  # per cent of a histogram's bar
IMAGES = 60  # of a set, where detectors look at them
TILES = 4  # images of a group on the sheet
CELLS = ("gaussian:RGB", "gaussian:HS", "robust_gaussian:RGB:paper", "mog2:HSV:paper", "nn:HSV")
"""The cells whose AUC is shown by group, as P3 has them."""


def road_ratios(dataset: Dataset) -> list[tuple[LabelledItem, float]]:
    """Return the fraction of road among all pixels of each image of a set, void ones too."""
    return [(item, float(dataset.truth(item).road.double().mean())) for item in dataset.items]


def group_of(ratio: float) -> str:
    """Return P3's group for a fraction of road."""
    return next(name for name, most in GROUPS.items() if ratio <= most)


def fig5(data: Path, out: Path) -> None:
    """Write P3's Fig. 5: how many images have how much road, set by set."""
    rows: list[Mapping[str, object]] = []
    with chart(out / "p3-fig5.png", 6.4, 1.9) as figure:
        panels = figure.subplots(1, len(SETS), sharex=True)
        for axes, (name, folder) in zip(panels, SETS.items(), strict=True):
            ratios = [ratio for _, ratio in road_ratios(open_dataset(name, data / folder))]
            percents = [100 * ratio for ratio in ratios]
            axes.hist(percents, bins=list(range(0, 100 + STEP, STEP)), color="#0072b2")
            axes.axvline(fmean(percents), color="#d55e00", linewidth=1)
            axes.set(title=f"{folder}, {len(ratios)} images", xlabel="% of the image is road")
            counts = {group: sum(group_of(ratio) == group for ratio in ratios) for group in GROUPS}
            row = {"set": folder, "images": len(ratios), "mean": fmean(percents)}
            rows.append({**row, "median": median(percents), **counts})
    show_table(out / "p3-fig5.csv", rows)


# --- Fig. 6 -----------------------------------------------------------------------------


def by_group(ratios: Sequence[tuple[LabelledItem, float]]) -> dict[str, list[LabelledItem]]:
    """Return the items of P3's groups; groups without any are left out."""
    groups: dict[str, list[LabelledItem]] = {}
    for item, ratio in sorted(ratios, key=lambda pair: pair[1]):
        groups.setdefault(group_of(ratio), []).append(item)
    return groups


def group_row(dataset: Dataset, group: str, items: Sequence[LabelledItem]) -> dict[str, object]:
    """Return the mean AUC of some images in percent for each of ``CELLS``, with its interval."""
    alone = tuple(replace(item, group=None) for item in items)
    few = subsample_dataset(replace(dataset, items=alone), IMAGES // len(GROUPS))
    names = [f"oneclass:{cell}" for cell in CELLS]
    run = evaluate(few, names, with_baselines=False, measures=(AUC_MEAN,), quiet=False)
    row: dict[str, object] = {"set": dataset.name, "group": group, "images": len(few.items)}
    for cell, name in zip(CELLS, names, strict=True):
        scores = run.detectors[name]
        low, high = (100 * end for end in scores.intervals[AUC_MEAN.key])
        row[cell] = f"{100 * AUC_MEAN.get(scores.headline):.1f} ({low:.1f} to {high:.1f})"
    return row


def fig6(data: Path, out: Path) -> None:
    """Write P3's Fig. 6: free labelled images in P3's groups, and AUC group by group."""
    many = open_dataset("folder", data / "many")
    free = replace(many, items=tuple(item for item in many.items if item.group in FREE))
    rows = {}
    for group, items in by_group(road_ratios(free)).items():
        few = subsample_dataset(replace(free, items=tuple(items)), TILES)
        read = [few.read(item) for item in few.items]
        rows[group] = [tint_mask(to_pixels(image), truth.road.numpy()) for image, truth in read]
    write_sheet(out / "p3-fig6.jpg", rows, TILE)
    table = [
        group_row(dataset, group, items)
        for name in ("camvid", "idd-lite")
        for dataset in [open_dataset(name, data / SETS[name])]
        for group, items in by_group(road_ratios(dataset)).items()
    ]
    show_table(out / "p3-fig6.csv", table)


# --- Fig. 7 -----------------------------------------------------------------------------

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
PAGE_SIZE = 900, 560  # pixels, width and height


@contextmanager
def annotation_page(folder: Path) -> Iterator[str]:
    """Serve the page of `roadtorch annotate` for a folder, and yield its address."""
    from roadtorch.annotate.server import make_page_server
    from roadtorch.annotate.session import open_session

    out = folder / "corrections"
    out.mkdir()
    server = make_page_server(open_session(folder, out, load_detector("fusion")))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        yield server.address.url
    finally:
        server.stop()
        thread.join()


def fig7(data: Path, out: Path) -> None:
    """Write P3's Fig. 7: the page for labels, after a stroke on a free image.

    It needs Playwright and Chromium (apt: chromium).
    """
    if CHROMIUM is None:
        raise ConfigError("p3-fig7", "needs Chromium", "apt install chromium")
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        shutil.copy(data / "unlabelled_free" / STREET, folder)
        with annotation_page(Path(folder)) as address:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            page = browser.new_page()
            width, height = PAGE_SIZE
            page.set_viewport_size({"width": width, "height": height})
            page.goto(address)
            page.wait_for_selector("body[data-image]")
            page.get_by_text("Got it").click()
            box = page.locator("#stage").bounding_box()
            assert box is not None
            page.keyboard.press("2")
            page.mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.75 * box["height"])
            page.mouse.down()
            page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + 0.8 * box["height"], steps=9)
            page.mouse.up()
            page.wait_for_selector("body[data-version='1']")
            page.screenshot(path=str(Path(folder) / "page.png"))
            browser.close()
        few = Image.open(Path(folder) / "page.png").convert("RGB").quantize(COLOURS)
        with atomic_write(out / "p3-fig7.png") as temporary:
            few.save(temporary, format="PNG", optimize=True)
