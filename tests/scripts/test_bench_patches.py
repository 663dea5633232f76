"""The benchmark of patches: both sides make the same number, and it prints a ratio."""

from pathlib import Path

import torch

from roadtorch.train.patches import PatchSamples
from roadtorch.train.processes import Processes
from scripts import bench_patches
from tests.scripts.conftest import PrintedBy


def test_both_sides_make_patches_of_the_same_sites(tmp_path: Path) -> None:
    files = bench_patches.prepare(None, 1, tmp_path)

    plain = bench_patches.PatchByPatch(files)
    samples = PatchSamples(files, bench_patches.TRAINING, Processes())

    batches = list(samples.batches(0, 0))
    assert sum(len(batch.inputs) for batch in batches) == len(plain)
    ours = torch.cat([batch.targets for batch in batches]).bincount(minlength=3)
    theirs = torch.tensor([label for _, _, label in plain.items]).bincount(minlength=3)
    assert torch.equal(ours, theirs)
    assert plain[0][0].shape == batches[0].inputs.shape[1:]


def test_it_prints_both_speeds_and_their_ratio(printed_by: PrintedBy) -> None:
    printed = printed_by(bench_patches, "--pictures", "1", "--rounds", "1")

    assert [line.split("|")[1].strip() for line in printed.splitlines()[2:]] == [
        "plain DataLoader",
        "in one pass",
        "ratio",
    ]
