"""The figures and tables of the papers on rendered streets: what they measure.

tests/docs/test_paper_figures.py makes each of them.
"""

from pathlib import Path

import pytest
import torch

from roadtorch.data.dataset import LabelledItem
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.evaluation.boundary import count_boundary
from roadtorch.evaluation.metrics import auc, count_levels
from roadtorch.evaluation.tally import ImageCounts, Tally
from scripts.figures import p2_road, p3_table3
from tests.streets import as_bytes, scene, write_camvid

# --- P2 ---------------------------------------------------------------------------------


def tally_of(**drives: tuple[list[float], list[bool]]) -> Tally:
    """Count a row of pixels of each drive."""
    tally = Tally()
    for drive, (likelihood, road) in drives.items():
        values, true = torch.tensor([likelihood]), torch.tensor([road])
        maps = true, torch.ones_like(true)
        levels, mask = metrics.count_levels(values, *maps), metrics.count_mask(values >= 0.5, *maps)
        score = ImageCounts(levels, mask, count_boundary(values >= 0.5, *maps), None)
        tally.add(LabelledItem(drive, Path(drive), Path(drive), drive), score)
    return tally


def test_areas_are_pooled_and_by_drive_and_gains_are_over_the_baselines() -> None:
    good = ([0.9, 0.1, 0.8, 0.2], [True, False, True, False])
    base = ([0.9, 0.95, 0.8, 0.2], [True, False, True, False])
    two_drives = tally_of(a=good, b=([0.1, 0.9], [True, False]))
    tallies = {p2_road.BASELINE: tally_of(a=base), p2_road.TEXTURE: tally_of(a=good)}
    tallies |= {"both": two_drives, p2_road.BLIND: tally_of(a=good)}
    tallies |= {title + p2_road.WHOLE: tally_of(a=base) for title in tallies}

    rows = p2_road.area_rows(tallies, {"set": "s"})

    # Of the 3·3 pairs of road and background 0.9, 0.8 and 0.1 against 0.1, 0.2 and 0.9: 4 right,
    # and two ties. By drives 1 and 0.
    pooled = [str(row["AUC, pooled"]).split()[0] for row in rows]
    assert pooled == [".500", "1.000", ".556", "1.000"]
    assert rows[2]["AUC, by drives"] == ".500 (.000–1.000)"
    assert (rows[1]["over LBP, %, pooled"], rows[1]["P2's gain"]) == ("+100 (+100 to +100)", "8 %")
    assert rows[1]["less rows, pooled"] == "+.000 (+.000 to +.000)"
    assert {row[f"AUC, pooled{p2_road.WHOLE}"] for row in rows} == {".500 (.500–.500)"}


# --- P3 ---------------------------------------------------------------------------------


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
    rows = p3_table3.table_rows(run)
    papers = {row["classifier"]: row["paper"] for row in rows}
    assert papers == {"gaussian": 92.8, "dlp:paper": 92.9}
    low, high = (float(str(rows[0][end])) for end in ("low", "high"))
    assert low <= 100 * mean <= high
