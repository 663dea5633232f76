"""Batches of patches, and their loss.

tests/detectors/test_faithful.py has the centres, the labels and the augmentation of an epoch.
"""

from pathlib import Path

import pytest
import torch
from torch import nn

from roadtorch.run.memo import write_arrays
from roadtorch.train.config import PatchTraining, build_training
from roadtorch.train.patches import PatchSamples, squared_error
from roadtorch.train.training_loop import Batch
from tests.draws import seeded_generator


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write three prepared images with 7, 40 and 0 patches; the class is the row modulo 3."""
    folder, generator = tmp_path_factory.mktemp("prepared"), seeded_generator(9)
    for number, count in enumerate((7, 40, 0)):
        image = torch.randint(256, (3, 30, 40), generator=generator).to(torch.uint8)
        centres = torch.randint(30, (count, 2), generator=generator).to(torch.int16)
        classes = (centres[:, 0] % 3).to(torch.uint8)
        arrays = {"image": image, "centres": centres, "classes": classes}
        write_arrays(folder / f"{number}.npz", arrays)
    return sorted(folder.iterdir())


def test_an_epoch_has_every_patch_once(files: list[Path]) -> None:
    training = build_training({"shuffle_images": 2, "passes": 2, "descent": {"batch": 8}})
    assert isinstance(training, PatchTraining)
    samples = PatchSamples(files, training)

    batches = [batch for chunk in range(samples.chunks) for batch in samples.batches(0, chunk)]

    targets = torch.cat([batch.targets for batch in batches])
    assert sum(len(batch.inputs) for batch in batches) == len(targets) == 47
    assert all(len(batch.inputs) == len(batch.targets) for batch in batches)
    assert max(len(batch.inputs) for batch in batches) <= 12
    assert {tuple(batch.inputs.shape[1:]) for batch in batches} == {(3, 32, 32)}


def test_the_loss_is_the_weighted_sum_of_squares_to_one_hot() -> None:
    potentials, targets = torch.tensor([[0.2, 0.3, 0.9], [1, 0, 0]]), torch.tensor([2, 1])

    loss = squared_error(nn.Identity(), Batch(potentials, targets, torch.tensor([1.0, 2.0])))

    assert loss.item() == pytest.approx(0.04 + 0.09 + 0.01 + 2 * 2)
