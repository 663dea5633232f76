"""Does the student beat its teacher? P2's claim, tested with five seeds and an untuned teacher.

    python -m train.claim learn DATA --out RUNS        # 20 trainings, resumable, on one core
    python -m train.claim list                         # what is trained, in this order

DATA is the folder that holds unlabelled_free/. Every image directly in it is trained on, those of
also_in_many/ are not. A run is RUNS/TEACHER-CONFIG-SEED. Labels of an image are made once for each
teacher and config.
"""

import argparse
import subprocess
import sys
from itertools import product
from pathlib import Path

TEACHERS = {"untuned": ("labeller.constants=untuned",), "tuned": ()}
CONFIGS = ("cnn7", "cnn7-paper")
SEEDS = range(5)
RUNS = tuple((teacher, config, seed) for config, seed, teacher in product(CONFIGS, SEEDS, TEACHERS))
"""Teacher, config and seed of every training, in the order in which they run."""


def learn(data: Path, out: Path) -> None:
    """Train every network of ``RUNS`` that is not finished."""
    images = data / "unlabelled_free" / "*.jpg"
    for teacher, config, seed in RUNS:
        folder = out / f"{teacher}-{config}-{seed}"
        if (folder / "done").exists():
            continue
        settings = [f"random_seed={seed}", *TEACHERS[teacher]]
        words = ["--config", config, "--images", str(images), "--out", str(folder), "--quiet"]
        words += ["--prepared", str(out / f"prepared-{teacher}-{config}"), "--threads", "1"]
        words += [word for setting in settings for word in ("--set", setting)]
        subprocess.run([sys.executable, "-m", "roadtorch", "train", *words], check=True)
        (folder / "done").touch()
        print(f"{folder.name} is trained", flush=True)


def main() -> None:
    """Run a command of this script."""
    parser = argparse.ArgumentParser(description="Train students of both teachers.")
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("learn")
    training.add_argument("data", type=Path)
    training.add_argument("--out", type=Path, required=True)
    commands.add_parser("list")
    options = parser.parse_args()
    if options.command == "learn":
        learn(options.data, options.out)
    else:
        print("\n".join(f"{teacher}-{config}-{seed}" for teacher, config, seed in RUNS))


if __name__ == "__main__":
    main()
