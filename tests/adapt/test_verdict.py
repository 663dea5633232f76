"""The verdict says what can fail, and says nothing where little is known."""

import torch

from roadtorch.adapt.verdict import Judged, verdict_of
from roadtorch.evaluation.metrics import count_mask, f_measure


def judged(before: list[int], after: list[int], both: list[int] | None = None) -> Judged:
    """Frames of 100 pixels of road, of which so many are found, and no false one."""
    counts = (
        torch.tensor([[hit, 0, 100 - hit, 0] for hit in hits])
        for hits in (before, after, both or after)
    )
    return Judged(*counts)


def test_a_gain_on_every_frame_is_adopted_with_its_figures() -> None:
    verdict = verdict_of([judged([50] * 12, [60] * 12), judged([50] * 12, [60] * 12)])

    assert verdict.word == "adopt"
    assert str(verdict).startswith(
        "adopt: on 24 frames that it had not seen, the mask comes closer"
    )
    assert "F 0.667 to 0.750, +0.083" in str(verdict)


def test_a_loss_is_not_adopted() -> None:
    assert verdict_of([judged([60] * 24, [50] * 24)]).word == "do not adopt"


def test_a_loss_of_half_that_both_together_make_good_tells_nothing() -> None:
    verdict = verdict_of([judged([60] * 24, [50] * 24, [70] * 24)])

    assert verdict.word == "cannot tell"
    assert str(verdict).endswith(
        "F 0.750 to 0.667, -0.083 (-0.083 to -0.083); both halves together 0.824"
    )


def test_what_was_seen_is_no_reason_to_adopt() -> None:
    assert verdict_of([judged([60] * 24, [60] * 24, [90] * 24)]).word == "cannot tell"


def test_no_change_tells_nothing_for_the_judge_errs_too() -> None:
    assert verdict_of([judged([60] * 24, [60] * 24)]).word == "cannot tell"


def test_a_gain_in_one_stretch_alone_may_be_chance() -> None:
    verdict = verdict_of([judged([60] * 24, [60] * 20 + [90] * 4)])

    assert verdict.after > verdict.before
    assert verdict.word == "cannot tell"


def test_a_half_that_loses_weighs_against_one_that_gains() -> None:
    gains, loses = judged([50] * 12, [60] * 12), judged([60] * 12, [50] * 12)

    assert verdict_of([gains, loses]).word != "adopt"


def test_few_frames_say_nothing_however_large_the_gain() -> None:
    verdict = verdict_of([judged([10] * 15, [90] * 15)])

    assert verdict.word == "cannot tell"
    assert str(verdict) == "cannot tell: 15 frames are too few to judge by"


def test_known_pixels_alone_are_counted() -> None:
    mask = torch.tensor([[True, True, False, True]])
    road = torch.tensor([[True, False, True, True]])
    known = torch.tensor([[True, True, True, False]])

    counts = count_mask(mask, road, known)

    assert [counts.true_positive, counts.false_positive, counts.false_negative] == [1, 1, 1]
    assert float(f_measure(counts)) == 0.5
