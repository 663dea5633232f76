"""The figures and tables of the papers on rendered streets: what they measure.

tests/docs/test_paper_commands.py makes each of them.
"""

from pathlib import Path

import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import LabelledItem, Truth
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.curves import Curve, area
from roadtorch.evaluation.metrics import auc, count_levels
from roadtorch.evaluation.tally import Score, Tally
from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL
from roadtorch.road.seed_area import remove_isolated, seed_rectangle
from roadtorch.testing.scenes import render_scene
from scripts.figures import p1, p2, p3_light, p3_table3
from scripts.figures.p3_light import deviation, distance, median_of
from tests.streets import as_bytes, scene, write_camvid, write_drives

# --- P1 ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "width", "size"), [(360, 480, (120, 160)), (375, 1242, (120, 397))]
)
def test_images_and_labels_come_to_the_papers_size(
    height: int, width: int, size: tuple[int, int]
) -> None:
    road = torch.rand(height, width, generator=torch.Generator().manual_seed(0)) > 0.5

    image, truth = p1.resize_as_p1(torch.rand(3, height, width), Truth(road, ~road))

    assert image.shape == (3, *size)
    assert truth.road.shape == truth.valid.shape == size
    if height == 360:  # by the nearest pixel
        assert torch.equal(truth.road, road[1::3, 1::3])


def test_counts_are_pooled_over_images() -> None:
    empty = Truth(torch.zeros(120, 160, dtype=torch.bool), torch.ones(120, 160, dtype=torch.bool))
    half = Truth((torch.arange(160) < 80).expand(120, 160), empty.valid)
    image = render_scene(3, 120, 160).image

    counts = p1.pooled_counts([(image, empty), (image, half)], ["prior:uniform"])["prior:uniform"]

    assert int(counts.true_positive) == 120 * 80
    assert int(counts.false_positive) == 120 * 160 + 120 * 80


# --- P2 ---------------------------------------------------------------------------------


def tally_of(**drives: tuple[list[float], list[bool]]) -> Tally:
    """Count a row of pixels of each drive."""
    tally = Tally()
    for drive, (likelihood, road) in drives.items():
        values, true = torch.tensor([likelihood]), torch.tensor([road])
        maps = true, torch.ones_like(true)
        levels, mask = metrics.count_levels(values, *maps), metrics.count_mask(values >= 0.5, *maps)
        score = Score(levels, mask, count_boundary(values >= 0.5, *maps), None, None)
        tally.add(LabelledItem(drive, Path(drive), Path(drive), drive), score)
    return tally


def test_the_test_split_is_shown_where_it_is(tmp_path: Path) -> None:
    write_drives(tmp_path)
    assert p2.streets(tmp_path, 1).split == "dev"
    write_camvid(tmp_path / "camvid", "test", {"Seq05VD_1": render_scene(3, 48, 64)})

    assert [item.name for item in p2.streets(tmp_path, 1).items] == ["Seq05VD_1"]


def test_areas_are_pooled_and_by_drive_and_gains_are_over_the_baseline() -> None:
    good = ([0.9, 0.1, 0.8, 0.2], [True, False, True, False])
    base = ([0.9, 0.95, 0.8, 0.2], [True, False, True, False])
    both = tally_of(a=good, b=([0.1, 0.9], [True, False]))
    tallies = {p2.BASELINE: tally_of(a=base), p2.TEXTURE: tally_of(a=good), "both": both}
    tallies |= {title + p2.WHOLE: tally_of(a=base) for title in tallies}

    rows = p2.area_rows(tallies)

    # Of the 3·3 pairs of road and background 0.9, 0.8 and 0.1 against 0.1, 0.2 and 0.9: 4 right,
    # and two ties.
    assert [row["AUC, pooled"] for row in rows] == ["0.500", "1.000", "0.556"]
    assert rows[2]["mean of drives"] == "0.500"
    assert (rows[1]["over LBP, AUC, pooled"], rows[1]["P2's gain"]) == ("+100 %", "8 %")
    assert {row[f"AUC, pooled{p2.WHOLE}"] for row in rows} == {"0.500"}


def test_at_every_threshold_isolated_areas_are_discarded() -> None:
    likelihood = torch.rand(24, 32, generator=torch.Generator().manual_seed(3))
    seed = seed_rectangle(likelihood.shape)

    joined = p2.reach_of_seed(likelihood)

    for threshold in likelihood[seed].sort().values[:-1].tolist():
        mask = likelihood >= threshold
        assert torch.equal(joined >= threshold, remove_isolated(mask, seed))


def test_road_accuracy_is_recall_and_its_cost_stands_beside() -> None:
    drive = ([0.9, 0.1, 0.8, 0.2], [True, True, False, False])

    row = p2.accuracy_row(p2.pooled(tally_of(a=drive)))

    assert row["road accuracy (recall)"] == row["FPR"] == 0.5
    assert row["FPR where recall is .95"] == 1


def test_a_confusion_is_printed_in_the_papers_order() -> None:
    confusion = torch.zeros(4, 4, dtype=torch.int64)
    confusion[SKY, SKY], confusion[SKY, VERTICAL] = 3, 1
    confusion[VERTICAL, VERTICAL], confusion[HORIZONTAL, VERTICAL] = 5, 2
    confusion[3, SKY] = 7  # void

    assert p2.printed_ratios(confusion).tolist() == [[1, 0, 0], [1, 0, 0], [0.25, 0, 0.75]]


# --- P3 ---------------------------------------------------------------------------------


def test_hue_is_a_circle() -> None:
    hues = torch.tensor([0.98, 0.99, 0.01, 0.02, 0.03])

    assert float(median_of(hues, "H")) == pytest.approx(0.01, abs=1e-6)
    assert float(median_of(hues, "S")) == pytest.approx(0.03, abs=1e-6)
    assert float(distance(torch.tensor(0.95), torch.tensor(0.05), "H")) == pytest.approx(0.1)
    assert float(distance(torch.tensor(0.95), torch.tensor(0.05), "S")) == pytest.approx(0.9)
    assert deviation(hues, "H") < 0.03 < deviation(hues, "S")


@pytest.mark.parametrize(
    ("change", "kept", "lost"),
    [
        (p3_light.dimmed, ("nr", "ng", "H", "S"), ("R", "G", "L")),
        (p3_light.with_highlight, ("O1", "O2", "H"), ("R", "B", "L")),
        (p3_light.in_shadow, ("O1", "O2"), ("R", "G", "B", "L")),
    ],
)
def test_planes_move_as_their_formulas_say(change, kept, lost) -> None:
    moved = p3_light.moves(change, range(3))

    assert max(moved[name] for name in kept) < 0.25
    assert min(moved[name] for name in lost) > 0.5


def test_agreement_counts_equal_signs() -> None:
    measures = {"+": 0.1, "-": 0.9}
    row = {name: measures[p3_light.printed_sign(name, "highlights")] for name in p3_light.NAMES}
    turned = {name: 1 - value for name, value in row.items()}

    assert p3_light.agreement([{"property": "highlights", **row}]) == (12, 12)
    assert p3_light.agreement([{"property": "highlights", **turned}]) == (0, 12)


def test_drives_of_other_light_are_apart(tmp_path: Path) -> None:
    lights = {"0001TP": 0.8, "0016E5": 0.0}
    scenes = {f"{drive}_{seed}": render_scene(seed, 96, 128, dusk=dusk, shadows=0)
              for drive, dusk in lights.items() for seed in range(2)}  # fmt: skip
    write_camvid(tmp_path, "train", scenes)
    camvid = open_dataset("camvid", tmp_path, "train")

    rows = {str(row["property"]): row for row in p3_light.drive_rows(camvid)}

    between = float(str(rows["0001TP against 0016E5"]["L"]))
    assert between > 0.5
    assert between > 2 * float(str(rows["inside 0001TP"]["L"]))


def test_cells_are_areas_by_drive_beside_the_papers(tmp_path: Path) -> None:
    for split, drive, seeds in (("train", "0001TP", (0,)), ("val", "0016E5", (1, 2))):
        streets = {f"{drive}_{seed}": scene(seed, 48, 64) for seed in seeds}
        write_camvid(tmp_path / "camvid", split, streets)
    run = p3_table3.evaluate_few(tmp_path, ["oneclass:gaussian:S", "oneclass:dlp:S:paper"])
    detector, exact = load_detector("oneclass:gaussian:S"), []
    for seed in range(3):
        street = scene(seed, 48, 64)
        likelihood = detector.detect(as_bytes(street.image)).likelihood
        exact.append(float(auc(count_levels(likelihood, street.road, ~street.void))))
    mean = (exact[0] + (exact[1] + exact[2]) / 2) / 2

    values = p3_table3.percents(run)

    assert values["gaussian", "S"] == pytest.approx(100 * mean)
    curve = Curve(*torch.from_numpy(p3_table3.mean_lines(run)["gaussian", "S"]))
    assert float(area(curve)) == pytest.approx(mean, abs=0.01)
    assert curve.x[[0, -1]].tolist() == [0, 1]
    rows = [(row["classifier"], row["paper"]) for row in p3_table3.table_rows(values)]
    assert rows == [("gaussian", 92.8), ("dlp:paper", 92.9)]


def test_p3s_table_has_all_its_values_and_ranks_like_itself() -> None:
    table = p3_table3.printed_table()

    assert len(table) == 17 * 19 - 13 - 3  # PCA is empty in single planes and pairs
    assert max(table, key=table.__getitem__) == ("robust_gaussian", "HS")
    assert (table["nn", "R"], table["kcentres", "HS"], table["pca", "HSV"]) == (74.2, 93.1, 89.3)
    assert p3_table3.rank_correlation(table, p3_table3.SINGLE) == pytest.approx(1)
