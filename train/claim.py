"""Does the student beat its teacher? P2's claim, with teachers that have seen no street.

    python -m train.claim learn DATA --source WORLDS --out RUNS     # resumable, on one core
    python -m train.claim list                                      # what is trained, in this order

DATA is the folder that holds unlabelled_free/, camvid/, idd_lite/ and many/. A run is RUNS/NAME;
finished ones are kept. ``train.claim_scores`` scores them. Images that teach are never scored:
of CamVid's train part each drive is scored by students of the two others, of IDD Lite every second
image; CamVid's test part, which P2's table uses, is not touched.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.base.settings import find_config, merge, parse_assignments, read_settings_file
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.imaging.resize import resize_to_image, resize_to_work, spatial_size
from roadtorch.inputs.images import find_images
from roadtorch.layout.classes import NUM_CLASSES, UNLABELLED
from roadtorch.layout.labeller import LabellerSettings, decide_layout, label_at_image_size
from roadtorch.run.memo import write_cached
from roadtorch.train.config import PatchTraining, build_training
from roadtorch.train.patches import PatchRecipe, label_centres
from roadtorch.train.prepared import image_file_name
from roadtorch.train.run import TrainingRequest, train
from roadtorch.train.run_folder import WEIGHTS
from roadtorch.train.training_loop import make_generator
from train.superpixels import SuperpixelTeacher, learn_trees

DRIVES = ("0006R0", "0016E5", "0001TP")
DOMAINS = (*DRIVES, "idd")
"""What a student of images of the domain is scored on; none of its own images is among them."""

TREE_IMAGES = 500
"""Source images that teach the trees of superpixels."""

PATCHES, SUPERPIXELS = 220_000, 300
"""Patches that teach a student, in whole epochs, and superpixels of an image, both about."""

RECIPES = {
    "cnn7": ("cnn7", ("centres.extra=0", "stopping.rule=epochs", "descent.schedule=cosine")),
    "letter": ("cnn7-paper", ("stopping.epochs=6", "passes=8", "shuffle_images=10000")),
}
"""Config and settings in its place. Ours, with one patch a superpixel, so that many images teach in
little time; and P2's, with the patches of all images mixed (``shuffle_images``), 230,000 an epoch,
six epochs at most. Written before any was trained."""

LETTER_IMAGES = 24

SEEDS, NOISE_SEEDS = range(5), range(2)
INDEPENDENT, CONFUSED = "independent", "confused"
NOISE = {INDEPENDENT: (0.1, 0.2, 0.3, 0.4, 0.5), CONFUSED: (0.2, 0.4, 0.6, 0.8, 1.0)}
"""Rates: fraction of superpixels whose true label becomes another, each as likely; or of those
where ``labeller:untuned`` errs that keep its label."""


class Run(NamedTuple):
    """A training. images: a domain, or free; recipe: of ``RECIPES``; first: of free images before.

    noise, rate: of ``NOISE``, for the teacher truth.
    """

    teacher: str
    images: str
    recipe: str
    seed: int
    first: bool = False
    noise: str = ""
    rate: float = 0.0

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        images = f"free+{self.images}" if self.first else self.images
        noise = f"-{self.noise}-{self.rate}" if self.noise else ""
        return f"{self.teacher}{noise}-{images}-{self.recipe}-{self.seed}"

    @property
    def preparation(self) -> str:
        """Name of the folder of prepared images; noise differs from seed to seed."""
        seed = f"-{self.noise}-{self.rate}-{self.seed}" if self.noise else ""
        return f"prepared/{self.teacher}-{self.images}-{self.recipe}{seed}"

    @property
    def training(self) -> PatchTraining:
        """Settings of the training, without initial weights."""
        config, assignments = RECIPES[self.recipe]
        values = read_settings_file(find_config(config))
        values = merge(values, parse_assignments([*assignments, f"random_seed={self.seed}"]))
        training = build_training(values)
        assert isinstance(training, PatchTraining)
        return training


def plan_runs() -> Iterator[Run]:
    """Yield all trainings, those that decide most first."""
    honest = ("untuned", "superpixels")
    for seeds in (SEEDS[:3], SEEDS[3:]):
        for seed in seeds:
            for domain in DOMAINS:
                yield from (Run(teacher, domain, "cnn7", seed) for teacher in (*honest, "truth"))
            yield from (Run(teacher, "free", "cnn7", seed) for teacher in honest)
        for seed in seeds:
            for domain in DOMAINS:
                yield from (Run(teacher, domain, "cnn7", seed, first=True) for teacher in honest)
            for noise, rates in NOISE.items() if seed in NOISE_SEEDS else ():
                yield from (Run("truth", DRIVES[0], "cnn7", seed, False, noise, r) for r in rates)
    for seed in SEEDS:
        yield Run("untuned", DRIVES[0], "letter", seed)
        yield from (Run("tuned", images, "cnn7", seed) for images in ("free", *DOMAINS))


# --- images and labels -------------------------------------------------------------------------


def split_domain(data: Path, domain: str) -> tuple[Dataset, list[LabelledItem], list[LabelledItem]]:
    """Return the set of a domain, the images that teach and those that are scored."""
    if domain == "idd":
        dataset = open_dataset("idd-lite", data / "idd_lite")
        return dataset, list(dataset.items[::2]), list(dataset.items[1::2])
    dataset = open_dataset("camvid", data / "camvid", "train")
    teaching = [item for item in dataset.items if item.group != domain]
    return dataset, teaching, [item for item in dataset.items if item.group == domain][::2]


def link_images(data: Path, run: Run, out: Path) -> tuple[Path, dict[str, Tensor]]:
    """Link the images that teach a run into a folder; return it, and their truth by name."""
    folder, truths = out / "images" / f"{run.images}-{run.recipe}", dict[str, Tensor]()
    folder.mkdir(parents=True, exist_ok=True)
    if run.images == "free":
        images = sorted((data / "unlabelled_free").resolve().glob("*.jpg"))
    else:
        dataset, items, _ = split_domain(data, run.images)
        items = items[:: len(items) // LETTER_IMAGES if run.recipe == "letter" else 1]
        images = [item.image.resolve() for item in items]
        for item in items if run.teacher == "truth" else ():
            layout = dataset.truth(item).layout
            assert layout is not None
            truths[item.image.stem] = layout
    for image in images:
        if not (folder / image.name).exists():
            (folder / image.name).symlink_to(image)
    return folder, truths


def prepare_labels(data: Path, run: Run, out: Path, trees: Path) -> Path:
    """Write the labels of a run's teacher where ``roadtorch train`` finds them; return the images.

    The labeller's own are made by the training itself.
    """
    folder, truths = link_images(data, run, out)
    if run.teacher in ("untuned", "tuned"):
        return folder
    training, prepared = run.training, out / run.preparation
    recipe = PatchRecipe(training)
    teacher = None if truths else SuperpixelTeacher(trees, training.superpixels)
    for item in find_images([folder]):
        file = prepared / f"{image_file_name(item)}.npz"
        if file.exists():
            continue
        small = resize_to_work(item.read(), training.network.working)
        if teacher:
            potentials = teacher.potentials(small).permute(1, 2, 0)
            labels = decide_layout(potentials, training.labeller.min_margin)
        else:
            labels = resize_to_image(truths[item.name], spatial_size(small)).long()
        if run.noise:
            labels = disturb(labels, small, run)
        write_cached(file, recipe.key(item), label_centres(small, labels, training))
    return folder


def disturb(labels: Tensor, image: Tensor, run: Run) -> Tensor:
    """Return true labels (h, w) with the noise of a run, superpixel by superpixel."""
    superpixels = run.training.superpixels
    segments = superpixels.cut(image)
    generator = make_generator(run.seed, *image.shape, int(1000 * image.double().mean()))
    chosen = (torch.rand(int(segments.max()) + 1, generator=generator) < run.rate)[segments]
    if run.noise == INDEPENDENT:
        turn = torch.randint(1, NUM_CLASSES, (int(segments.max()) + 1,), generator=generator)
        noisy = (labels + turn[segments]) % NUM_CLASSES
    else:
        untuned = LabellerSettings(constants="untuned", margin=0.0)
        noisy = label_at_image_size(image, untuned, superpixels, untuned.margin).labels
    return torch.where(chosen & (labels != UNLABELLED), noisy, labels)


# --- trainings -------------------------------------------------------------------------------


def learn(data: Path, source: list[Path], out: Path) -> None:
    """Train every network of the plan that is not finished, on one core."""
    torch.set_num_threads(1)
    out.mkdir(parents=True, exist_ok=True)
    trees = out / "superpixels.pickle"
    if not trees.exists():
        learn_trees(source, trees, TREE_IMAGES, PatchTraining().superpixels)
    for run in plan_runs():
        folder = out / run.name
        if (folder / "done").exists():
            continue
        images = prepare_labels(data, run, out, trees)
        values = run.training.model_dump()
        if run.recipe == "cnn7":
            patches = SUPERPIXELS * len(list(images.iterdir()))
            values["stopping"]["epochs"] = max(1, round(PATCHES / patches))
        if run.teacher in ("untuned", "tuned"):
            values["labeller"]["constants"] = run.teacher
        if run.first:
            first = Run(run.teacher, "free", "cnn7", run.seed)
            values["initial_weights"] = str(out / first.name / WEIGHTS)
        prepared = out / run.preparation
        outcome = train(
            PatchTraining.model_validate(values),
            TrainingRequest(str(images), folder, prepared, quiet=True),
        )
        if outcome.interrupted:
            return
        (folder / "done").touch()
        print(f"{run.name} is trained", flush=True)


def main() -> None:
    """Run a command of this script."""
    parser = argparse.ArgumentParser(description="Train students of several teachers.")
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("learn")
    training.add_argument("data", type=Path)
    training.add_argument("--source", type=Path, action="append", required=True)
    training.add_argument("--out", type=Path, required=True)
    commands.add_parser("list")
    options = parser.parse_args()
    if options.command == "list":
        print("\n".join(run.name for run in plan_runs()))
    else:
        learn(options.data, options.source, options.out)


if __name__ == "__main__":
    main()
