"""A run goes on where it was, and never on what another run counted."""

from pathlib import Path

import pytest
import torch

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.errors import ConfigError
from roadtorch.evaluation.progress import FILE, Progress, fingerprint
from roadtorch.evaluation.runner import Plan, run
from roadtorch.scenes import render_scene, write_camvid

DETECTORS = {"prior:rows": {}, "prior:triangle": {}}


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    scenes = {f"0001TP_{i}": render_scene(i, 32, 48) for i in range(4)}
    write_camvid(tmp_path / "set", "train", scenes)
    return open_dataset("camvid", tmp_path / "set", "train")


def test_counts_saved_and_gone_on_with_are_those_of_one_run(dataset, tmp_path):
    whole, first = Progress(None, "x"), Progress(tmp_path, "x")
    results = list(run(Plan(dataset, DETECTORS)))
    for result in results:
        whole.add(result)
    for result in (results[0], results[2]):
        first.add(result)
    first.save()

    second = Progress(tmp_path, "x")
    assert second.done == {"0001TP_0", "0001TP_2"}
    for result in run(Plan(dataset, DETECTORS), done=second.done):
        second.add(result)
    second.sort([item.name for item in dataset.items])

    assert second.tallies.keys() == whole.tallies.keys()
    for name, tally in whole.tallies.items():
        again = second.tallies[name]
        assert torch.equal(again.road["0001TP"].road, tally.road["0001TP"].road)
        assert [row.name for row in again.rows] == [row.name for row in tally.rows]
    second.finish()
    assert not (tmp_path / FILE).exists()


def test_the_progress_of_another_run_is_refused_and_kept(dataset, tmp_path):
    progress = Progress(tmp_path, "one")
    progress.add(next(iter(run(Plan(dataset, DETECTORS)))))
    progress.save()
    before = (tmp_path / FILE).read_bytes()

    with pytest.raises(ConfigError, match="another run"):
        Progress(tmp_path, "other")
    assert (tmp_path / FILE).read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"<html>not found</html>", b"\x08" + bytes(40)])
def test_a_file_that_is_no_progress_is_named(tmp_path, content):
    (tmp_path / FILE).write_bytes(content)

    with pytest.raises(ConfigError, match=rf"{FILE}: is not the progress of a run"):
        Progress(tmp_path, "x")


def test_what_makes_two_runs_different(dataset, tmp_path):
    base = fingerprint(dataset, {"a": {"threshold": 0.5}})

    assert fingerprint(dataset, {"a": {"threshold": 0.5}}) == base
    assert fingerprint(dataset, {"a": {"threshold": 0.6}}) != base
    assert fingerprint(dataset, {"b": {"threshold": 0.5}}) != base
    dataset.items[0].label.write_bytes(b"changed")
    assert fingerprint(dataset, {"a": {"threshold": 0.5}}) != base
