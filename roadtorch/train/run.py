"""A whole training run: prepare images, train a network, write weights; resumable."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from signal import SIGTERM, Signals
from typing import Any

from pydantic import TypeAdapter, ValidationError

from roadtorch.base.atomic import share_folder, write_text
from roadtorch.base.compute import check_device, keep_freed_memory
from roadtorch.base.errors import ConfigError, InputError, WeightsError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest, stop_on_signals
from roadtorch.base.version import __version__
from roadtorch.data.corrections import HumanLabels
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.pretrained import add_norms, fold_norms
from roadtorch.layout.weights import (
    LayoutNetwork,
    build_network,
    load_network,
    resize_network,
    save_network,
    weights_path,
)
from roadtorch.train.config import ImageTraining, PatchTraining, SelfTraining, Training, as_values
from roadtorch.train.corrections import (
    corrections_by_image,
    corrections_summary,
    format_card,
    inherited_corrections,
    write_corrections,
)
from roadtorch.train.patches import PatchRecipe
from roadtorch.train.prepared import Preparation, PreparedImage, prepare
from roadtorch.train.recordings import select_held_out
from roadtorch.train.run_folder import (
    BAD_CHECKPOINT,
    CHECKPOINT,
    CORRECTIONS,
    PREPARED,
    WEIGHTS,
    RunFolder,
    config_hash,
    make_record,
)
from roadtorch.train.self_training import SelfTrainingRecipe
from roadtorch.train.training_loop import Loop, TrainingInputs, TrainingProgress, seed_torch
from roadtorch.train.whole_images import ImageRecipe, held_out_f

KindRecipe = PatchRecipe | ImageRecipe | SelfTrainingRecipe


@dataclass(frozen=True)
class TrainingRequest:
    """The inputs of a run.

    images: a folder, file or quoted glob. prepared: folder of prepared images; None for one inside
    ``out``. corrections: human corrections of some of the images. title: what comes before the
    epoch in reports. source: folders of images with a renderer's truth, for a self-training.
    command: command line, for the card.
    """

    images: str
    out: Path
    prepared: Path | None = None
    quiet: bool = False
    corrections: Sequence[HumanLabels] = ()
    title: str = ""
    source: Sequence[Path] = ()
    device: str = "cpu"
    command: str = ""


@dataclass(frozen=True)
class Outcome:
    """The result of a run: the weights, or the signal that interrupted it.

    held_out: labels of the images that did not train, but decided when training stopped.
    """

    weights: Path | None
    interrupted: Signals | None
    skipped: int
    held_out: Sequence[HumanLabels] = ()


def train(training: Training, request: TrainingRequest) -> Outcome:
    """Train a network on machine labels of images, or resume such a run.

    Raises InputError without a usable image and if another run holds the folder, ConfigError and
    WeightsError if the folder holds anything else than this run.
    """
    images = find_images([request.images], exclude=request.out)
    check_device(request.device, "--device")
    keep_freed_memory()  # steps take a third less time
    with stop_on_signals() as stop:
        folder = RunFolder(request.out)
        corrections, errors = corrections_by_image(images, request.corrections)
        initial = load_initial_network(training)
        recipe = make_recipe(training, request.source, len(corrections))
        with folder.lock():
            run = TrainingRun(training, recipe, initial, request, folder, stop, corrections, errors)
            return run.run(images)


def make_recipe(training: Training, source: Sequence[Path] = (), corrected: int = 0) -> KindRecipe:
    """Return the recipe for the kind of training and a number of corrected images.

    Raises ConfigError for source images that are missing, and for any input without effect.
    """
    if corrected and not isinstance(training, ImageTraining):
        message = f"are for trainings of the kind {ImageTraining.name}"
        raise ConfigError("--masks, --corrections", message, "give --config masks or corrections")
    if isinstance(training, SelfTraining):
        return SelfTrainingRecipe(training, source)
    if source:
        message = f"is for trainings of the kind {SelfTraining.name}"
        raise ConfigError("--source", message, "leave it out, or give --config fusion")
    if isinstance(training, ImageTraining):
        return ImageRecipe(training, corrected)
    return PatchRecipe(training)


def make_network(training: Training, number: int = 1) -> LayoutNetwork:
    """Return a new network with random weights; in a first round a backbone is normalised."""
    with seed_torch(training.random_seed, 0):
        network = build_network(training.network)
        if isinstance(network, BackboneNetwork) and not training.initial_weights and number == 1:
            add_norms(network.backbone)
    return network


def load_initial_network(training: Training) -> LayoutNetwork | None:
    """Load the network with the initial weights, at the training's image size; None without any.

    Raises WeightsError if its settings differ in anything but the size.
    """
    if training.is_new:
        return None
    network = load_network(weights_path(training.initial_weights))
    if isinstance(network, BackboneNetwork) and not isinstance(training, PatchTraining):
        network = resize_network(network, training.network.height, training.network.width)
    if network.settings != training.network:
        message = "holds a network with other settings than this training"
        hint = "give the same [network] settings, or leave initial_weights out"
        raise WeightsError(training.initial_weights, message, hint)
    return network


def prepare_folder(
    recipe: KindRecipe, images: Sequence[Item], folder: Path, stop: StopRequest, quiet: bool
) -> list[PreparedImage]:
    """Prepare images in a folder; fewer if a stop is requested."""
    with share_folder(folder):
        recipe.survey(images, folder, stop, quiet)
        if stop.requested:  # an incomplete survey prepares nothing
            return []
        preparation = Preparation(folder, recipe.key, recipe.prepare)
        return prepare(images, preparation, stop, quiet)


@dataclass(frozen=True)
class TrainingRun:
    """A run of a training in its folder.

    initial: network with the initial weights, if any. corrections, and errors of those that cannot
    be read, whose images are skipped: by name of the image.
    """

    training: Training
    recipe: KindRecipe
    initial: LayoutNetwork | None
    request: TrainingRequest
    folder: RunFolder
    stop: StopRequest
    corrections: Mapping[str, HumanLabels]
    errors: Mapping[str, str]

    def run(self, images: Sequence[Item]) -> Outcome:
        """Prepare the images and train the remaining epochs."""
        stop, folder = self.stop, self.folder
        summary = corrections_summary(self.corrections)
        source = [file for image in self.recipe.source for file in image.files]
        record = make_record(as_values(self.training), images, summary, source)
        folder.check(record)
        state = folder.read_checkpoint()
        folder.begin(record)
        inherited = [*inherited_corrections(self.training), *([summary] if summary else [])]
        prepared_folder = self.request.prepared or folder.path / PREPARED
        prepared = prepare_folder(self.recipe, images, prepared_folder, stop, self.request.quiet)
        for at, item in enumerate(prepared):
            if item.file and (error := self.errors.get(item.name)):
                Progress.write(f"roadtorch: skipped: {error}", file=sys.stderr)
                prepared[at] = PreparedImage(item.name, None, error)
        skipped = sum(item.file is None for item in prepared)
        held_out: list[str] = []
        if isinstance(self.training, ImageTraining):
            names = [item.name for item in prepared if item.file and item.name in self.corrections]
            separator = self.training.corrections.separator
            held_out = select_held_out(names, self.training.corrections.held_out, separator)
        if stop.requested or not self._train(prepared, state, inherited, held_out):
            return Outcome(None, stop.signal or SIGTERM, skipped)
        labels = tuple(self.corrections[name] for name in held_out)
        return Outcome(folder.path / WEIGHTS, None, skipped, labels)

    def _train(
        self,
        prepared: Sequence[PreparedImage],
        state: dict[str, Any] | None,
        inherited: Sequence[Mapping[str, object]],
        held_out: Sequence[str],
    ) -> bool:
        """Train the remaining epochs; return whether the last one was reached."""
        path = self.folder.path
        self.folder.write_images(prepared, held_out)
        files = {item.file: item.name for item in prepared if item.file is not None}
        if not files:
            raise InputError(self.request.images, "holds no usable image", "see the messages above")
        if len(files) == 1 and not self.request.quiet:
            text = "roadtorch: only one image: the network will not generalise to others"
            Progress.write(text, file=sys.stderr)
        corrected = write_corrections(
            path / CORRECTIONS, files, self.corrections, self.recipe.correct
        )
        validation = [corrected.pop(file) for file, name in files.items() if name in held_out]
        trained = [file for file, name in files.items() if name not in held_out]
        progress = _read_progress(state, path / CHECKPOINT) if state else TrainingProgress()
        inputs = TrainingInputs(trained, corrected, self.initial, path, device=self.request.device)
        network = self.initial or make_network(self.training, progress.round)
        while True:
            loop = self._train_round(network, inputs, progress, state, validation)
            network, state = loop.average.eval(), None
            network.load_state_dict(loop.best)
            if isinstance(network, BackboneNetwork):
                fold_norms(network.backbone)
            if not progress.finished:
                break
            result = self.recipe.finish_round(network, path, progress.round)
            if progress.round == self.recipe.rounds:
                network = result
                break
            progress = TrainingProgress(progress.round + 1, rows=progress.rows)
        self._write(network, progress, len(trained), inherited)
        return progress.finished

    def _train_round(
        self,
        network: LayoutNetwork,
        inputs: TrainingInputs,
        progress: TrainingProgress,
        state: dict[str, Any] | None,
        held_out: Sequence[Path],
    ) -> Loop:
        """Train the epochs of a round, or those after a checkpoint.

        held_out: images with corrections that judge it.
        """
        request, recipe, number = self.request, self.recipe, progress.round
        samples: Any = recipe.make_samples(inputs._replace(number=number), self.stop, request.quiet)
        if number == 1 and not state:
            recipe.initialise(network, samples)
        title = request.title
        if recipe.rounds > 1:
            title += f"round {number} of {recipe.rounds}, "
        validate = partial(held_out_f, files=held_out) if held_out else None
        options = (request.quiet, title, request.device, validate)
        loop = Loop(network, recipe, samples, progress, self.folder, self.stop, *options)
        if state:
            loop.restore(state)
        else:
            loop.save()
        loop.train()
        return loop

    def _write(
        self,
        network: LayoutNetwork,
        progress: TrainingProgress,
        used: int,
        inherited: Sequence[Mapping[str, object]],
    ) -> None:
        """Write the current weights and the loss curve."""
        path, config = self.folder.path / WEIGHTS, as_values(self.training)
        origin = {
            "roadtorch": __version__,
            "config": config,
            "config_sha256": config_hash(config),
            "images": used,
            "round": progress.round,
            "epochs": progress.epoch,
            "finished": progress.finished,
            "corrections": list(inherited),
        }
        card = format_card(inherited) if inherited else ""
        if isinstance(self.recipe, SelfTrainingRecipe):
            card += self.recipe.format_card(origin, self.request.command)
        if card:
            write_text(path.with_suffix(".md"), card)
        save_network(path, network, origin)
        if progress.rows:
            self.folder.write_curve(progress.rows)


def _read_progress(state: Mapping[str, object], path: Path) -> TrainingProgress:
    """Read the progress of a checkpoint; WeightsError if it is invalid."""
    try:
        return TypeAdapter(TrainingProgress).validate_python(state["progress"])
    except (KeyError, ValidationError):
        raise WeightsError(path, *BAD_CHECKPOINT) from None
