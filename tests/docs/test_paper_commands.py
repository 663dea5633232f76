"""Commands of figures and tables in docs/research/index.md, on an image of each set."""

import re
import shlex
import sys
from pathlib import Path

import pytest

from roadtorch.testing.scenes import render_scene, write_image
from scripts.figures import FIGURES, __main__, p1, p3_light, p3_table3
from tests.command import Call
from tests.data.test_kitti import add_frame, street
from tests.streets import write_drives

PAGE = Path(__file__).resolve().parents[2] / "docs/research/index.md"
COMMANDS = re.findall(r"^\| (P\d, .*) \| `(.*)` \|$", PAGE.read_text("utf-8"), re.M)

WRITTEN = {
    "P1, Figs. 1 to 5": (
        *("equalised", "dictionary", "selected_maps", "best_map", "mean_map", "tree_levels"),
        *("error", "pixel_stability", "node_stability", "iteration_1", "mask", "overlay"),
    ),
    "P1, Fig. 6": ("metrics",),
    "P1, Table I": ("p1-table1",),
    "P1, Table II": ("p1-table2",),
    "P2, Figs. 1 and 5": ("layout",),
    "P2, Fig. 4b": ("p2-fig4b",),
    "P2, Fig. 4c": ("p2-fig4c",),
    "P2, Fig. 6a": ("p2-fig6a", "p2-fig6a-camvid"),
    "P2, Fig. 6b": ("p2-fig6b",),
    "P2, Figs. 7 and 8": ("fused_plane", "uniformity", "layout", "likelihood"),
    "P3, Fig. 2": ("mask",),
    "P3, Fig. 8": ("p3-fig8",),
    "P3, Fig. 9": ("p3-fig9a", "p3-fig9b"),
    "P3, Table II": ("p3-table2", "p3-table2-camvid"),
    "P3, Table III": ("p3-table3",),
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
    return root


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduce the sets and detectors of the longest tables to one each."""
    monkeypatch.setattr(p1, "SETS", {"camvid": ("camvid", 1)})
    monkeypatch.setattr(p1, "TABLE", ("ufl:paper",))
    monkeypatch.setattr(p1, "BENCHMARK", ("fusion:paper",))
    monkeypatch.setattr(p3_light, "SCENES", 1)
    for module in (p3_light, p3_table3):
        monkeypatch.setattr(module, "IMAGES", 1)


@pytest.mark.parametrize(("figure", "command"), COMMANDS, ids=[figure for figure, _ in COMMANDS])
def test_the_command_of_a_figure_makes_it(
    figure: str,
    command: str,
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    call: Call,
) -> None:
    places = {"IMAGE": str(data / "street.png"), "OUT": str(tmp_path / "out")}
    words = [places.get(word, word.replace("DATA", str(data))) for word in shlex.split(command)]

    if words[0] == "roadtorch":
        assert call(*words[1:]).exit_code == 0
    else:
        monkeypatch.setattr(sys, "argv", words[1:])
        __main__.main()

    stems = {path.stem for path in (tmp_path / "out").rglob("*") if path.is_file()}
    for name in WRITTEN[figure.partition(":")[0]]:
        assert any(stem.split(".")[-1] == name for stem in stems), (name, stems)


def test_every_command_of_figures_has_a_row() -> None:
    assert len(COMMANDS) == len(WRITTEN)
    assert set(FIGURES) <= {word for _, command in COMMANDS for word in command.split()}
