"""What a run says on the screen."""

from roadtorch.report.screen import MOST_SHOWN, align, screen, shortlist
from tests.reports import made_run


def test_a_few_detectors_are_all_on_the_screen_in_both_tables() -> None:
    evaluation, _, _ = made_run()

    text = screen(evaluation)

    assert all(text.count(name) >= 1 for name in evaluation.detectors)
    assert "less fusion" in text
    assert "more detectors" not in text


def test_of_a_grid_the_best_are_shown_beside_all_floors() -> None:
    worse = [f"oneclass:gaussian:{number}" for number in range(100)]
    evaluation, _, _ = made_run(["fusion", *worse, "prior:rows", "prior:mean"])

    kept = list(shortlist(evaluation))
    text = screen(evaluation)

    assert kept == ["fusion", *worse[: MOST_SHOWN - 1], "prior:rows", "prior:mean"]
    assert f"{100 - MOST_SHOWN + 1} more detectors, with lower MaxF, are in metrics.json" in text
    assert worse[MOST_SHOWN - 2] in text
    assert worse[MOST_SHOWN - 1] not in text


def test_the_columns_are_those_of_the_measures_that_ask_for_one() -> None:
    evaluation, _, _ = made_run()

    road, trust, layout, pairs = (part.splitlines()[0] for part in screen(evaluation).split("\n\n"))

    assert road.split("pooled")[1].split() == [
        *("AUC", "AUC/image", "AP", "IoU", "EER", "Brier", "ms/image", "ECE")
    ]
    assert "F of mask  IoU of mask   MaxF " in road
    assert trust.split()[:5] == ["trust", "rank", "correlation", "within", "drives"]
    assert layout.split()[:6] == ["layout", "drive", "sky", "vertical", "horizontal", "mean"]
    assert pairs.split()[:7] == ["less", "fusion", "F", "of", "mask", "95", "%"]


def test_columns_line_up() -> None:
    assert align([["a", "b"], ["long", "1.5"]]) == "a       b\nlong  1.5"


def test_of_many_drives_the_worst_is_told() -> None:
    cameras = [f"camera{number}" for number in range(8)]
    few, _, _ = made_run(["fusion"], cameras[:6])
    many, _, _ = made_run(["fusion"], cameras)

    assert "MaxF camera5" in screen(few)
    header, row = screen(many).splitlines()[:2]
    assert "MaxF camera5" not in header
    assert "worst MaxF" in header
    assert "worst F of mask" in header
    worst = many.detectors["fusion"].drives["camera0"]["maxf"]
    assert f"{worst:.3f} camera0" in row
