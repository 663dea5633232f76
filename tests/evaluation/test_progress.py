"""A run goes on where it was, and never on what another run counted."""

from pathlib import Path

import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.errors import ConfigError
from roadtorch.evaluation.evaluate import FILE, SavedTallies, fingerprint
from roadtorch.evaluation.methods import named_detector
from roadtorch.evaluation.scoring import score
from roadtorch.scenes.street import render_scene
from tests.streets import write_camvid

BASELINES = [named_detector(name, {}) for name in ("prior:rows", "prior:triangle")]


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    scenes = {f"0001TP_{i}": render_scene(i, 32, 48) for i in range(4)}
    write_camvid(tmp_path / "set", "train", scenes)
    return open_dataset("camvid", tmp_path / "set", "train")


def save_first(dataset: Dataset, folder: Path) -> bytes:
    """Save the progress of the run ``one`` after its first picture; what is saved."""
    progress = SavedTallies(folder, "one")
    progress.add(next(iter(score(dataset, BASELINES))))
    progress.save()
    return (folder / FILE).read_bytes()


def test_the_progress_of_another_run_is_refused_and_kept(dataset, tmp_path):
    before = save_first(dataset, tmp_path)

    with pytest.raises(ConfigError, match="another run"):
        SavedTallies(tmp_path, "other")
    assert (tmp_path / FILE).read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"<html>not found</html>", b"\x08" + bytes(40)])
def test_a_file_that_is_no_progress_is_named(tmp_path, content):
    (tmp_path / FILE).write_bytes(content)

    with pytest.raises(ConfigError, match=rf"{FILE}: is not the progress of a run"):
        SavedTallies(tmp_path, "x")


@pytest.mark.parametrize("place", [0.05, 0.3, 0.6, 0.99])
def test_a_flipped_bit_is_never_counted_on(dataset, tmp_path, place):
    data = bytearray(save_first(dataset, tmp_path))
    data[int(place * len(data))] ^= 1
    (tmp_path / FILE).write_bytes(data)

    with pytest.raises(ConfigError, match=rf"{FILE}: is not the progress of a run, or damaged"):
        SavedTallies(tmp_path, "one")


def test_what_makes_two_runs_different(dataset):
    def run(name: str = "prior:rows", **settings: float) -> str:
        return fingerprint(dataset, [named_detector(name, settings)])

    base = run()

    assert run() == base
    assert run(threshold=0.6) != base
    assert run("prior:triangle") != base
    dataset.items[0].label.write_bytes(b"changed")
    assert run() != base
