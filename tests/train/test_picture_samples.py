"""Batches of whole pictures: every picture once, the same for any number of processes."""

from pathlib import Path

import pytest
import torch

from roadtorch.train.arrays import write_arrays
from roadtorch.train.config import PictureTraining, build_training
from roadtorch.train.picture_samples import PictureSamples
from roadtorch.train.processes import Processes


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    paths = []
    for number in range(5):
        path = tmp_path / f"{number}.npz"
        maps = torch.randint(256, (4, 32, 40), generator=seeded(number)).to(torch.uint8)
        image = torch.full((3, 32, 40), 40 * number, dtype=torch.uint8)
        write_arrays(path, {"image": image, "maps": maps})
        paths.append(path)
    return paths


def training_of(**values: object) -> PictureTraining:
    network = {"height": 32, "width": 40, "narrow": 8, "wide": 8}
    found = build_training(
        {"kind": "pictures", "network": network, "descent": {"batch": 2}, **values}
    )
    assert isinstance(found, PictureTraining)
    return found


def test_an_epoch_has_every_picture_once(files: list[Path]) -> None:
    light = {"gamma": 0.0, "gain": 0.0, "tint": 0.0, "saturation": 0.0, "noise": 0.0}
    samples = PictureSamples(files, [], 0, training_of(light=light), Processes())

    batches = [batch for chunk in range(samples.chunks) for batch in samples.batches(0, chunk)]

    levels = torch.cat([batch.inputs for batch in batches]).mean((1, 2, 3))
    wanted = (torch.arange(5) * 40 / 255 - 0.5) * 4
    torch.testing.assert_close(levels.sort().values, wanted, atol=1e-3, rtol=0)
    assert all(batch.targets.shape[1:] == (6, 32, 40) for batch in batches)


@pytest.mark.parametrize("size", [2, 4])
def test_the_shares_of_a_team_are_the_batches_of_one(files: list[Path], size: int) -> None:
    training = training_of()
    (alone,) = PictureSamples(files, files, 1, training, Processes()).batches(3, 0)

    for rank in range(size):
        samples = PictureSamples(files, files, 1, training, Processes(rank, size))
        (part,) = samples.batches(3, 0)
        assert part.count == alone.count
        torch.testing.assert_close(part.inputs, alone.inputs[rank::size])
        torch.testing.assert_close(part.targets, alone.targets[rank::size])


def test_rounds_and_epochs_draw_differently(files: list[Path]) -> None:
    training = training_of()

    def first(number: int, epoch: int) -> torch.Tensor:
        return next(
            PictureSamples(files, [], number, training, Processes()).batches(epoch, 0)
        ).inputs

    assert torch.equal(first(0, 0), first(0, 0))
    assert not torch.equal(first(0, 0), first(1, 0))
    assert not torch.equal(first(0, 0), first(0, 1))
