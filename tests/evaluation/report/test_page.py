"""Report of an evaluation: one whole page, and that it runs and loads nothing."""

import os
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from roadtorch.evaluation.report.files import write_report
from roadtorch.evaluation.report.montage import caption_tile
from roadtorch.evaluation.result import Evaluation, Failure
from tests.oracle import ORACLE
from tests.reports import replace_scores

GOLDEN = Path(__file__).with_name("report.html")
HOSTILE = '"><script>alert(1)</script><img src="http://example.org/x.png">\udcff'
UNSETTLED = (
    (r"(?s)<style>.*</style>", "<style></style>"),
    (r"data:(image/[\w+]+);base64,[^\"]+", r"data:\1"),
    (r"<td>\d+\.\d</td>", "<td>MS</td>"),
    (r"roadtorch \d[\w.+]*", "roadtorch VERSION"),
)
"""Style, images, times and the version, and what stands there instead."""


def test_a_whole_page_is_as_it_was(oracle_run: Evaluation, tmp_path: Path) -> None:
    """Compare with the golden page; UPDATE_GOLDEN=1 writes it."""
    write_report(oracle_run, tmp_path, "roadtorch evaluate camvid data", images=1)

    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for pattern, word in UNSETTLED:
        page = re.sub(pattern, word, page)
    if os.environ.get("UPDATE_GOLDEN"):
        GOLDEN.write_text(page, encoding="utf-8")
    assert page == GOLDEN.read_text(encoding="utf-8")


class Tags(HTMLParser):
    """Tags of a page with their attributes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))


def test_names_are_escaped_and_the_page_loads_nothing(
    oracle_run: Evaluation, tmp_path: Path
) -> None:
    scores = oracle_run.detectors[ORACLE]
    evaluation = replace(
        replace_scores(oracle_run, ORACLE, contender=replace(scores.contender, name=HOSTILE)),
        dataset=replace(oracle_run.dataset, split=HOSTILE),
        comparison=replace(oracle_run.comparison, against=HOSTILE),
        failures=[Failure(HOSTILE, HOSTILE, HOSTILE)],
    )

    write_report(evaluation, tmp_path, HOSTILE, images=0)

    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    tags = Tags(page).tags
    assert not {tag for tag, _ in tags} & {"script", "link", "iframe", "object", "embed", "base"}
    policy = next(values["content"] for tag, values in tags if "http-equiv" in values)
    assert policy is not None
    assert policy.startswith("default-src 'none'; img-src data:; style-src 'unsafe-inline';")
    for tag, values in tags:
        for name in {"src", "href", "srcset", "data", "action"} & values.keys():
            assert str(values[name]).startswith(("data:image/", "#")), (tag, values)
    assert "alert(1)" not in page.replace("&lt;script&gt;alert(1)", "")
    assert page.count("\\udcff") == page.count("&lt;script&gt;alert(1)")


def test_a_name_that_is_not_utf_8_can_be_a_caption() -> None:
    tile = caption_tile(np.zeros((30, 40, 3), np.uint8), os.fsdecode(b"z\xff.jpg"), 30)

    assert tile[:20].any()
