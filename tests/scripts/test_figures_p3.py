"""The cores of P3's figures, on rendered streets."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.curves import Curve, area
from roadtorch.evaluation.metrics import auc, count_levels
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.scenes.street import render_scene
from scripts import figures_p3, figures_p3_area, figures_p3_data, figures_p3_light
from scripts import figures_p3_table3 as table3
from scripts.figures_p3_chart import apart, middle, spread
from tests.streets import scene, write_camvid


def test_every_figure_of_the_paper_has_a_command() -> None:
    names = {f"p3-fig{number}" for number in range(3, 10)} | {"p3-table2", "p3-table3"}

    assert set(figures_p3.FIGURES) == names
    assert all((figure.__doc__ or "").startswith("P3, ") for figure in figures_p3.FIGURES.values())


# --- planes -----------------------------------------------------------------------------


def test_hue_is_a_circle() -> None:
    hues = torch.tensor([0.98, 0.99, 0.01, 0.02, 0.03])

    assert float(middle(hues, "H")) == pytest.approx(0.01, abs=1e-6)
    assert float(middle(hues, "S")) == pytest.approx(0.03, abs=1e-6)
    assert float(apart(torch.tensor(0.95), torch.tensor(0.05), "H")) == pytest.approx(0.1)
    assert float(apart(torch.tensor(0.95), torch.tensor(0.05), "S")) == pytest.approx(0.9)
    assert spread(hues, "H") < 0.03 < spread(hues, "S")


@pytest.mark.parametrize(
    ("change", "kept", "lost"),
    [
        (figures_p3_light.dimmed, ("nr", "ng", "H", "S"), ("R", "G", "L")),
        (figures_p3_light.with_highlight, ("O1", "O2", "H"), ("R", "B", "L")),
    ],
    ids=["dimmed", "highlight"],
)
def test_planes_move_as_their_formulas_say(change, kept, lost) -> None:
    moved = figures_p3_light.moves(change, range(2))

    assert max(moved[name] for name in kept) < 0.2
    assert min(moved[name] for name in lost) > 0.5


def test_shadows_are_compared_where_they_fall() -> None:
    pair = next(pair for pair in map(figures_p3_light.in_shadow, range(9)) if pair.here.any())

    lit, dark = (image.mean(0)[pair.here].mean() for image in (pair.one, pair.other))

    assert dark < 0.8 * lit
    assert pair.here.sum() < figures_p3_light.clear_scene(0).road.numel() / 2


def test_thirds_are_the_ends_of_the_road() -> None:
    road = torch.zeros(12, 4, dtype=torch.bool)
    road[3:12] = True

    near, far = figures_p3_light.thirds(road)

    assert near.any(1).nonzero()[:, 0].tolist() == [9, 10, 11]
    assert far.any(1).nonzero()[:, 0].tolist() == [3, 4, 5]


def test_signs_are_those_of_the_paper() -> None:
    sign = figures_p3_light.printed_sign

    assert {len(signs) for signs in figures_p3_light.SIGNS.values()} == {11}
    assert sign("O1", "global illumination (dusk)") == "+"
    assert sign("L", "strong shadows") == "-"
    assert sign("a", "discriminative power (AUC, CamVid)") == "+"
    assert sign("S", "discriminative power (AUC, CamVid)") == "-"


def test_agreement_counts_equal_signs() -> None:
    measures = {"+": 0.1, "-": 0.9}
    row = {name: measures[figures_p3_light.printed_sign(name, "highlights")]
           for name in figures_p3_light.NAMES}  # fmt: skip
    turned = {name: 1 - value for name, value in row.items()}

    same = figures_p3_light.agreement([{"property": "highlights", **row}])
    none = figures_p3_light.agreement([{"property": "highlights", **turned}])

    assert (same, none) == ((12, 12), (0, 12))


def test_drives_of_other_light_are_apart(tmp_path: Path) -> None:
    lights = {"0001TP": 0.8, "0016E5": 0.0}
    scenes = {f"{drive}_{seed}": render_scene(seed, 96, 128, dusk=dusk, shadows=0)
              for drive, dusk in lights.items() for seed in range(2)}  # fmt: skip
    write_camvid(tmp_path, "train", scenes)
    camvid = open_dataset("camvid", tmp_path, "train")

    drives = {name: figures_p3_light.read_drive(camvid, name) for name in camvid.groups()}
    rows = {str(row["property"]): row for row in figures_p3_light.drive_rows(drives)}

    between = rows["0001TP against 0016E5"]
    assert float(str(between["L"])) > 0.5
    assert float(str(between["L"])) > 2 * float(str(rows["inside 0001TP"]["L"]))


# --- the training area ------------------------------------------------------------------


def test_a_map_has_its_planes_the_right_way_round() -> None:
    window = figures_p3_area.Window(0.0, 1.0, 0.2, 0.4)
    generator = torch.Generator().manual_seed(0)
    samples = torch.tensor([0.25, 0.35]) + 0.01 * torch.randn(200, 2, generator=generator)

    found = figures_p3_area.likelihood_map(
        fit(CLASSIFIERS["gaussian"], samples, axes_of(("nr", "ng"))), window, 41
    )

    row, column = divmod(int(found.argmax()), 41)
    assert (column / 40, 0.2 + 0.2 * row / 40) == pytest.approx((0.25, 0.35), abs=0.03)


def test_medians_of_superpixels_vary_less_than_pixels() -> None:
    assert figures_p3_area.variance_kept(scene(1, 240, 320).image) < 0.9


def test_an_area_is_measured_alone() -> None:
    image, road = torch.zeros(3, 96, 128), torch.zeros(96, 128, dtype=torch.bool)
    rows, columns = slice(83, 96), slice(44, 84)  # what 201 by 66 of 640 by 480 are here
    image[:, rows, columns], road[rows, columns] = 0.5, True

    found = figures_p3_area.area_measures(image, road)

    assert found == pytest.approx((0.5, 0, 1), abs=1e-6)
    framed = figures_p3_area.marked(image)
    assert framed[0].sum() > 0.5 * rows.stop  # red
    assert torch.equal(framed[:, :83], image[:, :83])


# --- the data ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("share", "group"),
    [(0.0, "at most 30 %"), (0.3, "at most 30 %"), (0.31, "30 to 45 %"), (0.5, "45 to 55 %"),
     (0.551, "more than 55 %"), (1.0, "more than 55 %")],
)  # fmt: skip
def test_groups_have_the_papers_bounds(share, group) -> None:
    assert figures_p3_data.group_of(share) == group


def test_a_set_is_counted_by_group(tmp_path: Path) -> None:
    scenes = {f"0001TP_{seed}": scene(seed, 96, 128) for seed in range(3)}
    write_camvid(tmp_path, "train", scenes)

    shares = figures_p3_data.road_share_of(open_dataset("camvid", tmp_path, "train"))
    row = figures_p3_data.share_row("camvid", [share.road for share in shares])
    groups = figures_p3_data.by_group(shares)

    exact = [float(one.road.float().mean()) for one in scenes.values()]
    assert [share.road for share in shares] == pytest.approx(exact)
    assert row["mean"] == pytest.approx(100 * np.mean(exact))
    assert {name: len(items) for name, items in groups.items()} == Counter(
        figures_p3_data.group_of(one) for one in exact
    )


def test_what_people_draw_comes_back_as_truth(tmp_path: Path) -> None:
    road = figures_p3_data.write_annotated(tmp_path, 3)

    rows = {
        str(row["truth"]): float(str(row["iou"]))
        for row in figures_p3_data.agreement_rows(tmp_path, road)
    }

    alone = [rows[person] for person in figures_p3_data.PEOPLE]
    assert len(set(alone)) == 3
    assert rows["majority"] > min(alone) > 0.85
    assert rows["majority"] > max(rows["intersection"], rows["union"])


# --- Table III --------------------------------------------------------------------------


def test_cells_are_areas_by_drive(tmp_path: Path) -> None:
    drives = {"0001TP": (0,), "0016E5": (1, 2)}
    scenes = {f"{drive}_{seed}": scene(seed, 96, 128) for drive, seeds in drives.items()
              for seed in seeds}  # fmt: skip
    write_camvid(tmp_path, "train", scenes)
    camvid = open_dataset("camvid", tmp_path, "train")
    detector = load_detector("oneclass:gaussian:S")

    cells = table3.measured(camvid, {"oneclass:gaussian:S": detector})

    exact = {}
    for item in camvid.items:
        image, truth = camvid.read(item)
        likelihood = detector.detect(image).likelihood
        exact[item.name] = float(auc(count_levels(likelihood, truth.road, truth.valid)))
    by_drive = [np.mean([exact[f"{drive}_{seed}"] for seed in seeds])
                for drive, seeds in drives.items()]  # fmt: skip
    assert table3.percents(cells) == {("gaussian", "S"): pytest.approx(100 * np.mean(by_drive))}
    curve = Curve(*torch.from_numpy(table3.mean_lines(cells)["gaussian", "S"]))
    assert float(area(curve)) == pytest.approx(float(np.mean(by_drive)), abs=0.01)
    assert curve.x[[0, -1]].tolist() == [0, 1]


def test_the_robust_weight_of_the_paper_is_another_row() -> None:
    ours, papers = {("robust_gaussian", "S"): 80.0}, {("robust_gaussian", "S"): 79.0}

    text = table3.rows_csv({"": ours, "robust_gaussian, method=huber": papers})

    assert text.splitlines() == [
        "classifier,representation,auc,paper",
        "robust_gaussian,S,80.00,92.8",
        '"robust_gaussian, method=huber",S,79.00,92.8',
    ]
    detector = load_detector("oneclass:robust_gaussian:S", **table3.HUBER)
    assert detector.settings.model_dump()["classifier"]["method"] == "huber"
