"""Whole images: augmented batches with their targets, sampling, the loss."""

from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.run.memo import write_arrays
from roadtorch.train import effects
from roadtorch.train.config import HeadWeights, ImageTraining, build_training
from roadtorch.train.targets import TARGET_PLANES, Targets
from roadtorch.train.training_loop import Batch
from roadtorch.train.whole_images import (
    ImageSamples,
    balanced_weights,
    group_ego_cars,
    image_loss,
    name_recordings,
    sample_members,
    target_loss,
)
from tests.draws import seeded_generator
from tests.networks import SMALL_BACKBONE


def training_of(**values: object) -> ImageTraining:
    usual = {"network": SMALL_BACKBONE.model_dump(), "descent": {"batch": 2}}
    training = build_training({"kind": "images", **usual, **values})
    assert isinstance(training, ImageTraining)
    return training


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write five prepared images, each of one grey."""
    folder = tmp_path_factory.mktemp("prepared")
    paths = [folder / f"{number}.npz" for number in range(5)]
    for number, path in enumerate(paths):
        maps = torch.randint(256, (4, 32, 64), generator=seeded_generator(number)).to(torch.uint8)
        image = torch.full((3, 32, 64), 40 * number, dtype=torch.uint8)
        write_arrays(path, {"image": image, "maps": maps})
    return paths


def samples_of(files: list[Path]) -> ImageSamples:
    return ImageSamples(training_of(), files, torch.ones(5), {})


# --- batches -------------------------------------------------------------------------------


def test_an_epoch_has_every_image_once(files: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effects, "jitter_light", lambda images, _: images)
    samples = samples_of(files)

    batches = [batch for chunk in range(samples.chunks) for batch in samples.batches(0, chunk)]

    levels = torch.cat([batch.inputs for batch in batches]).mean((1, 2, 3))
    expected = torch.arange(5) * 40 / 255
    torch.testing.assert_close(levels.sort().values, expected, atol=1e-3, rtol=0)
    assert all(batch.targets.shape[1:] == (sum(TARGET_PLANES), 32, 64) for batch in batches)


def test_epochs_draw_differently(files: list[Path]) -> None:
    first, again, second = (next(samples_of(files).batches(epoch, 0)).inputs for epoch in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, second)


# --- visits --------------------------------------------------------------------------------


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=60), st.integers(0, 2**31))
def test_visits_are_fair_to_less_than_a_whole_one(values: list[float], seed: int) -> None:
    weights = torch.tensor(values)

    visits = sample_members(weights, len(weights), seeded_generator(seed)).bincount(
        minlength=len(weights)
    )

    fair = weights.double() / weights.double().sum() * len(weights)
    assert visits.sum() == len(weights)
    assert ((visits - fair).abs() < 1 + 1e-3).all()


NAMES = ("a_x_1", "a_x_2", "a_x_3", "b", "c")


@pytest.mark.parametrize(("balance", "weight"), [(0.0, 1.0), (0.5, 3**-0.5), (1.0, 1 / 3)])
def test_recordings_follow_from_names(balance: float, weight: float, tmp_path: Path) -> None:
    """Use a folder whose own name has the separator, and two names without it."""
    folder = tmp_path / "kept_here"
    folder.mkdir()
    files = [folder / f"{name}.png.npz" for name in NAMES]
    for file in files:  # all but the first show an ego car
        level = 128 if file == files[0] else 255
        write_arrays(file, {"ego": torch.full((2, 2), level, dtype=torch.uint8)})

    names = name_recordings(files, folder, "_")

    weights = balanced_weights(names, balance)
    assert weights == pytest.approx([weight, weight, weight, 1, 1])
    cars = group_ego_cars(files, names)
    assert cars == {"a_x": files[1:3], "b": files[3:4], "c": files[4:]}


# --- the loss -----------------------------------------------------------------------------


def test_the_loss_is_small_for_right_scores_and_ignores_what_does_not_count() -> None:
    layout = torch.tensor([1.0, 0, 0]).reshape(1, 3, 1, 1).expand(2, 3, 4, 4)
    ones = torch.ones(2, 1, 4, 4)
    right = torch.tensor([20.0, -20, -20, 20, -30]).reshape(1, 5, 1, 1).expand(2, 5, 4, 4)
    targets = Targets(layout, ones, ones, ones, 0 * ones, ones)
    none = targets._replace(layout_weight=0 * ones, road_weight=0 * ones, ego_weight=0 * ones)

    def loss(scores: torch.Tensor, road: float, ego: float, expected: Targets = targets) -> float:
        return float(target_loss(scores, expected, HeadWeights(road=road, ego=ego)))

    assert loss(right, 1, 1) < 1e-6
    assert loss(-right, 1, 1) == pytest.approx(2 * (40 + 20 + 30), rel=0.02)
    assert loss(-right, 1, 0) == pytest.approx(2 * (40 + 20), rel=0.02)
    assert loss(-right, 0, 0.5) == pytest.approx(2 * (40 + 15), rel=0.02)
    assert loss(-right, 1, 1, none) == 0


@pytest.mark.parametrize("kind", ["hard", "soft"])
def test_targets_are_the_best_class_or_the_potentials(kind: str) -> None:
    training = training_of(teacher={"targets": kind}, heads={"ego": 2.0})
    planes = torch.tensor([0.6, 0.3, 0.1, 1.0, 0.7, 1.0, 0.8, 1.0]).reshape(1, 8, 1, 1)
    scores = torch.zeros(1, 5, 1, 1, requires_grad=True)

    image_loss(torch.nn.Identity(), Batch(scores, planes), training).backward()

    assert scores.grad is not None
    expected = [1.0, 0, 0, 1.0] if kind == "hard" else [0.6, 0.3, 0.1, 0.7]
    start = torch.tensor([1 / 3, 1 / 3, 1 / 3, 0.5])
    torch.testing.assert_close(scores.grad.flatten()[:4], start - torch.tensor(expected))
    assert scores.grad.flatten()[4] == pytest.approx(2 * (0.5 - 0.8))  # the ego car stays soft


def test_targets_are_averaged_to_the_size_of_the_scores() -> None:
    training = training_of(teacher={"targets": "soft"})
    fine = torch.rand(2, 8, 6, 8, generator=seeded_generator(0))
    scores = torch.randn(2, 5, 3, 4, generator=seeded_generator(1))

    loss = image_loss(torch.nn.Identity(), Batch(scores, fine), training)

    small = fine.unfold(2, 2, 2).unfold(3, 2, 2).mean((4, 5)).split(TARGET_PLANES, 1)
    torch.testing.assert_close(loss, target_loss(scores, Targets(*small), training.heads))
