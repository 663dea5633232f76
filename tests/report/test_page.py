"""The report: its numbers, what it leaves out, and that it needs and asks for nothing else."""

import base64
import hashlib
import html as entities
import json
import math
import os
import re
import shutil
import subprocess
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadtorch import __version__
from roadtorch.evaluation.document import DetectorCurves
from roadtorch.evaluation.measure import Figures
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.result import Comparison, Difference, Evaluation, Failure, Interval
from roadtorch.report import charts, files
from roadtorch.report.montage import captioned
from tests.reports import (
    COMMAND,
    GROUPS,
    NAMES,
    Page,
    changed,
    made_contender,
    made_run,
    made_sheet,
    scored,
    with_conditions,
)

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
HOSTILE = '"><script>alert(1)</script><img src="http://example.org/x.png">'


def render(evaluation, curves=None, rows=(), sheets=None) -> Page:
    return Page(files.render_page(evaluation, curves or {}, rows, sheets or {}, COMMAND))


@pytest.fixture(scope="module")
def page() -> Page:
    sheets = {"fusion": {part: made_sheet() for part in ("worst", "best", "median")}}
    return render(*made_run(), sheets)


def column(page: Page, section: str, header: str, table: int = 0) -> dict[str, str]:
    """A column's text by row name."""
    head, *rows = page.tables[section][table]
    place = [name.replace("\n", " ") for name in head].index(header)
    return {row[0]: row[place] for row in rows}


# --- numbers -------------------------------------------------------------------------------------


def test_the_scores_are_those_of_the_document(page):
    detectors = made_run()[0].detectors
    headers = ("MaxF", "AUC", "AP", "IoU", "EER", "Brier")
    keys = ("maxf", "auc_pooled", "ap", "iou", "eer", "brier")

    for header, key in zip(headers, keys, strict=True):
        assert column(page, "scores", header) == {
            name: f"{detectors[name].headline[key]:.3f}" for name in NAMES
        }
    assert len(page.charts()) == 8

    for group in GROUPS:
        assert column(page, "scores", f"MaxF {group}") == {
            name: f"{detectors[name].groups[group]['maxf']:.3f}" for name in NAMES
        }
    low, high = detectors["cpf:v2"].interval
    assert column(page, "scores", "95 %")["cpf:v2"] == f"{low:.3f}–{high:.3f}"
    assert set(column(page, "scores", "ms /image").values()) == {"12.3"}


def test_the_best_is_first_and_baselines_are_marked(page):
    evaluation = made_run()[0]
    shuffled = replace(evaluation, detectors=dict(sorted(evaluation.detectors.items())))

    assert list(column(render(shuffled), "scores", "AP")) == list(NAMES)
    assert {*page.rows_of_baselines} == {"prior:mean", "prior:rows"}


def test_the_distance_to_the_best_baseline_stands_beside_every_score(page):
    scores = {name: one.headline["maxf"] for name, one in made_run()[0].detectors.items()}

    found = column(page, "scores", "above baseline")

    assert found["prior:mean"] == "+0.000"
    for name, text in found.items():
        expected = scores[name] - scores["prior:mean"]
        assert float(text.replace("\N{MINUS SIGN}", "-")) == pytest.approx(expected, abs=5e-4)


def test_tables_by_group_have_the_groups_figures(page):
    detectors = made_run()[0].detectors

    for place, group in enumerate(GROUPS):
        assert column(page, "groups", "IoU", place)["labeller"] == (
            f"{detectors['labeller'].groups[group]['iou']:.3f}"
        )
        assert "PRE" in page.tables["groups"][place][0]
    assert len(page.tables["groups"]) == len(GROUPS) + 1  # and all pooled


def test_differences_have_their_intervals(page):
    change = made_run()[0].comparison.differences["labeller"]["maxf"]

    text = column(page, "pairs", "MaxF")["labeller"].replace("\N{MINUS SIGN}", "-")

    low, high = change.interval
    assert text == f"{change.value:+.3f}{low:+.3f} to {high:+.3f}"
    assert "fusion" not in column(page, "pairs", "MaxF")


def test_confusions_are_tables():
    heat, recalls = render(made_run(["it"])[0]).tables["layout"]

    assert heat[0] == ["truth", "sky", "vertical", "horizontal"]
    assert heat[2] == ["vertical", "0.050", "0.900", "0.050"]
    assert [row[0] for row in recalls] == ["group", *GROUPS, "mean"]


def test_detectors_that_share_a_layout_share_its_tables():
    evaluation = made_run(["a", "b", "c"])[0]
    a = evaluation.detectors["a"]
    evaluation = changed(evaluation, "b", headline=a.headline, groups=a.groups)
    other = {**a.headline, "layout/sky": 0.1}
    evaluation = changed(evaluation, "c", headline=other, groups=a.groups)

    page = render(evaluation)

    assert len(page.tables["layout"]) == 4
    assert "a, b" in page.text["layout"]


def test_the_worst_group_is_on_top_and_its_figures_stand_out():
    cameras = [f"camera{number}" for number in range(8)]
    evaluation = without_group(made_run(["fusion", "prior:rows"], cameras)[0], "camera5")

    page = render(evaluation)

    (table,) = page.tables["worst"]
    assert [row[0] for row in table[1:]] == [
        *(one for one in cameras if one != "camera5"), "mean", "camera5 (left out)"
    ]  # fmt: skip
    fusion, rows = (evaluation.detectors[name].groups for name in ("fusion", "prior:rows"))
    assert column(page, "worst", "F of mask") == {
        **{group: f"{figures['f_mask']:.3f}" for group, figures in fusion.items()},
        "mean": f"{evaluation.detectors['fusion'].headline['f_mask']:.3f}",
        "camera5 (left out)": f"{evaluation.detectors['fusion'].group('camera5')['f_mask']:.3f}",
    }
    assert column(page, "worst", "MaxF of baseline")["camera0"] == f"{rows['camera0']['maxf']:.3f}"
    assert f"<b>{fusion['camera0']['f_mask']:.3f}</b>" in page.source.split('id="worst"')[1]
    assert "camera5 left out of every mean and choice" in page.text["head"]
    assert "camera5 (left out)" in page.text["groups"]


def without_group(evaluation: Evaluation, group: str) -> Evaluation:
    """The same run with one group left out."""
    for name, one in evaluation.detectors.items():
        kept = {each: figures for each, figures in one.groups.items() if each != group}
        left_out = {group: one.groups[group]}
        evaluation = changed(evaluation, name, groups=kept, left_out=left_out)
    return evaluation


def test_conditions_have_a_table_with_the_number_of_their_groups():
    page = render(with_conditions(made_run(["fusion", "prior:rows"])[0]))

    assert column(page, "conditions", "F of mask") == {
        "night (1 group)": "0.300", "day (3 groups)": "0.800"
    }  # fmt: skip


def test_trust_has_a_table(page):
    assert list(column(page, "trust", "AURC")) == list(NAMES)
    assert "rank corr. of trust" in [one.replace("\n", " ") for one in page.tables["trust"][0][0]]


def test_the_run_is_told(page):
    text = page.text["made"]

    assert "roadtorch evaluate camvid data --detector 'cpf*'" in text
    assert f"roadtorch {__version__}" in text
    assert "thresholds from the other groups" in text
    assert '"height": 30' in text
    assert "0001TP_99" in page.text["failures"]
    assert "is not a picture" in page.text["failures"]
    assert "MaxF" in page.text["reading"]


# --- parts ---------------------------------------------------------------------------------------


def test_sheets_are_jpeg_inside_the_page_best_first(page):
    pictures = page.named("img")

    assert [one["alt"].split()[0] for one in pictures] == ["Best", "Median", "Worst"]
    for one in pictures:
        kind, data = one["src"].split(",")
        decoded = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        assert kind == "data:image/jpeg;base64"
        assert decoded is not None
        assert decoded.shape == (24, 64, 3)


def test_a_wide_sheet_is_made_as_wide_as_the_page_shows_it():
    shown = made_sheet(width=2400, height=300)

    encoded = np.frombuffer(base64.b64decode(shown["uri"].split(",")[1]), np.uint8)
    decoded = cv2.imdecode(encoded, cv2.IMREAD_COLOR)
    assert decoded is not None
    assert decoded.shape == (150, 1200, 3)
    assert (shown["width"], shown["height"]) == ("1200", "150")


def test_sheets_of_the_eight_best_are_shown_and_the_others_counted():
    names = [f"d{i}" for i in range(11)]

    page = render(made_run(names)[0], sheets={name: {"best": made_sheet()} for name in names})

    assert len(page.named("img")) == 8
    assert "Sheets of 3 more detectors" in page.text["looked-at"]


def test_many_failures_are_counted():
    failures = [Failure(f"picture {i}", None, "broken") for i in range(250)]

    page = render(replace(made_run(["it"])[0], failures=failures))

    assert len(page.tables["failures"][0]) == 1 + files.MAX_FAILURES
    assert "50 more are in metrics.json" in page.text["failures"]


def test_a_name_that_is_not_utf_8_can_stand_on_a_tile() -> None:
    tile = captioned(np.zeros((30, 40, 3), np.uint8), os.fsdecode(b"z\xff.jpg"), 30)

    assert tile[:20].any()


# --- what is missing or undefined ----------------------------------------------------------------


def test_a_run_with_nothing_but_names():
    page = render(scored({"it": None, "prior:rows": None}))

    assert "No detector has a score." in page.text["head"]
    assert page.charts() == []
    assert {"curves", "pairs", "layout", "looked-at", "failures", "groups"}.isdisjoint(page.tables)


@pytest.fixture
def _no_charts(monkeypatch):
    monkeypatch.setattr(charts, "all_charts", lambda *_: dict.fromkeys(
        ("f_mask", "maxf", "paired", "roc", "pr", "reliability", "risk", "pictures"), ""
    ))  # fmt: skip


def ways_to_miss() -> dict[str, Evaluation]:
    """Runs that lack something: a measure in the headline and a group, or all of a kind."""
    whole = made_run()[0]
    one = whole.detectors["fusion"]
    found = {}
    for measure in MEASURES:
        headline = {key: value for key, value in one.headline.items() if key != measure.key}
        groups = {**one.groups, "0006R0": {}}
        found[measure.key] = changed(whole, "fusion", headline=headline, groups=groups)
    fields = {"groups": {}, "pooled": {}, "intervals": {}, "threshold_from": ""}
    found |= {name: changed(whole, "fusion", **{name: value}) for name, value in fields.items()}
    undefined = {"labeller": {"maxf": Difference(math.nan, Interval())}, "cpf:v2": {}}
    found["differences"] = replace(whole, comparison=Comparison("fusion", undefined))
    return found


@pytest.mark.usefixtures("_no_charts")
def test_whatever_is_missing_is_left_out():
    for way, evaluation in ways_to_miss().items():
        page = render(evaluation)

        assert {*column(page, "scores", "AP")} == {*NAMES}, way
        assert not re.search(r"\bnan\b|None", "".join(page.text.values())), way


def undefined(figures: Figures) -> Figures:
    return dict.fromkeys(figures, math.nan)


def test_undefined_figures_are_dashes():
    evaluation, curves, rows = made_run()
    for name, one in evaluation.detectors.items():
        evaluation = changed(
            evaluation, name, headline=undefined(one.headline), pooled=undefined(one.pooled),
            groups={group: undefined(figures) for group, figures in one.groups.items()},
            intervals={"maxf": Interval()},
        )  # fmt: skip
    nothing = Difference(math.nan, Interval())
    differences = {name: {"maxf": nothing} for name in evaluation.comparison.differences}
    evaluation = replace(evaluation, comparison=Comparison("fusion", differences))
    nowhere = [[math.nan] * 3] * 3
    kinds = {"roc": nowhere, "pr": nowhere, "reliability": nowhere}
    curves = {name: DetectorCurves(mean=kinds, groups={}) for name in curves}

    page = render(evaluation, curves, [replace(row, f=math.nan) for row in rows])

    assert set(column(page, "scores", "MaxF").values()) == {"–"}
    assert set(column(page, "scores", "95 %").values()) == {"–"}
    assert set(column(page, "scores", "above baseline").values()) == {"–"}
    assert page.charts() == []
    assert not re.search(r"\bnan\b|None", "".join(page.text.values()))


def test_one_detector_without_groups():
    page = render(*made_run(["it"], groups=[]))

    assert column(page, "scores", "MaxF") == {"it": "0.950"}
    assert "No blind baseline was scored beside it." in page.text["head"]
    assert "groups" not in page.tables
    assert len(page.charts()) == 7  # nobody to compare with


def test_a_grid_of_three_hundred_detectors_stays_readable():
    names = [f"oneclass:{i}" for i in range(297)] + ["prior:mean", "prior:rows", "prior:uniform"]
    begin = time.process_time()

    page = render(*made_run(names))

    assert time.process_time() - begin < 15
    assert len(page.source) < 2_000_000
    assert len(page.tables["scores"][0]) == 301
    assert "the table has all 300" in page.text["scores"]
    assert page.source.count("<details") < 30


# --- nothing leaves the page ---------------------------------------------------------------------


def test_no_attribute_and_no_style_refers_to_anything_outside(page):
    for tag, values in page.tags:
        for name, value in values.items():
            if name.split(":")[-1] in ("src", "href", "srcset", "data", "action", "poster"):
                assert value.startswith(("#", "data:image/jpeg;")), (tag, name, value)
    assert set(re.findall(r"url\(\s*['\"]?(.)", page.source)) <= {"#"}
    assert "@import" not in page.source
    assert not {tag for tag, _ in page.tags} & {"link", "iframe", "object", "embed", "base"}


def test_the_policy_allows_one_script_and_no_connection(page):
    policy = next(one["content"] for one in page.named("meta") if "http-equiv" in one)
    (script,) = re.findall(r"<script>(.*?)</script>", page.source, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()

    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))

    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    assert rules["script-src"] == f"'sha256-{digest}'"
    assert policy in page.source[: page.source.index("<style>")]


def test_names_are_text_wherever_they_stand():
    evaluation, curves, rows = made_run([HOSTILE, "prior:" + HOSTILE], [HOSTILE, "b"])
    evaluation = replace(
        changed(
            evaluation, HOSTILE, threshold_from=HOSTILE,
            method=made_contender(HOSTILE, {HOSTILE: HOSTILE}),
        ),
        dataset=replace(evaluation.dataset, name=HOSTILE, split=HOSTILE),
        failures=[Failure(HOSTILE, HOSTILE, HOSTILE)],
    )  # fmt: skip

    page = Page(files.render_page(
        evaluation, curves, rows, {HOSTILE: {"best": made_sheet()}}, HOSTILE
    ))  # fmt: skip

    assert len(page.named("script")) == 1
    assert [one["src"][:5] for one in page.named("img")] == ["data:"]
    assert page.tables["failures"][0][1] == [HOSTILE, HOSTILE]
    assert HOSTILE in column(page, "scores", "AP")
    assert "alert(1)" not in page.source.replace(entities.escape("<script>alert(1)"), "")


def test_a_file_name_that_is_no_text_can_be_written(tmp_path: Path):
    failures = [Failure("road\udcff", None, "is not a picture")]
    evaluation = replace(made_run(["it"])[0], failures=failures)

    (tmp_path / "report.html").write_text(
        files.render_page(evaluation, {}, [], {}), encoding="utf-8"
    )

    assert "road\\udcff" in (tmp_path / "report.html").read_text(encoding="utf-8")


# --- in a browser --------------------------------------------------------------------------------


def browse(page: Path, folder: Path) -> tuple[str, set[str]]:
    """The page as Chromium has it after its scripts, and the addresses that it asked for."""
    assert CHROMIUM
    log = folder / "net.json"
    command = [
        *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"),
        *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
        "--host-resolver-rules=MAP * ~NOTFOUND",
        *(f"--user-data-dir={folder / 'profile'}", f"--log-net-log={log}"),
        *("--virtual-time-budget=2000", "--dump-dom", page.as_uri()),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    events = json.loads(log.read_text(encoding="utf-8"))["events"]
    asked = {event.get("params", {}).get("url", "") for event in events}
    return done.stdout, {url for url in asked if "example.org" in url}


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_browser_shows_it_and_asks_for_nothing(tmp_path: Path):
    evaluation, curves, rows = made_run([*NAMES, HOSTILE])
    report = tmp_path / "report.html"
    sheets = {"fusion": {"best": made_sheet()}}
    report.write_text(files.render_page(evaluation, curves, rows, sheets), encoding="utf-8")
    control = tmp_path / "control.html"
    control.write_text('<img src="http://example.org/x.png">', encoding="utf-8")

    dom, asked = browse(report, tmp_path)

    page = Page(dom)
    assert list(column(page, "scores", "AP")) == [*NAMES, HOSTILE]
    assert len(page.charts()) == 8
    assert len(page.named("img")) == 1
    assert page.named("button")  # its own script ran: the headers sort
    assert not asked
    assert browse(control, tmp_path)[1]  # the log would have told
