"""Batches of patches: every site once, the same for any number of processes; their error."""

from pathlib import Path

import pytest
import torch

from roadtorch.errors import InputError
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings
from roadtorch.train.config import PatchTraining, build_training
from roadtorch.train.loop import Batch
from roadtorch.train.patches import PatchSamples, class_weights, squared_error
from roadtorch.train.prepared import write_arrays
from roadtorch.train.processes import Processes


def training_of(**values: object) -> PatchTraining:
    found = build_training({"mix": 2, "passes": 2, **values})
    assert isinstance(found, PatchTraining)
    return found


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Three prepared pictures with 7, 40 and 0 sites; a site's class is its row modulo 3."""
    generator = torch.Generator().manual_seed(9)
    paths = []
    for number, count in enumerate((7, 40, 0)):
        image = torch.randint(256, (3, 30, 40), generator=generator).to(torch.uint8)
        sites = torch.randint(30, (count, 2), generator=generator).to(torch.int16)
        classes = (sites[:, 0] % 3).to(torch.uint8)
        paths.append(tmp_path / f"{number}.npz")
        write_arrays(paths[-1], {"image": image, "sites": sites, "classes": classes})
    return paths


def all_batches(
    files: list[Path], training: PatchTraining, processes: Processes, epoch: int
) -> list[Batch]:
    samples = PatchSamples(files, training, processes)
    return [b for chunk in range(samples.chunks) for b in samples.batches(epoch, chunk)]


def test_an_epoch_has_every_site_once(files: list[Path]) -> None:
    training = training_of(descent={"batch": 8})

    batches = all_batches(files, training, Processes(), epoch=0)

    targets = torch.cat([batch.targets for batch in batches])
    assert sum(batch.count for batch in batches) == len(targets) == 47
    assert all(len(batch.inputs) == batch.count for batch in batches)
    assert max(batch.count for batch in batches) <= 12
    assert {tuple(batch.inputs.shape[1:]) for batch in batches} == {(3, 32, 32)}


def test_epochs_differ_and_each_is_the_same_again(files: list[Path]) -> None:
    training = training_of()

    one, again, two = (all_batches(files, training, Processes(), epoch) for epoch in (0, 0, 1))

    assert all(torch.equal(a.inputs, b.inputs) for a, b in zip(one, again, strict=True))
    assert not torch.equal(one[0].inputs[:3], two[0].inputs[:3])


@pytest.mark.parametrize("size", [2, 3])
def test_the_shares_of_a_team_are_the_batches_of_one(files: list[Path], size: int) -> None:
    training = training_of(descent={"batch": 8})

    alone = all_batches(files, training, Processes(), epoch=2)
    shares = [all_batches(files, training, Processes(rank, size), 2) for rank in range(size)]

    for whole, *parts in zip(alone, *shares, strict=True):
        assert all(part.count == whole.count for part in parts)
        for rank, part in enumerate(parts):
            torch.testing.assert_close(part.inputs, whole.inputs[rank::size])
            assert part.targets.tolist() == whole.targets[rank::size].tolist()


def test_classes_weigh_the_same_where_asked(files: list[Path]) -> None:
    training = training_of(balance="classes")

    batches = all_batches(files, training, Processes(), epoch=0)

    targets = torch.cat([batch.targets for batch in batches])
    weights = torch.cat([batch.weights for batch in batches])
    sums = torch.bincount(targets, weights=weights, minlength=3)
    torch.testing.assert_close(sums, torch.full((3,), 47 / 3))
    assert class_weights(files, training_of()).tolist() == [1, 1, 1]


def test_pictures_without_a_certain_label_are_told(files: list[Path]) -> None:
    with pytest.raises(InputError, match=r"no superpixel whose label is certain"):
        PatchSamples(files[2:], training_of(), Processes())


def test_the_error_is_the_sum_of_squares_to_one_hot() -> None:
    network = PatchNetwork(PatchNetworkSettings())
    inputs = torch.randn(4, 3, 32, 32, generator=torch.Generator().manual_seed(3))
    targets, weights = torch.tensor([0, 2, 1, 1]), torch.tensor([1.0, 2.0, 1.0, 0.5])

    error = squared_error(network, Batch(inputs, targets, weights, 4))

    found = network(inputs).detach().numpy()
    wanted = sum(
        float(w) * sum((found[i, k] - (k == t)) ** 2 for k in range(3))
        for i, (t, w) in enumerate(zip(targets.tolist(), weights.tolist(), strict=True))
    )
    assert error.item() == pytest.approx(wanted, rel=1e-5)
