"""Patch networks trained for a study: from prepared pictures to a network, nothing kept."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tqdm import tqdm

from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.train.config import PatchTraining
from roadtorch.train.loop import AverageWeights, TrainingSetup, make_optimiser, seeded, step
from roadtorch.train.patches import PatchSamples, squared_error
from roadtorch.train.processes import Processes


class StudiedNetwork(NamedTuple):
    """A network, ready for use, with the mean error and the patches of each of its epochs."""

    network: PatchNetwork
    errors: list[float]
    patches: list[int]


def train_patches(files: Sequence[Path], training: PatchTraining, epochs: int) -> StudiedNetwork:
    """A network trained on prepared pictures for that many epochs, in this process alone.

    The step length stays as it is: no schedule, and no rule that stops earlier.
    """
    processes = Processes()
    with seeded(training.random_seed, 0):
        network = PatchNetwork(training.network)
    samples = PatchSamples(files, training, processes)
    optimiser = make_optimiser(network, training.descent)
    average = AverageWeights(network, training.descent.average)
    setup = TrainingSetup(
        network, average, optimiser, samples, squared_error, training.descent, training.stopping
    )
    errors, patches = [], []
    for epoch in range(epochs):
        error, count = 0.0, 0
        for chunk in tqdm(range(samples.chunks), f"epoch {epoch + 1}", disable=None):
            for batch in samples.batches(epoch, chunk):
                error += step(setup, batch, processes)
                count += batch.count
        errors.append(error / max(1, count))
        patches.append(count)
    return StudiedNetwork(network.eval(), errors, patches)
