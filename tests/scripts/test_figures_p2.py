"""The figures of P2 on rendered streets: what they count, and that each writes its files."""

from pathlib import Path

import pytest
import torch

from roadtorch.evaluation import metrics
from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL
from roadtorch.scenes.street import render_scene
from scripts import figures_p2, figures_p2_layout, figures_p2_road, figures_p2_streets
from scripts.figures_p2_studies import layout_recall
from tests.streets import write_camvid

WRITTEN = {
    "p2-fig4b": ("p2-fig4b.csv", "p2-fig4b.png"),
    "p2-fig4c": ("p2-fig4c.csv", "p2-fig4c.png"),
    "p2-fig5": ("p2-fig5.png",),
    "p2-fig6a": ("p2-fig6a.csv", "p2-fig6a.png"),
    "p2-fig6b": ("p2-fig6b.csv",),
    "p2-fig7": ("p2-fig7.png",),
    "p2-fig8": ("p2-fig8.png",),
    "p2-eq4": ("p2-eq4.csv",),
    "p2-ridge": ("p2-ridge.csv",),
    "p2-superpixels": ("p2-superpixels.csv",),
}


@pytest.fixture
def data(tmp_path: Path) -> Path:
    scenes = {
        f"{drive}_{n}": render_scene(n, 48, 64) for n, drive in enumerate(("0001TP", "0006R0"))
    }
    write_camvid(tmp_path / "camvid", "train", scenes)
    write_camvid(tmp_path / "camvid", "val", {"0016E5_7959": render_scene(2, 48, 64)})
    return tmp_path


def counts(likelihood: list[float], road: list[bool]) -> figures_p2_streets.Counts:
    values, true = torch.tensor([likelihood]), torch.tensor([road])
    valid = torch.ones_like(true)
    outcome = metrics.count_mask(values >= 0.5, true, valid)
    return figures_p2_streets.Counts(metrics.count_levels(values, true, valid), outcome, None)


def test_the_test_split_is_shown_where_it_is(data: Path) -> None:
    assert figures_p2_streets.streets(data, 1).split == "dev"
    write_camvid(data / "camvid", "test", {"Seq05VD_1": render_scene(3, 48, 64)})

    assert [item.name for item in figures_p2_streets.streets(data, 1).items] == ["Seq05VD_1"]


def test_every_figure_has_its_files_listed() -> None:
    assert figures_p2.FIGURES.keys() == WRITTEN.keys()


@pytest.mark.parametrize("name", WRITTEN)
def test_a_figure_writes_its_files(name: str, data: Path) -> None:
    out = data / "out"
    out.mkdir()

    figures_p2.FIGURES[name](data, out)

    assert {path.name for path in out.iterdir()} == set(WRITTEN[name])


def test_pooling_adds_pixels_and_means_of_drives_do_not() -> None:
    good = counts([0.9, 0.1, 0.8, 0.2], [True, False, True, False])
    bad = counts([0.1, 0.9], [True, False])
    drives = {"a": good, "b": bad}

    assert figures_p2_streets.mean_over_drives(drives, figures_p2_streets.auc) == 0.5
    # Of the 3·3 pairs of road and background 0.9, 0.8 and 0.1 against 0.1, 0.2 and 0.9: 4 right,
    # and two ties.
    assert float(figures_p2_streets.auc(figures_p2_streets.pooled(drives))) == pytest.approx(5 / 9)


def test_gains_are_over_the_baseline() -> None:
    base = counts([0.9, 0.95, 0.8, 0.2], [True, False, True, False])
    better = counts([0.9, 0.1, 0.8, 0.2], [True, False, True, False])

    rows = figures_p2_road.area_rows(
        {figures_p2_road.BASELINE: {"a": base}, figures_p2_road.TEXTURE: {"a": better}}
    )

    assert [row["AUC, pooled"] for row in rows] == ["0.500", "1.000"]
    assert rows[1]["over the baseline"] == "+100 %"
    assert rows[1]["P2's gain"] == "8 %"


def test_road_accuracy_is_recall_and_its_cost_stands_beside() -> None:
    row = figures_p2_road.accuracy_row(counts([0.9, 0.1, 0.8, 0.2], [True, True, False, False]))

    assert row["road accuracy (recall)"] == "0.500"
    assert row["FPR"] == "0.500"
    assert row["FPR where recall is .95"] == "1.000"


def test_a_confusion_is_printed_in_the_papers_order() -> None:
    confusion = torch.zeros(4, 4, dtype=torch.int64)
    confusion[SKY, SKY], confusion[SKY, VERTICAL] = 3, 1
    confusion[VERTICAL, VERTICAL], confusion[HORIZONTAL, VERTICAL] = 5, 2
    confusion[3, SKY] = 7  # void

    shares = figures_p2_layout.printed_shares(confusion)

    assert shares == [[1, 0, 0], [1, 0, 0], [0.25, 0, 0.75]]


def test_a_potential_of_one_has_the_colour_of_its_class() -> None:
    potentials = torch.eye(3)[:, None]  # three pixels: sky, vertical, horizontal

    colours = figures_p2_layout.potential_colours(potentials)

    assert int(colours[:, 0, VERTICAL].argmax()) == 0  # red
    assert int(colours[:, 0, HORIZONTAL].argmax()) == 1  # green
    assert int(colours[:, 0, SKY].argmax()) == 2  # blue


def test_recall_of_a_layout_is_a_dash_where_there_is_none() -> None:
    seen = counts([0.9], [True])._replace(layout=torch.diag(torch.tensor([2, 3, 4, 0])))

    assert layout_recall({"a": {"x": seen}}, "a") == "1.000"
    assert layout_recall({"b": {"x": counts([0.9], [True])}}, "b") == "-"
