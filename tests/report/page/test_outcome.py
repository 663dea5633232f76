"""What a run found, in words: each sentence follows from the numbers."""

import pytest

from roadtorch.report.page.outcome import outcome


def scored(**scores: float | None) -> dict:
    """A document of detectors with a MaxF; p_x stands for the floor prior:x."""
    return {
        "detectors": {
            name.replace("p_", "prior:"): {"maxf": score} for name, score in scores.items()
        }
    }


def test_the_best_detector_and_its_distance_to_the_best_floor():
    document = scored(a=0.8, b=0.9, p_rows=0.85, p_mean=0.7)
    document["detectors"]["b"]["ci95"] = {"maxf": [0.88, 0.915]}

    first, second = outcome(document)

    assert first == (
        "b is best: MaxF 0.900 (95 % interval 0.880 to 0.915), 0.050 above the best floor, "
        "prior:rows (0.850)."
    )
    assert second == "Next is a, 0.100 behind."


@pytest.mark.parametrize(("floor", "below"), [(0.95, "0.050"), (0.9, "0.000"), (0.8999, "0.000")])
def test_a_detector_below_the_floors_or_level_with_them_is_not_praised(floor, below):
    first = outcome(scored(a=0.9, p_rows=floor))[0]

    assert first.startswith("No detector is above the floors: a has a MaxF of 0.900, ")
    assert below in first


@pytest.mark.parametrize(
    ("document", "text"),
    [
        (scored(a=0.9), "a is best: MaxF 0.900. No floor was scored beside it."),
        (scored(a=None), "No detector has a score."),
        (scored(p_rows=0.8), "Only floors were scored; the best is prior:rows with a MaxF of"),
        ({"detectors": {"a": {}}}, "No detector has a score."),
    ],
)
def test_runs_with_one_side_alone(document, text):
    assert outcome(document)[0].startswith(text)


def test_drives_are_compared_with_their_own_best_floor():
    document = scored(a=0.9, p_rows=0.8, p_mean=0.8)
    for name, drives in {
        "a": {"x": 0.85, "y": 0.95, "z": None},
        "prior:rows": {"x": 0.86, "y": 0.7, "z": 0.5},
        "prior:mean": {"x": 0.5, "y": 0.9, "z": 0.5},
    }.items():
        groups = {drive: {"maxf": score} for drive, score in drives.items()}
        document["detectors"][name]["groups"] = groups

    assert outcome(document)[1] == (
        "By drive from 0.850 (x) to 0.950 (y); above every floor on 1 of 2 drives."
    )


@pytest.mark.parametrize(
    ("against", "other", "ends", "text"),
    [
        ("a", "prior:rows", [-0.07, -0.03], "that distance is +0.030 to +0.070."),
        ("prior:rows", "a", [0.03, 0.07], "that distance is +0.030 to +0.070."),
        ("prior:rows", "a", [-0.01, 0.07], "+0.070, which these pictures do not tell from 0."),
        ("prior:rows", "a", [None, 0.07], None),
        ("b", "prior:rows", [0.03, 0.07], None),
    ],
)
def test_the_interval_of_the_distance_has_the_right_sign(against, other, ends, text):
    document = scored(a=0.9, p_rows=0.85)
    change = {"difference": 0.05, "ci95": ends}
    document["paired"] = {"against": against, "detectors": {other: {"maxf": change}}}

    sentences = outcome(document)

    minus = "\N{MINUS SIGN}"
    assert len(sentences) == (2 if text else 1)
    assert text is None or sentences[1].replace(minus, "-").endswith(text)


def test_the_flattery_of_maxf_is_told():
    document = scored(a=0.9)
    document["detectors"]["a"] |= {"f": 0.8, "iou": 0.7, "threshold_from": "the other drives"}

    assert outcome(document)[-1] == (
        "MaxF picks its threshold on the labels it is scored on; at the chosen threshold, from "
        "the other drives, a has an F of 0.800 and an IoU of 0.700."
    )
