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
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadtorch import __version__
from roadtorch.evaluation.document import DetectorCurves
from roadtorch.evaluation.measures import MEASURES
from roadtorch.evaluation.report import charts, files
from roadtorch.evaluation.report.montage import captioned
from roadtorch.evaluation.result import Comparison, Difference, Evaluation, Failure, Interval
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
    without_group,
)

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
HOSTILE = '"><script>alert(1)</script><img src="http://example.org/x.png">'


def render(evaluation, curves=None, rows=(), sheets=None) -> Page:
    return Page(files.render_page(evaluation, curves or {}, rows, sheets or {}, COMMAND))


@pytest.fixture(scope="module")
def page() -> Page:
    sheets = {"fusion": {part: made_sheet() for part in ("worst", "best", "median")}}
    return render(*made_run(), sheets)


@pytest.fixture
def _no_charts(monkeypatch):
    kinds = ("f_mask", "maxf", "paired", "roc", "pr", "reliability", "risk", "pictures")
    monkeypatch.setattr(charts, "all_charts", lambda *_: dict.fromkeys(kinds, ""))


def column(page: Page, section: str, header: str, table: int = 0) -> dict[str, str]:
    """A column's text by row name, with a plain minus."""
    head, *rows = page.tables[section][table]
    place = [name.replace("\n", " ") for name in head].index(header)
    return {row[0]: row[place].replace("\N{MINUS SIGN}", "-") for row in rows}


# --- numbers -------------------------------------------------------------------------------------


def test_the_scores_are_those_of_the_document(page):
    detectors = made_run()[0].detectors
    keys = {"MaxF": "maxf", "AUC": "auc_pooled", "AP": "ap", "IoU": "iou", "Brier": "brier"}

    for header, key in keys.items():
        assert column(page, "scores", header) == {
            name: f"{detectors[name].headline[key]:.3f}" for name in NAMES
        }
    for place, group in enumerate(GROUPS):
        parts = {name: detectors[name].groups[group] for name in NAMES}
        assert column(page, "scores", f"MaxF {group}") == {
            name: f"{part['maxf']:.3f}" for name, part in parts.items()
        }
        assert column(page, "groups", "IoU", place)["labeller"] == f"{parts['labeller']['iou']:.3f}"
    assert len(page.tables["groups"]) == len(GROUPS) + 1  # and all pooled
    low, high = detectors["cpf:v2"].interval
    assert column(page, "scores", "95 %")["cpf:v2"] == f"{low:.3f}–{high:.3f}"
    assert set(column(page, "scores", "ms /image").values()) == {"12.3"}
    assert len(page.charts()) == 8
    assert list(column(page, "trust", "AURC")) == list(NAMES)


def test_the_distance_to_the_best_baseline_stands_beside_every_score(page):
    scores = {name: one.headline["maxf"] for name, one in made_run()[0].detectors.items()}

    found = column(page, "scores", "above baseline")

    assert found["prior:mean"] == "+0.000"
    for name, text in found.items():
        assert float(text) == pytest.approx(scores[name] - scores["prior:mean"], abs=5e-4)


def test_differences_have_their_intervals(page):
    change = made_run()[0].comparison.differences["labeller"]["maxf"]

    found = column(page, "pairs", "MaxF")

    low, high = change.interval
    assert found["labeller"] == f"{change.value:+.3f}{low:+.3f} to {high:+.3f}"
    assert "fusion" not in found


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


@pytest.mark.usefixtures("_no_charts")
def test_the_best_is_first_and_baselines_are_marked():
    evaluation = made_run()[0]
    shuffled = replace(evaluation, detectors=dict(sorted(evaluation.detectors.items())))

    page = render(shuffled)

    assert list(column(page, "scores", "AP")) == list(NAMES)
    assert {*page.rows_of_baselines} == {"prior:mean", "prior:rows"}


@pytest.mark.usefixtures("_no_charts")
def test_detectors_that_share_a_layout_share_its_tables():
    evaluation = made_run(["a", "b", "c"])[0]
    a = evaluation.detectors["a"]
    evaluation = changed(evaluation, "b", headline=a.headline, groups=a.groups)
    other = {**a.headline, "layout/sky": 0.1}
    evaluation = changed(evaluation, "c", headline=other, groups=a.groups)

    page = render(evaluation)

    heat, recalls, *_ = page.tables["layout"]
    assert len(page.tables["layout"]) == 4
    assert "a, b" in page.text["layout"]
    assert heat[0] == ["truth", "sky", "vertical", "horizontal"]
    assert heat[2] == ["vertical", "0.050", "0.900", "0.050"]
    assert [row[0] for row in recalls] == ["group", *GROUPS, "mean"]


@pytest.mark.usefixtures("_no_charts")
def test_the_worst_group_is_on_top_and_its_figures_stand_out():
    cameras = [f"camera{number}" for number in range(8)]
    evaluation = without_group(made_run(["fusion", "prior:rows"], cameras)[0], "camera5")

    page = render(evaluation)

    fusion, rows = evaluation.detectors["fusion"], evaluation.detectors["prior:rows"].groups
    parts = {
        **fusion.groups,
        "mean": fusion.headline,
        "camera5 (left out)": fusion.group("camera5"),
    }
    found = column(page, "worst", "F of mask")
    assert found == {name: f"{figures['f_mask']:.3f}" for name, figures in parts.items()}
    assert list(found) == list(parts)
    assert column(page, "worst", "MaxF of baseline")["camera0"] == f"{rows['camera0']['maxf']:.3f}"
    worst = f"<b>{fusion.groups['camera0']['f_mask']:.3f}</b>"
    assert worst in page.source.split('id="worst"')[1]
    assert "camera5 left out of every mean and choice" in page.text["head"]
    assert "camera5 (left out)" in page.text["groups"]


@pytest.mark.usefixtures("_no_charts")
def test_conditions_have_a_table_with_the_number_of_their_groups():
    page = render(with_conditions(made_run(["fusion", "prior:rows"])[0]))

    assert column(page, "conditions", "F of mask") == {
        "night (1 group)": "0.300", "day (3 groups)": "0.800"
    }  # fmt: skip


def test_sheets_are_jpeg_inside_the_page_best_first(page):
    pictures = page.named("img")

    assert [one["alt"].split()[0] for one in pictures] == ["Best", "Median", "Worst"]
    assert {decoded(one["src"]) for one in pictures} == {(24, 64, 3)}


def test_a_wide_sheet_is_made_as_wide_as_the_page_shows_it():
    shown = made_sheet(width=2400, height=300)

    assert decoded(shown["uri"]) == (150, 1200, 3)
    assert (shown["width"], shown["height"]) == ("1200", "150")


def decoded(uri: str) -> tuple[int, ...]:
    """The size of a picture inside the page."""
    kind, data = uri.split(",")
    assert kind == "data:image/jpeg;base64"
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None
    return pixels.shape


@pytest.mark.usefixtures("_no_charts")
def test_of_many_sheets_and_failures_the_first_are_shown_and_the_others_counted():
    names = [f"d{i}" for i in range(11)]
    failures = [Failure(f"picture {i}", None, "broken") for i in range(250)]
    evaluation = replace(made_run(names)[0], failures=failures)

    page = render(evaluation, sheets={name: {"best": made_sheet()} for name in names})

    assert len(page.named("img")) == 8
    assert "Sheets of 3 more detectors" in page.text["looked-at"]
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


def test_undefined_figures_are_dashes():
    evaluation, curves, rows = made_run()
    for name, one in evaluation.detectors.items():
        undefined = dict.fromkeys(one.headline, math.nan)
        evaluation = changed(
            evaluation, name, headline=undefined, pooled=undefined,
            groups=dict.fromkeys(one.groups, undefined), intervals={"maxf": Interval()},
        )  # fmt: skip
    nothing = {"maxf": Difference(math.nan, Interval())}
    differences = dict.fromkeys(evaluation.comparison.differences, nothing)
    evaluation = replace(evaluation, comparison=Comparison("fusion", differences))
    nowhere = [[math.nan] * 3] * 3
    kinds = {"roc": nowhere, "pr": nowhere, "reliability": nowhere}
    curves = {name: DetectorCurves(mean=kinds, groups={}) for name in curves}

    page = render(evaluation, curves, [replace(row, f=math.nan) for row in rows])

    for header in ("MaxF", "95 %", "above baseline"):
        assert set(column(page, "scores", header).values()) == {"–"}
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

    page = render(*made_run(names))

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
    contender = made_contender(HOSTILE, {HOSTILE: HOSTILE})
    evaluation = replace(
        changed(evaluation, HOSTILE, threshold_from=HOSTILE, contender=contender),
        dataset=replace(evaluation.dataset, name=HOSTILE, split=HOSTILE),
        failures=[Failure(HOSTILE, HOSTILE, HOSTILE)],
    )

    page = Page(files.render_page(
        evaluation, curves, rows, {HOSTILE: {"best": made_sheet()}}, HOSTILE
    ))  # fmt: skip

    assert len(page.named("script")) == 1
    assert [one["src"][:5] for one in page.named("img")] == ["data:"]
    assert page.tables["failures"][0][1] == [HOSTILE, HOSTILE]
    assert HOSTILE in column(page, "scores", "AP")
    assert "alert(1)" not in page.source.replace(entities.escape("<script>alert(1)"), "")


@pytest.mark.usefixtures("_no_charts")
def test_a_file_name_that_is_no_text_can_be_written():
    failures = [Failure("road\udcff", None, "is not a picture")]

    source = files.render_page(replace(made_run(["it"])[0], failures=failures), {}, [], {})

    assert b"road\\udcff" in source.encode("utf-8")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
def test_a_browser_shows_it_and_asks_for_nothing(tmp_path: Path):
    assert CHROMIUM
    evaluation, curves, rows = made_run([*NAMES, HOSTILE])
    report, log = tmp_path / "report.html", tmp_path / "net.json"
    sheets = {"fusion": {"best": made_sheet()}}
    source = files.render_page(evaluation, curves, rows, sheets)
    command = [
        *(CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run"),
        *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
        "--host-resolver-rules=MAP * ~NOTFOUND",
        *(f"--user-data-dir={tmp_path / 'profile'}", f"--log-net-log={log}"),
        *("--virtual-time-budget=2000", "--dump-dom", report.as_uri()),
    ]

    def browse(text: str) -> tuple[str, bool]:
        """A page as the browser has it after its scripts, and whether it asked for anything."""
        report.write_text(text, encoding="utf-8")
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
        events = json.loads(log.read_text(encoding="utf-8"))["events"]
        urls = [event.get("params", {}).get("url", "") for event in events]
        return done.stdout, any("example.org" in url for url in urls)

    dom, asked = browse(source)

    page = Page(dom)
    assert list(column(page, "scores", "AP")) == [*NAMES, HOSTILE]
    assert len(page.charts()) == 8
    assert len(page.named("img")) == 1
    assert page.named("button")  # its own script ran: the headers sort
    assert not asked
    assert browse('<img src="http://example.org/x.png">')[1]  # the log would have told
