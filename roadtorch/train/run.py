"""A whole run: images made ready, a network trained, weights written; and resumed."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from signal import SIGTERM, Signals
from typing import Any

from pydantic import TypeAdapter, ValidationError

from roadtorch.base.atomic import shared, write_text
from roadtorch.base.errors import InputError, WeightsError
from roadtorch.base.progress import Progress
from roadtorch.base.signals import Stop, stop_on_signals
from roadtorch.base.version import __version__
from roadtorch.data.corrections import Correction
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.layout.weights import (
    LayoutNetwork,
    WholeImageNetwork,
    load_network,
    network_at,
    save_network,
    weights_path,
)
from roadtorch.train.config import ImageTraining, Training, as_values
from roadtorch.train.corrections import (
    card_of,
    corrections_behind,
    corrections_by_image,
    corrections_summary,
    paced,
    write_corrected,
    write_corrections,
)
from roadtorch.train.folder import (
    CHECKPOINT,
    LABELS,
    NO_CHECKPOINT,
    WEIGHTS,
    RunFolder,
    config_hash,
    record_of,
)
from roadtorch.train.images import ImageRecipe
from roadtorch.train.loop import Loop, TrainingInputs, TrainingProgress
from roadtorch.train.patches import PatchRecipe
from roadtorch.train.prepared import Preparation, PreparedImage, prepare

Recipe = PatchRecipe | ImageRecipe

PREPARED, CORRECTIONS = "prepared", "corrections"

FUSION = "fusion.toml"
"""A config for the detector ``fusion`` with the weights of a run with corrections."""


@dataclass(frozen=True)
class Request:
    """The inputs of a run.

    images: a folder, a file or a quoted glob. prepared: where images made ready are kept;
    None for a folder inside ``out``. corrections: of people, for some of the images. part: which
    of how many alike runs this is, for the bar.
    """

    images: str
    out: Path
    prepared: Path | None = None
    quiet: bool = False
    corrections: Sequence[Correction] = ()
    part: tuple[int, int] = (1, 1)


@dataclass(frozen=True)
class Outcome:
    """The result of a run: the weights, or the signal that cut it short."""

    weights: Path | None
    interrupted: Signals | None
    skipped: int


def train(training: Training, request: Request) -> Outcome:
    """Train a network on machine labels of images, or resume such a run.

    Raises InputError when there is no image to learn from, ConfigError and WeightsError
    when the folder holds something else than this run, InputError when another one is in it.
    """
    images = find_images([request.images], apart=request.out)
    with stop_on_signals() as stop:
        folder = RunFolder(request.out)
        start, recipe = load_start(training), recipe_of(training)
        with folder.held():
            corrections = corrections_by_image(images, request.corrections)
            run = TrainingRun(training, recipe, start, request, folder, stop, corrections)
            return run.go(images)


def recipe_of(training: Training) -> Recipe:
    """The parts of a training that depend on the kind of network in its settings."""
    if isinstance(training, ImageTraining):
        return ImageRecipe(training)
    return PatchRecipe(training)


def load_start(training: Training) -> LayoutNetwork | None:
    """The network of the weights that a run starts from; None where it starts from none.

    One for whole images may have learned at another size; it continues at that of the settings.
    WeightsError when it is not one of these settings otherwise.
    """
    if not training.start:
        return None
    network = load_network(weights_path(training.start))
    if isinstance(network, WholeImageNetwork) and isinstance(training, ImageTraining):
        network = network_at(network, training.network.height, training.network.width)
    if network.settings != training.network:
        message = "holds a network with other settings than this training"
        hint = "give the same [network] settings, or leave start out"
        raise WeightsError(training.start, message, hint)
    return network


def made_ready(
    recipe: Recipe, images: Sequence[Item], folder: Path, stop: Stop, quiet: bool
) -> list[PreparedImage]:
    """The images made ready in a folder; fewer where the run was asked to stop."""
    with shared(folder):
        recipe.survey(images, folder, stop, quiet)
        if stop.asked:  # nothing is made ready by half a survey
            return []
        preparation = Preparation(folder, recipe.key, recipe.make)
        return prepare(images, preparation, stop, quiet)


@dataclass(frozen=True)
class TrainingRun:
    """One run of a training in its folder.

    start: the network that it starts from, if any. corrections: by the name of their image.
    """

    training: Training
    recipe: Recipe
    start: LayoutNetwork | None
    request: Request
    folder: RunFolder
    stop: Stop
    corrections: Mapping[str, Correction]

    def go(self, images: Sequence[Item]) -> Outcome:
        """Make the images ready and train the epochs that are left, from a checkpoint if any."""
        stop, folder = self.stop, self.folder
        summary = corrections_summary(self.corrections)
        record = record_of(as_values(self.training), images, summary)
        folder.check(record)
        state = folder.read_checkpoint()
        folder.begin(record)
        behind = [*corrections_behind(self.training), *([summary] if summary else [])]
        kept = self.request.prepared or folder.path / PREPARED
        prepared = made_ready(self.recipe, images, kept, stop, self.request.quiet)
        skipped = sum(item.file is None for item in prepared)
        if stop.asked or not self._train(prepared, state, behind):
            return Outcome(None, stop.signal or SIGTERM, skipped)
        return Outcome(folder.path / WEIGHTS, None, skipped)

    def _train(
        self,
        prepared: Sequence[PreparedImage],
        state: dict[str, Any] | None,
        behind: Sequence[Mapping[str, Any]],
    ) -> bool:
        """Train the epochs that are left; whether it came to their end."""
        path = self.folder.path
        self.folder.write_images(prepared)
        files = {item.file: item.name for item in prepared if item.file is not None}
        if not files:
            raise InputError(self.request.images, "holds no image that can be used", "see above")
        if len(files) == 1 and not self.request.quiet:
            text = "roadtorch: one image only: the network will know that one and no other"
            Progress.write(text, file=sys.stderr)
        people = {
            file: self.corrections[name] for file, name in files.items() if name in self.corrections
        }
        shrink = self.recipe.shrink
        corrected = write_corrections(path / CORRECTIONS, people, shrink) if people else {}
        progress = _progress_of(state, path / CHECKPOINT) if state else TrainingProgress()
        given = TrainingInputs(list(files), corrected, self.start, path / LABELS)
        loop = self._train_epochs(given, progress, state)
        self._write(loop.average.network.eval(), progress, len(files), behind)
        if people and progress.finished and isinstance(self.training, ImageTraining):
            write_corrected(path / FUSION, path / WEIGHTS, list(people.values()))
        return progress.finished

    def _train_epochs(
        self, given: TrainingInputs, progress: TrainingProgress, state: dict[str, Any] | None
    ) -> Loop:
        """Train all epochs, or the rest of them from a checkpoint."""
        training = self.training
        stop, quiet = self.stop, self.request.quiet
        samples = self.recipe.samples(given, stop, quiet)
        network = self.recipe.network(self.start)
        descent = paced(training.descent, training.corrections.halfway, len(self.corrections))
        parts = (network, samples.chunks, samples.batches, self.recipe.loss)
        rules = (descent, training.stopping)
        loop = Loop(*parts, *rules, progress, self.folder, stop, quiet, self.request.part)
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
        behind: Sequence[Mapping[str, Any]],
    ) -> None:
        """Write the weights as they are, and the curve so far."""
        path, config = self.folder.path / WEIGHTS, as_values(self.training)
        origin = {
            "roadtorch": __version__,
            "config": config,
            "config_sha256": config_hash(config),
            "images": used,
            "round": 1,
            "epochs": progress.epoch,
            "finished": progress.finished,
            "corrections": list(behind),
        }
        if behind:
            write_text(path.with_suffix(".md"), card_of(behind))
        save_network(path, network, origin)
        if progress.rows:
            self.folder.write_curve(progress.rows)


def _progress_of(state: Mapping[str, Any], path: Path) -> TrainingProgress:
    """The progress in a checkpoint; WeightsError where it makes no sense."""
    try:
        return TypeAdapter(TrainingProgress).validate_python(state["progress"])
    except (KeyError, ValidationError):
        raise WeightsError(path, *NO_CHECKPOINT) from None
