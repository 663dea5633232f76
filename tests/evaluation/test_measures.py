"""Measures: one object each, which all tables and files use."""

from pathlib import Path

import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measure import Measure
from roadtorch.evaluation.measures import MAXF, MEASURES
from tests.oracle import GROUPS, register_oracle, write_set

DOCUMENT = Path(__file__).parents[2] / "docs/evaluation.md"


def test_a_formula_that_replicates_cannot_compute_is_named(tmp_path):
    register_oracle()
    dataset = open_dataset("camvid", write_set(tmp_path / "camvid"))
    wrong = Measure("seen", "seen", "Images.", lambda part: part.images and 1.0, interval=True)

    with pytest.raises(
        TypeError, match="the formula of seen uses counts that bootstrap replicates lack"
    ):
        evaluate(dataset, ["prior:rows"], measures=(MAXF, wrong))


def test_keys_are_unique_and_directions_respected():
    assert len({measure.key for measure in MEASURES}) == len(MEASURES)
    by_key = {measure.key: measure for measure in MEASURES}
    nan = float("nan")
    assert by_key["brier"].best([0.2, nan, 0.1]) == 0.1
    assert MAXF.best([0.2, nan, 0.1]) == 0.2
    assert MAXF.best([nan]) is by_key["threshold"].best([0.5]) is None


def test_the_example_in_the_document_runs(tmp_path, monkeypatch, capsys):
    section = DOCUMENT.read_text(encoding="utf-8").split("## From Python")[1]
    code = section.split("```python\n")[1].split("```")[0]
    write_set(tmp_path / "data/camvid")
    monkeypatch.chdir(tmp_path)

    exec(compile(code, "docs/evaluation.md", "exec"), {})

    output = capsys.readouterr().out
    assert "prior:mean" in output
    assert all(group in output for group in GROUPS)
    assert "alarms" in (tmp_path / "results/report.html").read_text()
