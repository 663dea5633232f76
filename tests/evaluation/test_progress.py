"""A run goes on where it was, and never on what another run counted."""

from pathlib import Path

import pytest

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import leave_out
from roadtorch.errors import ConfigError
from roadtorch.evaluation.evaluate import FILE, fingerprint, read_progress, write_progress
from roadtorch.evaluation.methods import named_detector
from roadtorch.evaluation.tally import Tally
from tests.evaluation.conftest import GROUPS
from tests.streets import write_camvid


def test_the_progress_of_another_run_is_refused_and_kept(tmp_path):
    path = tmp_path / FILE
    write_progress(path, "one", {"it": Tally(pictures=[("a", "all")])})
    before = path.read_bytes()

    with pytest.raises(ConfigError, match="another run"):
        read_progress(path, "other")
    assert path.read_bytes() == before
    assert read_progress(path, "one")["it"].pictures == [("a", "all")]


@pytest.mark.parametrize("place", [0.05, 0.3, 0.6, 0.99, None])
def test_a_file_that_is_no_progress_or_has_a_flipped_bit_is_named(tmp_path: Path, place):
    path = tmp_path / FILE
    write_progress(path, "one", {"it": Tally()})
    data = bytearray(path.read_bytes() if place else b"<html>not found</html>")
    data[int((place or 0) * len(data))] ^= 1
    path.write_bytes(data)

    with pytest.raises(ConfigError, match=rf"{FILE}: is not the progress of a run, or damaged"):
        read_progress(path, "one")


def test_what_makes_two_runs_different(scenes, tmp_path):
    write_camvid(tmp_path, "train", scenes)
    dataset = open_dataset("camvid", tmp_path, "train")

    def run(name: str = "prior:rows", **settings: float) -> str:
        return fingerprint(dataset, [named_detector(name, settings)])

    base, rows = run(), [named_detector("prior:rows", {})]
    dataset.items[0].label.write_bytes(b"changed")
    others = {run(threshold=0.6), run("prior:triangle"), run()}
    others.add(fingerprint(leave_out(dataset, GROUPS[:1]), rows))

    assert run() == run()
    assert len({base, *others}) == 5
