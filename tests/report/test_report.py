"""What a run says on the screen."""

from roadtorch.report.screen import MOST_SHOWN, screen, shortlist
from tests.reports import made_run


def test_a_few_detectors_are_all_on_the_screen_in_both_tables() -> None:
    document, _, _ = made_run()

    text = screen(document)

    assert all(text.count(name) >= 1 for name in document["detectors"])
    assert "less fusion" in text
    assert "more detectors" not in text


def test_of_a_grid_the_best_are_shown_beside_all_floors() -> None:
    worse = [f"oneclass:gaussian:{number}" for number in range(100)]
    document, _, _ = made_run(["fusion", *worse, "prior:rows", "prior:mean"])

    kept = list(shortlist(document["detectors"]))
    text = screen(document)

    assert kept == ["fusion", *worse[: MOST_SHOWN - 1], "prior:rows", "prior:mean"]
    assert f"{100 - MOST_SHOWN + 1} more detectors, with lower MaxF, are in metrics.json" in text
    assert worse[MOST_SHOWN - 2] in text
    assert worse[MOST_SHOWN - 1] not in text
