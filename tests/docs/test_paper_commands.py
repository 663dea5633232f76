"""Commands of figures and tables, on an image of each set, and the page that shows them."""

import re
import shlex
import sys
from pathlib import Path

import cv2
import pytest

from roadtorch.base.errors import DatasetError
from roadtorch.layout.patch_network import Topology
from roadtorch.testing.scenes import render_scene, write_image
from scripts.figures import (
    FIGURES,
    PaperFigure,
    __main__,
    p1,
    p2_topologies,
    p3_light,
    p3_table3,
    sheets,
)
from tests.command import Call
from tests.data.test_kitti import add_frame, street
from tests.streets import write_drives

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "research/figures.md").read_text("utf-8")
SHOWN = re.findall(r"^\*\*(P\d), .*`(p\d-\w+)`\.?$", PAGE, re.M)
COMMANDS = re.findall(
    r"^\| (P\d, .*) \| `(.*)` \|$", (DOCS / "research/index.md").read_text("utf-8"), re.M
)

WRITTEN = {
    "P1, Figs. 1 to 5": (
        *("equalised", "dictionary", "selected_maps", "best_map", "mean_map", "tree_levels"),
        *("error", "pixel_stability", "node_stability", "iteration_1", "mask", "overlay"),
    ),
    "P1, Fig. 6": ("metrics",),
    "P3, Fig. 2": ("mask",),
}
"""Names of a figure's files, or their ends."""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder like that of the data, with an image of each drive and category."""
    root = tmp_path_factory.mktemp("data")
    write_drives(root)
    (root / "kitti_road/image_2").mkdir(parents=True)
    add_frame(root / "kitti_road", "um_000000", street())
    write_image(root / "street.png", render_scene(1, 96, 128))
    write_free_streets(root)
    return root


def write_free_streets(root: Path) -> None:
    """Write the photos and the rendered streets of the sheets."""
    for name in sheets.PHOTOS:
        write_image(root / "unlabelled_free" / name, render_scene(1, 96, 128))
    for name in sheets.RENDERED:
        folder, _, stem = name.partition("/")
        scene = render_scene(2, 96, 128)
        write_image(root / "simulated" / folder / "images" / f"{stem}.png", scene)
        for part, labels in (("road", scene.road.byte()), ("layout", scene.layout)):
            (root / "simulated" / folder / part).mkdir(parents=True)
            path = root / "simulated" / folder / part / f"{stem}.png"
            cv2.imwrite(str(path), labels.byte().numpy())


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduce the sets and detectors of the longest tables to one each."""
    monkeypatch.setattr(p1, "SETS", {"camvid": ("camvid", 1)})
    monkeypatch.setattr(p1, "TABLE", ("ufl:paper",))
    monkeypatch.setattr(p1, "BENCHMARK", ("fusion:paper",))
    monkeypatch.setattr(p2_topologies, "IMAGES", "*.jpg")
    monkeypatch.setattr(p2_topologies, "TOPOLOGIES", {"CNN-7": Topology()})
    monkeypatch.setattr(p2_topologies, "SIZES", ((48, 64), (24, 32)))
    monkeypatch.setattr(p2_topologies, "ROUNDS", 1)
    monkeypatch.setattr(p3_light, "SCENES", 1)
    for module in (p3_light, p3_table3):
        monkeypatch.setattr(module, "IMAGES", 1)


@pytest.mark.parametrize(("figure", "command"), COMMANDS, ids=[figure for figure, _ in COMMANDS])
def test_the_command_of_a_figure_makes_it(
    figure: str, command: str, data: Path, tmp_path: Path, call: Call
) -> None:
    places = {"IMAGE": str(data / "street.png"), "OUT": str(tmp_path / "out")}
    words = [places.get(word, word.replace("DATA", str(data))) for word in shlex.split(command)]

    assert call(*words[1:]).exit_code == 0

    stems = {path.stem for path in (tmp_path / "out").rglob("*") if path.is_file()}
    for name in WRITTEN[figure.partition(":")[0]]:
        assert any(stem.split(".")[-1] == name for stem in stems), (name, stems)


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_writes_its_files(
    name: str, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["figures", name, str(data), "--out", str(tmp_path)])

    __main__.main()

    files = {path.name for path in tmp_path.iterdir()}
    assert {f"{name}{ending}" for ending in FIGURES[name].endings} <= files


def test_all_skips_figures_that_exist_and_goes_on_after_one_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(data: Path, out: Path) -> None:
        raise DatasetError(data / "camvid", "is missing", "get it")

    def write(data: Path, out: Path) -> None:
        (out / "p3-fig8.png").touch()

    (tmp_path / "p1-table1.csv").touch()
    figures = {
        "p1-table1": PaperFigure(fail, (".csv",)),
        "p2-fig4b": PaperFigure(fail, (".csv",)),
        "p3-fig8": PaperFigure(write, (".png",)),
    }
    monkeypatch.setattr(__main__, "FIGURES", figures)

    failed = __main__.make_all(Path("data"), tmp_path)

    assert failed == ["p2-fig4b"]
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[1] for line in lines] == ["exists", "failed:", "made"]
    assert (tmp_path / "p3-fig8.png").exists()


def test_the_page_shows_every_figure_in_order() -> None:
    assert [name for _, name in SHOWN] == list(FIGURES)
    assert all(name.startswith(paper.lower()) for paper, name in SHOWN)


def test_images_of_the_page_are_small() -> None:
    images = [DOCS / "research" / image for image in re.findall(r"\]\((\.\./figures/.*?)\)", PAGE)]

    assert sum(path.stat().st_size for path in images) <= 1_200_000
