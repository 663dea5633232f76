"""Networks that ``train/claim.py`` trains side by side; here on the CPU."""

import math
import time
from pathlib import Path

import pytest
import torch

from roadtorch.layout.weights import load_network
from roadtorch.train.config import PatchTraining
from tests.draws import random
from tests.train.conftest import Trained
from tests.train.runs import rows_of, training_of
from train import patches_gpu


def test_both_convolutions_of_several_networks_are_one() -> None:
    maps, kernels = random(2, 3, 4, 9, 8), random(2, 5, 4, 3, 3, seed=1)

    unfolded, grouped = patches_gpu.convolve_unfolded, patches_gpu.convolve_grouped

    torch.testing.assert_close(unfolded(maps, kernels), grouped(maps, kernels))


def test_networks_side_by_side_learn_what_each_learns_alone(
    trained: Trained, streets: Path, cache: Path, tmp_path: Path
) -> None:
    changes = [("descent.momentum=0.9",), ("random_seed=1", "descent.schedule=cosine")]
    students = []
    for number, change in enumerate(changes):
        training = training_of("patches", *change)
        assert isinstance(training, PatchTraining)
        files = patches_gpu.prepare_files(training, str(streets), cache / "patches")
        students.append(patches_gpu.make_student(tmp_path / str(number), training, files))

    cpu, deadline = torch.device("cpu"), time.monotonic() + math.inf
    patches_gpu.train_side_by_side(students, cpu, deadline)

    for student, change in zip(students, changes, strict=True):
        alone = trained("patches", *change).weights
        assert alone is not None
        expected, actual = load_network(alone), load_network(student.folder / alone.name)
        for name, weights in expected.state_dict().items():
            torch.testing.assert_close(actual.state_dict()[name], weights, rtol=1e-3, atol=1e-4)
        losses = [
            [float(row["loss"]) for row in rows_of(path)] for path in (alone.parent, student.folder)
        ]
        assert losses[1] == pytest.approx(losses[0], rel=1e-4)
        assert (student.folder / "done").exists()
