"""Patches: their centres, extraction and augmentation, their batches and their loss."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from roadtorch.layout.classes import HORIZONTAL, SKY, VERTICAL
from roadtorch.layout.patch_network import FIXED_GAIN
from roadtorch.run.memo import write_arrays
from roadtorch.train.config import PatchCentres, PatchTraining, build_training
from roadtorch.train.patches import (
    PatchRecipe,
    PatchSamples,
    Variation,
    add_noise,
    find_centres,
    sample_noise,
    sample_patches,
    sample_variation,
    squared_error,
)
from roadtorch.train.training_loop import Batch
from tests.draws import seeded_generator
from tests.reference import network as reference
from tests.streets import scene


def training_of(**values: object) -> PatchTraining:
    training = build_training({"shuffle_images": 2, "passes": 2, **values})
    assert isinstance(training, PatchTraining)
    return training


# --- where ---------------------------------------------------------------------------------


def test_centres_are_centroids_and_places_around_them_inside_the_image() -> None:
    segments = torch.zeros(9, 20, dtype=torch.int64)
    segments[:, 11:] = 1  # centroids (4, 5) and (4, 15)

    centres = find_centres(segments, PatchCentres(extra=4, radius=2))
    expected = [[4, 5], [6, 5], [4, 7], [2, 5], [4, 3], [4, 15], [6, 15], [4, 17], [2, 15], [4, 13]]
    assert centres.tolist() == expected

    far = find_centres(segments[:4, :6], PatchCentres(extra=8, radius=50))
    assert (far.amin(0).tolist(), far.amax(0).tolist()) == ([0, 0], [3, 5])


def test_a_street_gives_patches_with_the_labels_of_their_places() -> None:
    street = scene(4)

    arrays = PatchRecipe(training_of()).prepare(street.image, "")

    rows, columns = arrays["centres"].long().T
    truth = street.layout[rows, columns]
    assert arrays["image"].shape == (3, 240, 320)
    assert arrays["image"].dtype == torch.uint8
    assert len(rows) > 600
    assert set(arrays["classes"].tolist()) == {SKY, VERTICAL, HORIZONTAL}
    assert (truth == arrays["classes"]).float().mean() > 0.85


# --- how they are cut ----------------------------------------------------------------------


def drawn(centre: Tensor, scale: float = 1.0, turn: float = 0.0, noise: float = 0.0) -> Variation:
    ones = torch.ones(len(centre))
    return Variation(
        centre.float(), ones * scale, ones * turn, ones * noise, torch.arange(len(centre))
    )


@settings(max_examples=15)
@given(st.floats(0.6, 1.4), st.floats(-17, 17), st.integers(0, 17), st.integers(0, 22))
def test_varied_patches_are_slow_ones(scale: float, degrees: float, row: int, column: int) -> None:
    pixels = torch.rand(3, 18, 23, generator=seeded_generator(2))
    turn = math.radians(degrees)
    centre = torch.tensor([[row, column]])

    patch = sample_patches(pixels, drawn(centre, scale, turn), 12)[0]

    expected = reference.jittered_patch(pixels.double().numpy(), row, column, 12, scale, turn)
    np.testing.assert_allclose(patch.numpy(), expected, atol=2e-4)


def test_noise_is_in_grey_levels_of_255() -> None:
    generator = seeded_generator(5)
    draw = sample_variation(torch.zeros(300, 2), generator)._replace(noise=torch.full((300,), 0.8))

    noise = add_noise(torch.zeros(300, 3, 32, 32), draw, sample_noise(32, generator))

    assert float(noise.std()) * 255 / FIXED_GAIN == pytest.approx(0.8, rel=0.01)
    assert abs(float(noise.mean())) < 1e-3
    assert not torch.equal(noise[0], noise[1])


# --- batches -------------------------------------------------------------------------------


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


def all_batches(files: list[Path], training: PatchTraining, epoch: int = 0) -> list[Batch]:
    samples = PatchSamples(files, training)
    return [batch for chunk in range(samples.chunks) for batch in samples.batches(epoch, chunk)]


def test_an_epoch_has_every_patch_once(files: list[Path]) -> None:
    batches = all_batches(files, training_of(descent={"batch": 8}))

    targets = torch.cat([batch.targets for batch in batches])
    assert sum(len(batch.inputs) for batch in batches) == len(targets) == 47
    assert all(len(batch.inputs) == len(batch.targets) for batch in batches)
    assert max(len(batch.inputs) for batch in batches) <= 12
    assert {tuple(batch.inputs.shape[1:]) for batch in batches} == {(3, 32, 32)}


def test_the_loss_is_the_sum_of_squares_to_one_hot() -> None:
    potentials, targets = torch.tensor([[0.2, 0.3, 0.9], [1, 0, 0]]), torch.tensor([2, 1])

    loss = squared_error(nn.Identity(), Batch(potentials, targets))

    assert loss.item() == pytest.approx(0.04 + 0.09 + 0.01 + 2)
