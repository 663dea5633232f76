"""What a run found, in words: each sentence follows from the numbers."""

import math
from dataclasses import replace

import pytest

from roadtorch.evaluation.report.screen import outcome
from roadtorch.evaluation.result import Comparison, Difference, Evaluation, Interval
from tests.reports import changed, scored


def named(**scores: float | None) -> Evaluation:
    """Detectors with a MaxF; p_x stands for the baseline prior:x."""
    return scored({name.replace("p_", "prior:"): score for name, score in scores.items()})


def test_the_best_detector_and_its_distance_to_the_best_baseline():
    evaluation = named(a=0.8, b=0.9, p_rows=0.85, p_mean=0.7)
    evaluation = changed(evaluation, "b", intervals={"maxf": Interval(0.88, 0.915)})

    first, second = outcome(evaluation)

    assert first == (
        "b is best: MaxF 0.900 (95 % interval 0.880 to 0.915), 0.050 above the best blind "
        "baseline, prior:rows (0.850)."
    )
    assert second == "Next is a, 0.100 behind."


@pytest.mark.parametrize(("other", "below"), [(0.95, "0.050"), (0.9, "0.000"), (0.8999, "0.000")])
def test_a_detector_below_the_baselines_or_level_with_them_is_not_praised(other, below):
    first = outcome(named(a=0.9, p_rows=other))[0]

    assert first.startswith("No detector is above the blind baselines: a has a MaxF of 0.900, ")
    assert below in first


@pytest.mark.parametrize(
    ("evaluation", "text"),
    [
        (named(a=0.9), "a is best: MaxF 0.900. No blind baseline was scored beside it."),
        (named(a=None), "No detector has a score."),
        (
            named(p_rows=0.8),
            "Only blind baselines were scored; the best is prior:rows with a MaxF of",
        ),
        (named(a=math.nan), "No detector has a score."),
    ],
)
def test_runs_with_one_side_alone(evaluation, text):
    assert outcome(evaluation)[0].startswith(text)


def test_groups_are_compared_with_their_own_best_baseline():
    evaluation = named(a=0.9, p_rows=0.8, p_mean=0.8)
    for name, groups in {
        "a": {"x": 0.85, "y": 0.95, "z": math.nan},
        "prior:rows": {"x": 0.86, "y": 0.7, "z": 0.5},
        "prior:mean": {"x": 0.5, "y": 0.9, "z": 0.5},
    }.items():
        found = {group: {"maxf": score} for group, score in groups.items()}
        evaluation = changed(evaluation, name, groups=found)

    assert outcome(evaluation)[1] == (
        "By group from 0.850 (x) to 0.950 (y); above every blind baseline on 1 of 2 groups."
    )


@pytest.mark.parametrize(
    ("against", "other", "ends", "text"),
    [
        ("a", "prior:rows", [-0.07, -0.03], "has a 95 % interval of +0.030 to +0.070."),
        ("prior:rows", "a", [0.03, 0.07], "has a 95 % interval of +0.030 to +0.070."),
        ("prior:rows", "a", [-0.01, 0.07], "+0.070, which these pictures do not tell from 0."),
        ("prior:rows", "a", [math.nan, 0.07], None),
        ("b", "prior:rows", [0.03, 0.07], None),
    ],
)
def test_the_interval_of_the_distance_has_the_right_sign(against, other, ends, text):
    change = Difference(0.05, Interval(*ends))
    comparison = Comparison(against, {other: {"maxf": change}})

    sentences = outcome(replace(named(a=0.9, p_rows=0.85), comparison=comparison))

    minus = "\N{MINUS SIGN}"
    assert len(sentences) == (2 if text else 1)
    assert text is None or sentences[1].replace(minus, "-").endswith(text)


def test_the_flattery_of_maxf_is_told():
    decided = {"maxf": 0.9, "f": 0.8, "iou": 0.7}
    evaluation = changed(named(a=0.9), "a", headline=decided, threshold_from="the other groups")

    assert outcome(evaluation)[-1] == (
        "MaxF picks its threshold on the labels it is scored on; at the chosen threshold, from "
        "the other groups, a has an F of 0.800 and an IoU of 0.700."
    )


def test_what_a_user_gets_and_where_it_is_worst_comes_second():
    figures = {"maxf": 0.9, "f_mask": 0.72, "iou_mask": 0.6}
    alone = changed(named(a=0.9), "a", headline=figures)
    groups = {"near": {"f_mask": 0.9}, "far": {"f_mask": 0.002}, "void": {"f_mask": math.nan}}

    text = "Its mask at the default threshold has an F of 0.720 and an IoU of 0.600"
    assert outcome(alone)[1] == f"{text}."
    assert outcome(changed(alone, "a", groups=groups))[1] == (
        f"{text}; on the worst of 2 groups, far, an F of 0.002."
    )
