"""Batches of whole pictures: every picture once, the same for any number of processes."""

from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.train.config import PictureTraining, build_training
from roadtorch.train.pictures import PictureSamples, Prepared, visits
from roadtorch.train.prepared import write_arrays
from roadtorch.train.processes import Processes
from roadtorch.train.teachers import PLANES, Targets

DARK = {"gamma": 0.0, "gain": 0.0, "tint": 0.0, "saturation": 0.0, "noise": 0.0}
"""Light as it is."""


def seeded(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """Five prepared pictures, each of one grey; the last shows an ego car."""
    paths = []
    for number in range(5):
        path = tmp_path / f"{number}.npz"
        maps = torch.randint(256, (4, 32, 40), generator=seeded(number)).to(torch.uint8)
        image = torch.full((3, 32, 40), 40 * number, dtype=torch.uint8)
        ego = torch.full((32, 40), 128, dtype=torch.uint8)
        if number == 4:
            ego[:24], ego[24:] = 0, 255
        write_arrays(path, {"image": image, "maps": maps, "ego": ego})
        paths.append(path)
    return paths


@pytest.fixture
def labels(tmp_path: Path) -> list[Path]:
    """What a network said of them."""
    paths = []
    for number in range(5):
        path = tmp_path / f"labels-{number}.npz"
        maps = torch.randint(256, (5, 32, 40), generator=seeded(number + 9)).to(torch.uint8)
        write_arrays(path, {"maps": maps})
        paths.append(path)
    return paths


def prepared(files: list[Path], labels: list[Path], shows_ego: bool = False) -> Prepared:
    return Prepared(files, labels, torch.ones(5), {"drive": files[4:]} if shows_ego else {})


def training_of(**values: object) -> PictureTraining:
    network = {"height": 32, "width": 40, "narrow": 8, "wide": 8}
    found = build_training(
        {
            "kind": "pictures",
            "network": network,
            "descent": {"batch": 2},
            "recordings": {"separator": "_"},
            **values,
        }
    )
    assert isinstance(found, PictureTraining)
    return found


# --- batches -------------------------------------------------------------------------------


def test_an_epoch_has_every_picture_once(files: list[Path]) -> None:
    samples = PictureSamples(prepared(files, []), 0, training_of(light=DARK), Processes())

    batches = [batch for chunk in range(samples.chunks) for batch in samples.batches(0, chunk)]

    levels = torch.cat([batch.inputs for batch in batches]).mean((1, 2, 3))
    wanted = (torch.arange(5) * 40 / 255 - 0.5) * 4
    torch.testing.assert_close(levels.sort().values, wanted, atol=1e-3, rtol=0)
    assert all(batch.targets.shape[1:] == (sum(PLANES), 32, 40) for batch in batches)


@pytest.mark.parametrize("size", [2, 4])
def test_the_shares_of_a_team_are_the_batches_of_one(
    files: list[Path], labels: list[Path], size: int
) -> None:
    training = training_of(ego_cars={"share": 0.5})
    given = prepared(files, labels, shows_ego=True)
    (alone,) = PictureSamples(given, 1, training, Processes()).batches(3, 0)

    for rank in range(size):
        (part,) = PictureSamples(given, 1, training, Processes(rank, size)).batches(3, 0)
        assert part.count == alone.count
        torch.testing.assert_close(part.inputs, alone.inputs[rank::size])
        torch.testing.assert_close(part.targets, alone.targets[rank::size])


def test_rounds_and_epochs_draw_differently(files: list[Path]) -> None:
    training = training_of()

    def first(number: int, epoch: int) -> torch.Tensor:
        samples = PictureSamples(prepared(files, []), number, training, Processes())
        return next(samples.batches(epoch, 0)).inputs

    assert torch.equal(first(0, 0), first(0, 0))
    assert not torch.equal(first(0, 0), first(1, 0))
    assert not torch.equal(first(0, 0), first(0, 1))


# --- ego cars ------------------------------------------------------------------------------


def said_of(given: Prepared, share: float) -> Targets:
    """The targets of an epoch whose pictures stay in their frame."""
    still = {"scale": 0.0, "stretch": 0.0, "rotation": 0.0, "move": 0.0}
    training = training_of(shift=still, ego_cars={"share": share}, descent={"batch": 5})
    (batch,) = PictureSamples(given, 0, training, Processes()).batches(0, 0)
    return Targets(*batch.targets.split(PLANES, 1))


def test_every_picture_can_get_an_ego_car(files: list[Path]) -> None:
    said = said_of(prepared(files, [], shows_ego=True), 1.0)

    assert (said.ego[:, :, -1] == 1).all()
    assert (said.ego_weight[:, :, -1] == 1).all()
    assert not said.road[:, :, -1].any()
    assert said.road[:, :, :8].flatten(1).any(1).all()  # above it, the road is what it was


def test_without_a_share_only_its_own_picture_shows_it(files: list[Path]) -> None:
    said = said_of(prepared(files, [], shows_ego=True), 0.0)

    assert said.ego[:, 0, -1, 20].round().sort().values.tolist() == [0, 0, 0, 0, 1]


def test_where_no_footage_shows_one_a_share_changes_nothing(files: list[Path]) -> None:
    one, other = (said_of(prepared(files, []), share) for share in (0.0, 1.0))

    assert all(torch.equal(*pair) for pair in zip(one, other, strict=True))


# --- visits --------------------------------------------------------------------------------


@given(st.integers(1, 400), st.floats(1e-3, 1e3), st.integers(0, 2**31))
def test_with_equal_shares_everyone_is_visited_once(count: int, share: float, seed: int) -> None:
    order = visits(torch.full((count,), share), count, seeded(seed))

    assert sorted(order.tolist()) == list(range(count))


def test_the_order_is_drawn() -> None:
    at, shares = seeded(1), torch.ones(50)

    assert not torch.equal(visits(shares, len(shares), at), visits(shares, len(shares), at))


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=60), st.integers(0, 2**31))
def test_nobody_is_visited_a_whole_time_more_or_less_than_is_fair(
    values: list[float], seed: int
) -> None:
    shares = torch.tensor(values)

    found = visits(shares, len(shares), seeded(seed)).bincount(minlength=len(shares))

    fair = shares.double() / shares.double().sum() * len(shares)
    assert found.sum() == len(shares)
    assert ((found - fair).abs() < 1 + 1e-3).all()


def test_shares_of_one_and_three_are_visited_in_that_ratio() -> None:
    shares, at = torch.tensor([1.0, 3.0]).repeat(5), seeded(2)

    drawn = sum(visits(shares, len(shares), at).bincount(minlength=10) for _ in range(2000))

    assert isinstance(drawn, torch.Tensor)
    fair = torch.tensor([0.5, 1.5]).repeat(5)
    torch.testing.assert_close(drawn / 2000, fair, atol=0.05, rtol=0)  # 4.5 deviations
