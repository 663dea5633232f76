"""A whole run: pictures made ready, rounds trained, weights written; cut short, gone on with."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from signal import SIGTERM, Signals
from typing import Any

import torch
from tqdm import tqdm

from roadtorch.data.corrections import Correction
from roadtorch.errors import InputError, WeightsError
from roadtorch.io.atomic import shared, write_text
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import LayoutNetwork, fill, load_network, save_network
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.train.average import AverageWeights
from roadtorch.train.cards import card_of, corrections_behind
from roadtorch.train.config import Training, as_values
from roadtorch.train.corrected_fusion import write_corrected
from roadtorch.train.corrections import (
    corrections_by_picture,
    corrections_told,
    keep_corrections,
    paced,
)
from roadtorch.train.folder import CHECKPOINT, NO_CHECKPOINT, WEIGHTS, RunFolder, config_hash
from roadtorch.train.loop import (
    RunContext,
    TrainingProgress,
    TrainingSetup,
    make_optimiser,
    save_checkpoint,
    train_round,
)
from roadtorch.train.prepared import PreparedFolder, PreparedPicture
from roadtorch.train.processes import join_processes
from roadtorch.train.recipe import PreparedFiles, Recipe, recipe_of
from roadtorch.version import __version__

PREPARED, SAID = "prepared", "corrections"

FUSION = "fusion.toml"
"""A config for the detector ``fusion`` with the weights of a run with corrections."""


@dataclass(frozen=True)
class Request:
    """What a run is asked for.

    images: a folder, a file or a quoted glob. prepared: where pictures made ready are kept;
    None for a folder inside ``out``. corrections: what people said of some of the pictures.
    """

    images: str
    out: Path
    resume: bool = False
    prepared: Path | None = None
    quiet: bool = False
    corrections: Sequence[Correction] = ()


@dataclass(frozen=True)
class Outcome:
    """What became of a run: the weights, or the signal that cut it short."""

    weights: Path | None
    interrupted: Signals | None
    skipped: int


def train(training: Training, request: Request) -> Outcome:
    """Train a network on machine labels of pictures, or go on with it.

    Raises InputError when there is no picture to learn from, ConfigError and WeightsError
    when the folder holds something else than this run, InputError when another one is in it.
    """
    pictures = find_images([request.images], apart=request.out)
    with stop_on_signals() as stop, join_processes() as processes:
        folder = RunFolder(request.out)
        context = RunContext(processes, folder, stop, request.quiet)
        config = as_values(training)
        recipe = recipe_of(training)
        with processes.led(folder.held()):
            corrections = corrections_by_picture(pictures, request.corrections)
            told = corrections_told(corrections)
            halfway = training.corrections.halfway
            recipe.descent = paced(recipe.descent, halfway, len(corrections))
            folder.begin(config, pictures, told, request.resume)
            state = folder.read_checkpoint()
            processes.gather(None)  # all have looked before the first one writes
            if processes.leads:
                folder.claim(config, pictures, told, __version__)
            behind = [*corrections_behind(training), *([told] if told else [])]
            return _Run(recipe, request, context, config, corrections, behind).go(pictures, state)


@dataclass(frozen=True)
class _Run:
    recipe: Recipe
    request: Request
    context: RunContext
    config: dict[str, Any]
    corrections: Mapping[str, Correction]
    behind: Sequence[Mapping[str, Any]]

    def go(self, pictures: Sequence[Picture], state: dict[str, Any] | None) -> Outcome:
        processes, folder, stop, _ = self.context
        prepared = self._prepared(pictures)
        skipped = sum(item.file is None for item in prepared)
        if processes.any(stop.asked):
            return Outcome(None, stop.signal or SIGTERM, skipped)
        people = self._people(prepared)
        files = PreparedFiles(self._usable(prepared), self._said(people))
        progress = _progress_of(state, folder.path / CHECKPOINT) if state else TrainingProgress()
        while True:
            self._round(files, progress, state)
            state = None
            if not progress.finished:
                return Outcome(None, stop.signal or SIGTERM, skipped)
            if progress.round + 1 == self.recipe.rounds:
                self._trust(list(people.values()))
                return Outcome(folder.path / WEIGHTS, None, skipped)
            progress.begin_round(progress.round + 1)

    def _prepared(self, pictures: Sequence[Picture]) -> list[PreparedPicture]:
        """The pictures made ready; fewer where somebody asked to stop."""
        processes, folder, stop, quiet = self.context
        path = self.request.prepared or folder.path / PREPARED
        small = PreparedFolder(path, processes, stop, quiet)
        with processes.led(shared(path)):
            small.claim(self.recipe.preparation())
            self.recipe.survey(pictures, path, self.context)
            if processes.any(stop.asked):  # nothing is made ready by half a survey
                return []
            return small.prepare(pictures, self.recipe.make, "labels")

    def _usable(self, prepared: Sequence[PreparedPicture]) -> list[Path]:
        if self.context.processes.leads:
            self.context.folder.write_pictures(prepared)
        files = [item.file for item in prepared if item.file is not None]
        if not files:
            raise InputError(self.request.images, "holds no picture that can be used", "see above")
        if len(files) == 1 and self.context.processes.leads and not self.request.quiet:
            text = "roadtorch: one picture only: the network will know that one and no other"
            tqdm.write(text, file=sys.stderr)
        return files

    def _people(self, prepared: Sequence[PreparedPicture]) -> dict[Path, Correction]:
        """The corrections of the pictures that can be used, by the prepared file."""
        return {
            item.file: self.corrections[item.name]
            for item in prepared
            if item.file is not None and item.name in self.corrections
        }

    def _said(self, people: Mapping[Path, Correction]) -> dict[Path, Path]:
        """What people said, at the network's size; each process has a copy of its own."""
        own = self.context.folder.path / SAID / f"process-{self.context.processes.rank}"
        return keep_corrections(own, people, self.recipe.shrink) if people else {}

    def _trust(self, people: Sequence[Correction]) -> None:
        """A config of ``fusion`` beside the weights, where corrections say what road is."""
        weights = self.context.folder.path / WEIGHTS
        whole = self.config["kind"] == PictureNetwork.kind
        if people and whole and self.context.processes.leads:
            write_corrected(weights.with_name(FUSION), weights, people)

    def _round(
        self, files: PreparedFiles, progress: TrainingProgress, state: dict[str, Any] | None
    ) -> None:
        """Train one round, or what is left of it, and write its weights."""
        number, folder = progress.round, self.context.folder
        last = self.recipe.start
        if number:
            last = load_network(folder.path / _weights_of(number - 1))
        samples = self.recipe.samples(files, number, last, self.context)
        network = self.recipe.network(number, last)
        average = AverageWeights(network, self.recipe.descent.average)
        optimiser = make_optimiser(network, self.recipe.descent)
        if state:
            _go_on(network, average, optimiser, state, folder.path / CHECKPOINT)
        setup = TrainingSetup(
            network,
            average,
            optimiser,
            samples,
            self.recipe.error_function,
            self.recipe.descent,
            self.recipe.stopping,
        )
        if not state:
            save_checkpoint(setup, progress, self.context)
        train_round(setup, progress, self.context)
        self._write(average.network.eval(), progress, len(files.files))
        self.context.processes.gather(None)  # the next round reads what the first one writes

    def _write(self, network: LayoutNetwork, progress: TrainingProgress, used: int) -> None:
        """The weights as they are, finished or not, and the curve so far."""
        if not self.context.processes.leads:
            return
        if progress.round and not progress.finished:
            return  # the weights of the last round are better than half of this one
        folder = self.context.folder
        origin = {
            "roadtorch": __version__,
            "config": self.config,
            "config_sha256": config_hash(self.config),
            "pictures": used,
            "round": progress.round + 1,
            "epochs": progress.epoch,
            "finished": progress.finished,
            "corrections": list(self.behind),
        }
        if self.behind:
            write_text((folder.path / WEIGHTS).with_suffix(".md"), card_of(self.behind))
        save_network(folder.path / WEIGHTS, network, origin)
        if progress.finished:
            save_network(folder.path / _weights_of(progress.round), network, origin)
        if progress.rows:
            folder.write_curve(progress.rows)


def _progress_of(state: dict[str, Any], path: Path) -> TrainingProgress:
    """How far a checkpoint says the run is; WeightsError where it does not say."""
    try:
        progress = TrainingProgress(**state["progress"])
    except (KeyError, TypeError):
        raise WeightsError(path, *NO_CHECKPOINT) from None
    like = TrainingProgress()
    if any(type(getattr(progress, name)) is not type(value) for name, value in vars(like).items()):
        raise WeightsError(path, *NO_CHECKPOINT)
    return progress


def _go_on(
    network: LayoutNetwork,
    average: AverageWeights,
    optimiser: torch.optim.Optimizer,
    state: dict[str, Any],
    path: Path,
) -> None:
    """Fill what is trained from a checkpoint; WeightsError where it does not fit."""
    try:
        fill(network, state["network"], path)
        fill(average.network, state.get("average", state["network"]), path)  # older code had none
        optimiser.load_state_dict(state["optimiser"])
    except (KeyError, TypeError, ValueError, AttributeError):
        raise WeightsError(path, *NO_CHECKPOINT) from None


def _weights_of(number: int) -> str:
    """The file of the weights at the end of round ``number`` (from 0)."""
    return f"round-{number + 1}.safetensors"
