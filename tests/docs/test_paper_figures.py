"""Figures and tables on an image of each set, and the page that shows them."""

import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadtorch.testing.scenes import render_scene, write_image
from scripts.figures import FIGURES, __main__, p1, p1_stages, p3_area, p3_page, p3_table3, sheets
from tests.data.test_kitti import add_frame, street
from tests.streets import write_drives

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "research/figures.md").read_text("utf-8")
SHOWN = re.findall(r"^\*\*(P\d), .*`(p\d-\w+)`\.?$", PAGE, re.M)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder like that of the data, with an image of each drive and category."""
    root = tmp_path_factory.mktemp("data")
    write_drives(root)
    (root / "kitti_road/image_2").mkdir(parents=True)
    add_frame(root / "kitti_road", "um_000000", street())
    for name in {p1_stages.EXAMPLE, *p3_area.CONDITIONS.values(), *sheets.PHOTOS}:
        write_image(root / "unlabelled_free" / name, render_scene(1, 96, 128))
    for name in map(Path, sheets.LABELLED):
        write_labelled(root / "many" / name.parent, name.name, "road")
    for name in map(Path, sheets.RENDERED):
        write_labelled(root / "simulated" / name.parent, name.name, "road", "layout")
    write_labelled(root / "idd_lite", "a", "labels")
    return root


def write_labelled(folder: Path, stem: str, *labels: str) -> None:
    """Write a street and its labels: in the upper half 0, which is road in IDD, below 1."""
    write_image(folder / "images" / f"{stem}.png", render_scene(2, 48, 64))
    for kind in labels:
        (folder / kind).mkdir(parents=True, exist_ok=True)
        halves = np.repeat([0, 1], 24)[:, None].repeat(64, 1)
        cv2.imwrite(str(folder / kind / f"{stem}.png"), halves)


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduce the sets and detectors of the longest tables to one each."""
    monkeypatch.setattr(p1, "SETS", {"camvid": "camvid"})
    monkeypatch.setattr(p1_stages, "METHODS", ("ufl:original",))
    monkeypatch.setattr(sheets, "LABELLED", sheets.LABELLED[:1])
    monkeypatch.setattr(p1, "TABLE", ("ufl:paper",))
    monkeypatch.setattr(p1, "BENCHMARK", ("fusion:paper",))
    for module in (p1_stages, p3_area, p3_table3):
        monkeypatch.setattr(module, "IMAGES", 1)


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_writes_its_files(
    name: str, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "p3-fig7" and p3_page.CHROMIUM is None:
        pytest.skip("there is no Chromium (apt: chromium)")
    monkeypatch.setattr(sys, "argv", ["figures", name, str(data), "--out", str(tmp_path)])

    __main__.main()

    files = {path.name for path in tmp_path.iterdir()}
    assert {f"{name}{ending}" for ending in FIGURES[name].endings} <= files


def test_the_page_shows_every_figure_in_order() -> None:
    assert [name for _, name in SHOWN] == list(FIGURES)
    assert all(name.startswith(paper.lower()) for paper, name in SHOWN)


def test_images_of_the_page_are_small() -> None:
    images = [DOCS / "research" / image for image in re.findall(r"\]\((\.\./figures/.*?)\)", PAGE)]

    assert sum(path.stat().st_size for path in images) <= 1_200_000
