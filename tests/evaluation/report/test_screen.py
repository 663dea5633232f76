"""What a run says on the screen."""

from roadtorch.evaluation.report.screen import MAX_SHOWN, screen, shortlist
from tests.reports import GROUPS, changed, made_run, with_conditions, without_group


def test_a_few_detectors_are_all_on_the_screen_in_both_tables() -> None:
    evaluation, _, _ = made_run()

    text = screen(evaluation)

    assert all(text.count(name) >= 1 for name in evaluation.detectors)
    assert "minus fusion" in text
    assert "more detectors" not in text


def test_of_a_grid_the_best_are_shown_beside_all_baselines() -> None:
    worse = [f"oneclass:gaussian:{number}" for number in range(100)]
    evaluation, _, _ = made_run(["fusion", *worse, "prior:rows", "prior:mean"])

    kept = shortlist(evaluation)
    text = screen(evaluation)

    assert kept == ["fusion", *worse[: MAX_SHOWN - 1], "prior:rows", "prior:mean"]
    assert f"{100 - MAX_SHOWN + 1} more detectors, with lower MaxF, are in metrics.json" in text
    assert worse[MAX_SHOWN - 2] in text
    assert worse[MAX_SHOWN - 1] not in text


def test_the_columns_are_those_of_the_measures_that_ask_for_one() -> None:
    evaluation, _, _ = made_run()

    road, trust, layout, pairs = (part.splitlines()[0] for part in screen(evaluation).split("\n\n"))

    assert road.split("pooled")[1].split() == [
        *("AUC", "AUC/image", "AP", "IoU", "EER", "Brier", "ms/image", "ECE")
    ]
    assert "F of mask  IoU of mask   MaxF " in road
    assert trust.split()[:5] == ["trust", "rank", "corr.", "of", "trust"]
    assert layout.split()[:6] == ["layout", "group", "sky", "vertical", "horizontal", "mean"]
    assert pairs.split()[:7] == ["minus", "fusion", "F", "of", "mask", "95", "%"]


def test_of_many_groups_the_worst_is_told() -> None:
    cameras = [f"camera{number}" for number in range(8)]
    few, _, _ = made_run(["fusion"], cameras[:6])
    many, _, _ = made_run(["fusion"], cameras)

    assert "MaxF camera5" in screen(few)
    header, row = screen(many).splitlines()[:2]
    assert "MaxF camera5" not in header
    assert "worst MaxF" in header
    assert "worst F of mask" in header
    worst = many.detectors["fusion"].groups["camera0"]
    assert f"{worst['f_mask']:.3f} camera0" in row
    assert f"{worst['maxf']:.3f} camera0" in row


def test_many_groups_have_a_table_with_the_worst_on_top() -> None:
    many, _, _ = made_run(["fusion", "prior:rows"], [f"camera{number}" for number in range(30)])

    table = next(part for part in screen(many).split("\n\n") if part.startswith("fusion by group"))

    header, first, *_, last, mean, more = table.splitlines()
    assert header.startswith("fusion by group  pictures  F of mask  IoU of mask ")
    assert header.endswith("MaxF of baseline")
    assert first.split()[:2] == ["camera0", "10"]
    assert first.split()[-1] == f"{many.detectors['prior:rows'].groups['camera0']['maxf']:.3f}"
    assert (last.split()[0], mean.split()[0]) == ("camera19", "mean")
    assert more == "10 more are in metrics.json (--out DIR)"


def test_groups_that_are_left_out_are_listed_and_marked() -> None:
    few, _, _ = made_run(["fusion"])

    text = screen(without_group(few, GROUPS[0]))

    assert f"MaxF {GROUPS[0]}" not in text.splitlines()[0]
    table = next(part for part in text.split("\n\n") if part.startswith("fusion by group"))
    assert [line.split("  ")[0] for line in table.splitlines()[1:]] == [
        *GROUPS[1:], "mean", f"{GROUPS[0]} (left out)"
    ]  # fmt: skip
    assert "by group" not in screen(few)


def test_conditions_have_a_small_table_and_baselines_none() -> None:
    run = with_conditions(made_run(["fusion", "prior:rows"])[0])

    text = screen(run)

    table = next(part for part in text.split("\n\n") if part.startswith("fusion by condition"))
    assert [line.split() for line in table.splitlines()[1:]] == [
        ["night", "(1", "group)", "0.300", "0.500", "0.500"],
        ["day", "(3", "groups)", "0.800", "0.900", "0.900"],
    ]
    assert "prior:rows by condition" not in text


def test_only_detectors_with_trust_have_a_line_of_it() -> None:
    run, _, _ = made_run(["fusion", "cpf"])
    one = run.detectors["cpf"].headline
    silent = {key: value for key, value in one.items() if not key.startswith("trust/")}

    text = screen(changed(run, "cpf", headline=silent))

    table = next(part for part in text.split("\n\n") if part.startswith("trust"))
    assert [line.split()[0] for line in table.splitlines()] == ["trust", "fusion"]
