"""Whole images: augmented batches with their targets, sampling, the loss."""

from pathlib import Path

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.base.signals import StopRequest
from roadtorch.run.memo import write_arrays
from roadtorch.train import effects
from roadtorch.train.config import HeadWeights, ImageTraining, build_training
from roadtorch.train.targets import TARGET_PLANES, Targets, split_targets
from roadtorch.train.training_loop import Batch, TrainingInputs
from roadtorch.train.whole_images import (
    ImageRecipe,
    ImageSamples,
    image_loss,
    sample_members,
    target_loss,
)
from tests.draws import seeded_generator

SAME_FRAME = {"scale": 0.0, "stretch": 0.0, "rotation": 0.0, "translation": 0.0}


def training_of(**values: object) -> ImageTraining:
    network = {"height": 32, "width": 40, "narrow": 8, "wide": 8}
    usual = {"network": network, "descent": {"batch": 2}, "recordings": {"separator": "_"}}
    training = build_training({"kind": "images", **usual, **values})
    assert isinstance(training, ImageTraining)
    return training


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Write five prepared images, each of one grey; the last shows an ego car."""
    folder = tmp_path_factory.mktemp("prepared")
    paths = [folder / f"{number}.npz" for number in range(5)]
    for number, path in enumerate(paths):
        maps = torch.randint(256, (4, 32, 40), generator=seeded_generator(number)).to(torch.uint8)
        image = torch.full((3, 32, 40), 40 * number, dtype=torch.uint8)
        ego = torch.full((32, 40), 128, dtype=torch.uint8)
        if number == 4:
            ego[:24], ego[24:] = 0, 255
        write_arrays(path, {"image": image, "maps": maps, "ego": ego})
    return paths


def samples_of(files: list[Path], training: ImageTraining, shows_ego: bool = False) -> ImageSamples:
    cars = {"drive": files[4:]} if shows_ego else {}
    return ImageSamples(training, files, torch.ones(5), cars)


# --- batches -------------------------------------------------------------------------------


def test_an_epoch_has_every_image_once(files: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effects, "jitter_light", lambda images, _: images)
    samples = samples_of(files, training_of())

    batches = [batch for chunk in range(samples.chunks) for batch in samples.batches(0, chunk)]

    levels = torch.cat([batch.inputs for batch in batches]).mean((1, 2, 3))
    expected = (torch.arange(5) * 40 / 255 - 0.5) * 4
    torch.testing.assert_close(levels.sort().values, expected, atol=1e-3, rtol=0)
    assert all(batch.targets.shape[1:] == (sum(TARGET_PLANES), 32, 40) for batch in batches)


def test_epochs_draw_differently(files: list[Path]) -> None:
    first, again, second = (
        next(samples_of(files, training_of()).batches(epoch, 0)).inputs for epoch in (0, 0, 1)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, second)


def targets_with(files: list[Path], probability: float, shows_ego: bool = True) -> Targets:
    """Return the targets of an epoch whose images keep their geometry."""
    varied = {"geometry": SAME_FRAME, "ego_car": probability}
    training = training_of(augmentation=varied, descent={"batch": 5})
    (batch,) = samples_of(files, training, shows_ego=shows_ego).batches(0, 0)
    return split_targets(batch.targets)


def test_every_image_can_get_an_ego_car(files: list[Path]) -> None:
    targets = targets_with(files, 1.0)
    assert (targets.ego[:, :, -1] == 1).all()
    assert (targets.ego_weight[:, :, -1] == 1).all()
    assert not targets.road[:, :, -1].any()
    assert targets.road[:, :, :8].flatten(1).any(1).all()  # above it, the road is what it was

    none = targets_with(files, 0.0)
    assert none.ego[:, 0, -1, 20].round().sort().values.tolist() == [0, 0, 0, 0, 1]  # its own
    unseen = (targets_with(files, value, shows_ego=False) for value in (0.0, 1.0))
    assert all(map(torch.equal, *unseen))  # no footage shows one


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
    recordings = {"separator": "_", "balance": balance}
    recipe = ImageRecipe(training_of(recordings=recordings, teacher={"detector": "labeller"}))

    recipe.survey([], folder, StopRequest(), True)
    samples = recipe.make_samples(TrainingInputs(files, {}, None, tmp_path), StopRequest(), True)

    assert samples.sampling_weights.tolist() == pytest.approx([weight, weight, weight, 1, 1])
    assert samples.ego_cars == {"a_x": files[1:3], "b": files[3:4], "c": files[4:]}


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

    image_loss(torch.nn.Identity(), Batch(scores, planes, torch.ones(1)), training).backward()

    assert scores.grad is not None
    expected = [1.0, 0, 0, 1.0] if kind == "hard" else [0.6, 0.3, 0.1, 0.7]
    start = torch.tensor([1 / 3, 1 / 3, 1 / 3, 0.5])
    torch.testing.assert_close(scores.grad.flatten()[:4], start - torch.tensor(expected))
    assert scores.grad.flatten()[4] == pytest.approx(2 * (0.5 - 0.8))  # the ego car stays soft


def test_targets_are_averaged_to_the_size_of_the_scores() -> None:
    training = training_of(teacher={"targets": "soft"})
    fine = torch.rand(2, 8, 6, 8, generator=seeded_generator(0))
    scores = torch.randn(2, 5, 3, 4, generator=seeded_generator(1))

    loss = image_loss(torch.nn.Identity(), Batch(scores, fine, torch.ones(2)), training)

    small = fine.unfold(2, 2, 2).unfold(3, 2, 2).mean((4, 5)).split(TARGET_PLANES, 1)
    torch.testing.assert_close(loss, target_loss(scores, Targets(*small), training.heads))
