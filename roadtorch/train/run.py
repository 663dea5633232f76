"""A whole run: pictures made ready, rounds trained, weights written; cut short, gone on with."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from signal import SIGTERM, Signals
from typing import Any

from pydantic import TypeAdapter, ValidationError

from roadtorch.data.corrections import Correction
from roadtorch.errors import InputError, WeightsError
from roadtorch.io.atomic import shared, write_text
from roadtorch.layout.weights import (
    LayoutNetwork,
    WholePictureNetwork,
    fill,
    load_network,
    network_at,
    save_network,
    weights_path,
)
from roadtorch.runtime.progress import Progress
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.sources.pictures import Picture, find_images
from roadtorch.train.config import PictureTraining, Training, as_values
from roadtorch.train.corrections import (
    card_of,
    corrections_behind,
    corrections_by_picture,
    corrections_summary,
    paced,
    write_corrected,
    write_corrections,
)
from roadtorch.train.folder import (
    CHECKPOINT,
    NO_CHECKPOINT,
    WEIGHTS,
    RunFolder,
    config_hash,
    record_of,
)
from roadtorch.train.loop import MovingAverage, Round, RoundStart, TrainingProgress, make_optimiser
from roadtorch.train.patches import PatchRecipe
from roadtorch.train.pictures import PictureRecipe
from roadtorch.train.prepared import PreparedFolder, PreparedPicture
from roadtorch.train.processes import Processes, join_processes
from roadtorch.version import __version__

Recipe = PatchRecipe | PictureRecipe

PREPARED, CORRECTIONS = "prepared", "corrections"

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
    with stop_on_signals() as stop, join_processes(stop, request.quiet) as processes:
        folder = RunFolder(request.out)
        start, recipe = load_start(training), recipe_of(training)
        with processes.led(folder.held()):
            corrections = corrections_by_picture(pictures, request.corrections)
            summary = corrections_summary(corrections)
            record = record_of(as_values(training), pictures, summary)
            folder.check(record, request.resume)
            state = folder.read_checkpoint()
            processes.gather(None)  # all have looked before the first one writes
            if processes.leads:
                folder.begin(record)
            behind = [*corrections_behind(training), *([summary] if summary else [])]
            run = _Run(training, recipe, start, request, folder, processes, corrections, behind)
            return run.go(pictures, state)


def recipe_of(training: Training) -> Recipe:
    """What the kind of network that the settings describe brings to its training."""
    if isinstance(training, PictureTraining):
        return PictureRecipe(training)
    return PatchRecipe(training)


def load_start(training: Training) -> LayoutNetwork | None:
    """The network of the weights that a run starts from; None where it starts from none.

    One for whole pictures may have learned at another size; it goes on at that of the settings.
    WeightsError when it is not one of these settings otherwise.
    """
    if not training.start:
        return None
    network, settings = load_network(weights_path(training.start)), training.network
    if isinstance(network, WholePictureNetwork) and isinstance(training, PictureTraining):
        settings = training.network
        network = network_at(network, settings.height, settings.width)
    if network.settings != settings:
        what = "holds a network with other settings than this training"
        remedy = "give the same [network] settings, or leave start out"
        raise WeightsError(training.start, what, remedy)
    return network


def made_ready(
    recipe: Recipe, pictures: Sequence[Picture], folder: Path, processes: Processes
) -> list[PreparedPicture]:
    """The pictures made ready in a folder; fewer where somebody asked to stop."""
    small = PreparedFolder(folder, processes)
    with processes.led(shared(folder)):
        small.claim(recipe.preparation())
        recipe.survey(pictures, folder, processes)
        if processes.stopped():  # nothing is made ready by half a survey
            return []
        return small.prepare(pictures, recipe.make, "labels")


@dataclass(frozen=True)
class _Run:
    training: Training
    recipe: Recipe
    start: LayoutNetwork | None
    request: Request
    folder: RunFolder
    processes: Processes
    corrections: Mapping[str, Correction]
    behind: Sequence[Mapping[str, Any]]

    def go(self, pictures: Sequence[Picture], state: dict[str, Any] | None) -> Outcome:
        """Make the pictures ready and train the rounds that are left, from a checkpoint if any."""
        processes, path = self.processes, self.folder.path
        folder = self.request.prepared or path / PREPARED
        prepared = made_ready(self.recipe, pictures, folder, processes)
        skipped = sum(item.file is None for item in prepared)
        if processes.stopped():
            return Outcome(None, processes.stop.signal or SIGTERM, skipped)
        files = self._usable(prepared)
        people = {
            item.file: self.corrections[item.name]
            for item in prepared
            if item.file is not None and item.name in self.corrections
        }
        own = path / CORRECTIONS / f"process-{processes.rank}"  # each has its own copy
        corrected = write_corrections(own, people, self.recipe.shrink) if people else {}
        progress = _progress_of(state, path / CHECKPOINT) if state else TrainingProgress()
        while True:
            self._round(files, corrected, progress, state)
            state = None
            if not progress.finished:
                return Outcome(None, processes.stop.signal or SIGTERM, skipped)
            if progress.round + 1 == self.recipe.rounds:
                break
            progress = TrainingProgress(progress.round + 1, rows=progress.rows)
        if people and isinstance(self.training, PictureTraining) and processes.leads:
            write_corrected(path / FUSION, path / WEIGHTS, list(people.values()))
        return Outcome(path / WEIGHTS, None, skipped)

    def _usable(self, prepared: Sequence[PreparedPicture]) -> list[Path]:
        """The files of the pictures that were not skipped; the list of all is written."""
        if self.processes.leads:
            self.folder.write_pictures(prepared)
        files = [item.file for item in prepared if item.file is not None]
        if not files:
            raise InputError(self.request.images, "holds no picture that can be used", "see above")
        if len(files) == 1 and not self.processes.silent:
            text = "roadtorch: one picture only: the network will know that one and no other"
            Progress.write(text, file=sys.stderr)
        return files

    def _round(
        self,
        files: Sequence[Path],
        corrected: Mapping[Path, Path],
        progress: TrainingProgress,
        state: dict[str, Any] | None,
    ) -> None:
        """Train one round, or what is left of it, and write its weights."""
        training, number, folder = self.training, progress.round, self.folder
        last = load_network(folder.path / _weights_of(number - 1)) if number else self.start
        begun = RoundStart(number, files, corrected, last)
        samples = self.recipe.samples(begun, folder, self.processes)
        network = self.recipe.network(begun)
        descent = paced(training.descent, training.corrections.halfway, len(self.corrections))
        average = MovingAverage(network, descent.ema)
        optimiser = make_optimiser(network, descent)
        if state:
            path = folder.path / CHECKPOINT
            try:
                fill(network, state["network"], path)
                fill(average.network, state.get("average", state["network"]), path)  # in older code
                optimiser.load_state_dict(state["optimiser"])
            except (KeyError, TypeError, ValueError, AttributeError):
                raise WeightsError(path, *NO_CHECKPOINT) from None
        parts = (network, average, optimiser, samples.chunks, samples.batches, self.recipe.loss)
        rules = (descent, training.stopping)
        this = Round(*parts, *rules, progress, folder, self.processes)
        if not state:
            this.save()
        this.train()
        if self.processes.leads and (progress.finished or not progress.round):
            self._write(average.network.eval(), progress, len(files))
        self.processes.gather(None)  # the next round reads what the first one writes

    def _write(self, network: LayoutNetwork, progress: TrainingProgress, used: int) -> None:
        """The weights as they are, and the curve so far; half of a later round is not worth it."""
        folder, config = self.folder, as_values(self.training)
        origin = {
            "roadtorch": __version__,
            "config": config,
            "config_sha256": config_hash(config),
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
    """How far a checkpoint of format 1 or 2 says the run is; WeightsError where it does not say."""

    def renamed(values: Mapping[str, Any]) -> dict[str, Any]:
        names = {"error": "loss", "rate": "learning_rate"}  # of format 1
        return {names.get(key, key): value for key, value in values.items()}

    try:
        values = renamed(state["progress"])
        rows = [renamed(row) for row in values.pop("rows", [])]
        return TypeAdapter(TrainingProgress).validate_python({**values, "rows": rows})
    except (KeyError, TypeError, AttributeError, ValidationError):
        raise WeightsError(path, *NO_CHECKPOINT) from None


def _weights_of(number: int) -> str:
    """The file of the weights at the end of round ``number`` (from 0)."""
    return f"round-{number + 1}.safetensors"
