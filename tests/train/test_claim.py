"""The study of P2's claim: who teaches, what is scored, noise, measures."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest
import torch

from roadtorch.data.dataset import Truth
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL
from tests.draws import random
from train import claim, claim_scores
from train.superpixels import SuperpixelTeacher, learn_trees

GROUND = slice(80, None)


def street(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return an image (3, 120, 160) of sky, wall and ground, and its layout."""
    layout = torch.full((120, 160), VERTICAL)
    layout[:40], layout[GROUND] = SKY, HORIZONTAL
    colours = torch.tensor([[0.6, 0.7, 0.9], [0.5, 0.3, 0.2], [0.3, 0.3, 0.3]])
    noise = 0.1 * random(3, 120, 160, seed=seed, dtype=torch.float32)
    return colours[layout].permute(2, 0, 1) + noise, layout


@pytest.fixture(scope="module")
def trees(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("worlds")
    for number in range(4):
        image, layout = street(number)
        pixels = (255 * image.permute(1, 2, 0).flip(2)).byte()
        for kind, values in (("images", pixels), ("truth", layout.byte())):
            (folder / kind).mkdir(exist_ok=True)
            cv2.imwrite(str(folder / kind / f"{number}_town_sun.png"), values.numpy())
    learn_trees([folder], folder / "trees", 4, Superpixels())
    return folder / "trees"


def test_trees_of_superpixels_label_a_street_that_they_have_not_seen(trees: Path) -> None:
    image, layout = street(9)

    potentials = SuperpixelTeacher(trees, Superpixels()).potentials(image)

    torch.testing.assert_close(potentials.sum(0), torch.ones(120, 160, dtype=torch.float64))
    assert (potentials.argmax(0) == layout).double().mean() > 0.95


def test_no_image_that_teaches_is_scored(data_root: Path) -> None:
    for domain in claim.DOMAINS:
        _, teaching, scored = claim.split_domain(data_root, domain)
        assert not {item.image for item in teaching} & {item.image for item in scored}
        if domain != "idd":
            assert {item.group for item in scored} == {domain}
            assert domain not in {item.group for item in teaching}


@pytest.mark.parametrize("rate", [0.2, 0.5])
def test_independent_noise_replaces_a_rate_of_labels_and_none_that_is_void(rate: float) -> None:
    image, layout = street(0)
    layout[:, :30] = UNLABELLED
    run = claim.Run("truth", "0006R0", "cnn7", 0, noise="independent", rate=rate)

    noisy = claim.disturb(layout, image, run)

    known = layout != UNLABELLED
    assert torch.equal(noisy[~known], layout[~known])
    assert (noisy[known] != layout[known]).double().mean() == pytest.approx(rate, abs=0.12)


def test_all_errors_of_the_labeller_make_its_labels() -> None:
    image, layout = street(0)
    every = claim.Run("truth", "0006R0", "cnn7", 0, noise="confused", rate=1.0)
    labeller = claim_scores.make_labeller("untuned", Path())

    noisy = claim.disturb(layout, image, every)

    assert torch.equal(noisy, labeller(image)[0].argmax(0))


def test_ranks_tell_potentials_apart_that_round_to_one() -> None:
    others = torch.tensor([[1e-6, 1e-9], [1e-12, 0.5]], dtype=torch.float64)
    potentials = torch.stack([others / 2, others / 2, 1 - others])

    odds = claim_scores.as_teacher(potentials)[1]

    ranks = ((odds / claim_scores.STRETCH).sigmoid() * (claim_scores.RANKS - 1)).round()
    assert ranks.flatten().argsort().tolist() == [3, 0, 1, 2]
    assert len(ranks.unique()) == 4


def test_scores_of_a_perfect_teacher_are_perfect() -> None:
    image, layout = street(1)
    truth = Truth(layout == HORIZONTAL, layout != UNLABELLED, layout)
    dataset: Any = SimpleNamespace(read=lambda _: (image, truth))
    one_hot = torch.nn.functional.one_hot(layout, 3).permute(2, 0, 1).double()
    perfect = claim_scores.as_teacher((one_hot + 1e-6) / (1 + 3e-6))
    items: Any = [SimpleNamespace(group="a")]

    scores = claim_scores.measure(claim_scores.count_images(dataset, items, lambda _: perfect))

    for key in ("mean recall", "recall sky", "AP", "AUC", "F"):
        assert float(scores[key][0]) == pytest.approx(1, abs=0.01), key
