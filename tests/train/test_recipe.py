"""What networks for whole pictures take from the footage as a whole."""

from pathlib import Path

import pytest
import torch

from roadtorch.runtime.signals import Stop
from roadtorch.train import pictures
from roadtorch.train.config import PictureTraining
from roadtorch.train.folder import RunFolder
from roadtorch.train.loop import RunContext
from roadtorch.train.pictures import Prepared
from roadtorch.train.prepared import write_arrays
from roadtorch.train.processes import Processes
from tests.train.runs import training_of


def write_ego(file: Path, seen: bool) -> Path:
    """A prepared picture that shows an ego car, or of which nothing is known."""
    file.parent.mkdir(exist_ok=True)
    write_arrays(file, {"ego": torch.full((2, 2), 255 if seen else 128, dtype=torch.uint8)})
    return file


@pytest.mark.parametrize(("evenness", "share"), [(0.0, 1.0), (0.5, 3**-0.5), (1.0, 1 / 3)])
def test_recordings_are_told_by_the_names_of_pictures_wherever_they_are_kept(
    evenness: float, share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kept folder's own name has the separator; the names of two pictures have none."""
    folder = tmp_path / "kept_here"
    files = [write_ego(folder / f"{name}.png.npz", name != "a_1") for name in PICTURES]
    training = training_of("pictures", tmp_path, f"recordings.evenness={evenness}")
    assert isinstance(training, PictureTraining)
    made = pictures.PictureRecipe(training)
    context = RunContext(Processes(), RunFolder(tmp_path), Stop(), quiet=True)
    given: list[Prepared] = []
    monkeypatch.setattr(pictures, "PictureSamples", lambda prepared, *_: given.append(prepared))

    made.survey([], folder, context)
    made.samples(files, {}, 0, None, context)

    assert given[0].shares.tolist() == pytest.approx([share, share, share, 1, 1])
    assert given[0].ego_cars == {"a": files[1:3], "b": files[3:4], "c": files[4:]}


PICTURES = ("a_1", "a_2", "a_3", "b", "c")
