"""The benchmark of the one-class classifiers: every pair is timed, and peers rank as ours do."""

import json
from pathlib import Path

import pytest
import torch

from roadtorch.imaging.color import REPRESENTATIONS, planes
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.samples import SampleSettings, road_samples
from roadtorch.scenes.street import render_scene
from scripts import bench_oneclass
from tests.scripts.conftest import PrintedBy


def test_pairs_and_grid_are_printed_and_written(
    tmp_path: Path, printed_by: PrintedBy, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures = tmp_path / "figures.json"
    words = ["--sizes", "64x48,32x32", "--rounds", "1", "--grid-rounds", "1", "--threads", "1"]
    monkeypatch.setattr(bench_oneclass, "threadpool_limits", lambda threads: None)  # nor undone

    printed = printed_by(bench_oneclass, *words, "--json", figures)

    written = json.loads(figures.read_text())
    assert set(written["RGB"]) == set(bench_oneclass.PEERS)
    assert set(written["S"]) == set(bench_oneclass.PEERS) - {"pca"}
    assert written["grid"]["detectors"] == 310
    assert "The grid of 310 detectors at 32x32" in printed


@pytest.mark.parametrize("name", bench_oneclass.PEERS)
def test_a_peer_does_the_same(name: str) -> None:
    image, names = render_scene(1, 120, 160).image, REPRESENTATIONS["RGB"]
    samples = road_samples(image, names, SampleSettings())
    pixels = planes(image, names).flatten(1).T

    ours = fit(CLASSIFIERS[name], samples, axes_of(names)).distance(pixels)
    theirs = bench_oneclass.PEERS[name](samples.numpy(), pixels.numpy())

    ranks = [values.argsort().argsort().double() for values in (ours, torch.from_numpy(theirs))]
    together = abs(torch.corrcoef(torch.stack(ranks))[0, 1])
    assert together > (0.9 if name.startswith("mog") or name == "robust_gaussian" else 0.98)
    assert torch.isfinite(ours).all()
