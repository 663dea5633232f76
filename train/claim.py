"""Does the student beat its teacher? P2's claim, tested with five seeds and an untuned teacher.

    python -m train.claim learn DATA --out RUNS                 # 30 trainings, on one core
    python -m train.claim learn DATA --out RUNS --minutes 8     # the same on a GPU, in minutes
    python -m train.claim list                                  # what is trained, in this order

DATA is the folder that holds unlabelled_free/, camvid/, idd_lite/ and many/. Every image directly
in the first is trained on, those of also_in_many/ are not; to the letter, with 7 times as many
patches an image, every fifth. A run is RUNS/TEACHER-CONFIG-SEED; finished ones are kept. Labels of
an image are made once for each teacher and config.
"""

import argparse
import subprocess
import sys
import time
from itertools import product
from pathlib import Path
from typing import NamedTuple

import torch

from roadtorch.base.settings import find_config, merge, parse_assignments, read_settings_file
from roadtorch.train.config import PatchTraining, build_training
from train.patches_gpu import make_student, prepare_files, train_side_by_side

TEACHERS = {"untuned": ("labeller.constants=untuned",), "tuned": ()}
DECAYED = ("descent.schedule=cosine", "stopping.rule=epochs", "stopping.epochs=4")


class Config(NamedTuple):
    """A shipped config, settings in place of its own, and the step between its images."""

    file: str
    assignments: tuple[str, ...] = ()
    every: int = 1


CONFIGS = {
    "cnn7": Config("cnn7"),
    "cnn7-paper": Config("cnn7-paper", every=5),
    "cnn7-paper-decayed": Config("cnn7-paper", DECAYED, every=5),
}
"""What is trained. Ours: the decayed step beside the letter; written before any was trained."""

SEEDS = range(5)
RUNS = tuple((teacher, config, seed) for config, seed, teacher in product(CONFIGS, SEEDS, TEACHERS))
"""Teacher, config and seed of every training, in the order in which they run."""


def run_name(teacher: str, config: str, seed: int) -> str:
    """Return the name of a training's folder."""
    return f"{teacher}-{config}-{seed}"


def run_assignments(teacher: str, config: str, seed: int) -> tuple[str, ...]:
    """Return the settings that a training has in place of its config's."""
    return (f"random_seed={seed}", *TEACHERS[teacher], *CONFIGS[config].assignments)


def prepared_folder(out: Path, teacher: str, config: str) -> Path:
    """Return the folder of the labels that a teacher gives a config."""
    return out / f"prepared-{teacher}-{CONFIGS[config].file}"


def link_images(data: Path, out: Path, every: int) -> str:
    """Link every so many images into a folder, and return it."""
    folder = out / f"images-{every}"
    folder.mkdir(parents=True, exist_ok=True)
    for image in sorted((data / "unlabelled_free").resolve().glob("*.jpg"))[::every]:
        link = folder / image.name
        if not link.exists():
            link.symlink_to(image)
    return str(folder)


def learn(data: Path, out: Path) -> None:
    """Train every network of ``RUNS`` that is not finished, on one core."""
    for teacher, config, seed in RUNS:
        folder = out / run_name(teacher, config, seed)
        if (folder / "done").exists():
            continue
        images = link_images(data, out, CONFIGS[config].every)
        words = ["--config", CONFIGS[config].file, "--images", images, "--out", str(folder)]
        words += ["--prepared", str(prepared_folder(out, teacher, config)), "--quiet"]
        for assignment in run_assignments(teacher, config, seed):
            words += ["--set", assignment]
        command = [sys.executable, "-m", "roadtorch", "train", *words, "--threads", "1"]
        subprocess.run(command, check=True)
        (folder / "done").touch()
        print(f"{folder.name} is trained", flush=True)


def learn_side_by_side(data: Path, out: Path, minutes: float, device: torch.device) -> None:
    """Train every network of ``RUNS`` that is not finished, side by side, within a time."""
    deadline = time.monotonic() + 60 * minutes
    torch.backends.cudnn.benchmark = True
    torch.backends.cudnn.allow_tf32 = False
    files = dict[Path, list[Path]]()
    for name, config in CONFIGS.items():
        images, students = link_images(data, out, config.every), []
        for teacher, trained, seed in RUNS:
            folder = out / run_name(teacher, name, seed)
            if trained == name and not (folder / "done").exists():
                values = read_settings_file(find_config(config.file))
                assignments = parse_assignments(run_assignments(teacher, name, seed))
                training = build_training(merge(values, assignments))
                assert isinstance(training, PatchTraining)
                prepared = prepared_folder(out, teacher, name)
                if prepared not in files:
                    files[prepared] = prepare_files(training, images, prepared)
                students.append(make_student(folder, training, files[prepared]))
        print(f"{len(students)} networks of {name}", flush=True)
        if students:
            train_side_by_side(students, device, deadline)


def main() -> None:
    """Run a command of this script."""
    parser = argparse.ArgumentParser(description="Train students of both teachers.")
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("learn")
    training.add_argument("data", type=Path)
    training.add_argument("--out", type=Path, required=True)
    training.add_argument("--minutes", type=float, help="train side by side within this time")
    commands.add_parser("list")
    options = parser.parse_args()
    if options.command == "list":
        print("\n".join(run_name(*run) for run in RUNS))
        return
    if options.minutes is None:
        learn(options.data, options.out)
    else:
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        learn_side_by_side(options.data, options.out, options.minutes, device)


if __name__ == "__main__":
    main()
