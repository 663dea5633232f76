"""Freeze what roadtorch does, and compare: the check for changes that must not change anything.

    python scripts/freeze.py record DATA frozen/before        # on the commit before
    python scripts/freeze.py record DATA frozen/after         # on the commit after
    python scripts/freeze.py compare frozen/before frozen/after
    python scripts/freeze.py thumbnails tests/frozen.json     # what tests/test_freeze.py holds to

Recorded are: likelihood and mask of every detector that is not of a grid, and of ten one-class
cells, on ten pictures; metrics.json, images.csv and curves.json of `evaluate` with all of them on
24 CamVid and 12 IDD pictures; stdout, stderr and exit status of fifteen command lines; the weights
of a short training run of each kind. Bytes depend on the machine and on its threads: record both
sides on one machine. `compare` leaves times aside, and knows the keys that were renamed.
"""

import argparse
import csv
import hashlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

DETECTORS = (
    *("cpf", "cpf:squares", "cpf:v2", "fusion", "fusion:research", "fusion:paper"),
    *("fusion:untrained", "layout:research"),
    *("grey-uniformity", "labeller", "layout", "layout:cnn-7", "lbp"),
    *("prior:rows", "prior:triangle", "prior:uniform", "ufl", "ufl:kitti", "ufl:original"),
    *("kmeans-road", "vanishing-point"),
)
CELLS = (
    *("oneclass:nn:RGB", "oneclass:hist64_s:HS", "oneclass:gaussian:Lab"),
    *("oneclass:robust_gaussian:RGB", "oneclass:mog_opt:O1O2", "oneclass:svdd:S"),
    *("oneclass:pca:HSV", "oneclass:mst:nrng", "oneclass:kmeans:H", "oneclass:dlp:G"),
)
PICTURES = (
    ("camvid/train/*.jpg", 4),
    ("idd_lite/images/*.jpg", 3),
    ("many/cityscapes/images/*.jpg", 1),
    ("many/dn_tas500/images/*.jpg", 1),
    ("unlabelled_free/**/*.jpg", 1),
)
COMMANDS = {
    "version": "--version",
    "help": "--help",
    "infer-help": "infer --help",
    "no-command": "infr",
    "detectors": "detectors",
    "explained": "detectors cpf",
    "misspelt": "detectors fuson",
    "planes": "planes",
    "infer": "infer pictures --out roads --jobs 2",
    "infer-again": "infer pictures --out roads",
    "infer-cues": "infer pictures --detector ufl --save likelihood,cues --out cues",
    "no-key": "infer pictures --set texture.bin=32",
    "wrong-value": "infer pictures --set texture.bins=1",
    "label": "label pictures --out labels --overlay",
    "nothing": "infer nowhere --out nothing",
}
TRAININGS = {
    "cnn7": ("cnn7", ["stopping.epochs=1", "passes=1"]),
    "layout": ("layout", ["stopping.epochs=1", "rounds.count=2"]),
}


# --- record -----------------------------------------------------------------------------


def spread(data: Path) -> list[Path]:
    """Ten pictures of five sets, evenly spread over each."""
    found = []
    for pattern, count in PICTURES:
        files = sorted(data.glob(pattern))
        found += [files[index * len(files) // count] for index in range(count)]
    return found


def record_detections(data: Path, out: Path) -> None:
    from roadtorch import load_detector, read_image

    rows = []
    for name in DETECTORS + CELLS:
        detector = load_detector(name)
        for picture in spread(data):
            detection = detector.detect(read_image(picture))
            likelihood, mask = detection.likelihood.numpy(), detection.mask.numpy()
            cues = "".join(
                f"{key}{hashlib.sha256(cue.contiguous().numpy().tobytes()).hexdigest()}"
                for key, cue in sorted(detection.cues.items())
            )
            parts = (likelihood.tobytes(), mask.tobytes(), cues.encode())
            hashes = [hashlib.sha256(part).hexdigest()[:16] for part in parts]
            rows.append([name, picture.name, *hashes])
    with (out / "detections.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)


def roadtorch(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(Path.cwd()), "COLUMNS": "100"}
    command = [sys.executable, "-m", "roadtorch", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False)


def record_evaluations(data: Path, out: Path) -> None:
    chosen = [word for name in DETECTORS + CELLS for word in ("--detector", name)]
    sets = {
        "camvid": ["camvid", str(data / "camvid"), "--limit", "24"],
        "idd": ["idd-lite", str(data / "idd_lite"), "--limit", "12",
                "--mean-from", f"camvid:{data / 'camvid'}"],
    }  # fmt: skip
    for name, where in sets.items():
        done = roadtorch(["evaluate", *where, *chosen, "--out", f"evaluate-{name}"], out)
        (out / f"evaluate-{name}.txt").write_bytes(done.stdout)
        assert done.returncode == 0, done.stderr.decode()


def record_commands(data: Path, out: Path) -> None:
    (out / "pictures").mkdir()
    for picture in spread(data)[::3]:
        (out / "pictures" / picture.name).symlink_to(picture.resolve())
    told = {}
    for name, line in COMMANDS.items():
        done = roadtorch(line.split(), out)
        told[name] = [done.returncode, done.stdout.decode(), done.stderr.decode()]
    (out / "commands.json").write_text(json.dumps(told, indent=1))


def record_trainings(data: Path, out: Path) -> None:
    footage = sorted((data / "unlabelled_free").rglob("*.jpg"))[::5]
    (out / "footage").mkdir()
    for picture in footage:
        (out / "footage" / picture.name).symlink_to(picture.resolve())
    for name, (config, settings) in TRAININGS.items():
        words = ["train", "--config", str(Path.cwd() / f"configs/{config}.toml")]
        words += ["--images", "footage", "--out", f"run-{name}", "--quiet", "--threads", "2"]
        words += [word for setting in settings for word in ("--set", setting)]
        done = roadtorch(words, out)
        assert done.returncode == 0, done.stderr.decode()


def record(data: Path, out: Path) -> None:
    """Everything, into a new folder."""
    import torch

    out.mkdir(parents=True)
    torch.set_num_threads(2)
    data, out = data.resolve(), out.resolve()
    for part in (record_commands, record_trainings, record_detections, record_evaluations):
        part(data, out)
        print(part.__name__, "done", file=sys.stderr)


# --- the part that is cheap enough for the tests -----------------------------------------

THUMBNAIL = (6, 8)
SCENES = ({"seed": 3}, {"seed": 5, "dusk": 0.6})


def thumbnails() -> dict[str, list[list[int]]]:
    """By detector its likelihoods in two rendered streets, 6×8 means of each, in 255ths."""
    import torch

    from roadtorch import load_detector
    from roadtorch.scenes.street import render_scene

    images = [render_scene(height=96, width=128, **options).image for options in SCENES]
    found: dict[str, list[list[int]]] = {}
    for name in DETECTORS + CELLS:
        detector = load_detector(name)
        maps = torch.stack([detector.detect(image).likelihood for image in images])
        means = torch.nn.functional.adaptive_avg_pool2d(maps, THUMBNAIL)
        found[name] = means.mul(255).round().int().flatten(1).tolist()
    return found


# --- compare ----------------------------------------------------------------------------

RENAMED = {
    "seed": "seed_area",
    "random": "random_seed",
    "road.weights": "road.exponents",
}
"""Keys of detectors' settings, old and new."""

NEW = re.compile(r"\.baseline$|^detectors\.prior:\w+\.settings\.(isolated$|seed_area\.)")
"""What metrics.json has gained: who is a baseline, and settings that every detector has now."""

TIMES = ("ms_per_image", "ms")


def differences(before: Path, after: Path) -> Iterator[str]:
    """One line for everything that is not equal."""
    yield from _lines_that_differ(before / "detections.csv", after / "detections.csv")
    for name in ("camvid", "idd"):
        one, two = before / f"evaluate-{name}", after / f"evaluate-{name}"
        yield from _metrics_that_differ(one / "metrics.json", two / "metrics.json")
        yield from _lines_that_differ(one / "images.csv", two / "images.csv")
        yield from _lines_that_differ(one / "curves.json", two / "curves.json")
    yield from _answers_that_differ(before / "commands.json", after / "commands.json")
    for name in TRAININGS:
        one, two = (_weights(folder / f"run-{name}") for folder in (before, after))
        if one != two:
            yield f"run-{name}: other weights"
    for folder in ("roads", "cues", "labels"):
        for file in sorted((before / folder).rglob("*.png")):
            if file.read_bytes() != (after / file.relative_to(before)).read_bytes():
                yield f"{file.relative_to(before)}: other bytes"


def _lines_that_differ(one: Path, two: Path) -> Iterator[str]:
    before, after = _rows(one), _rows(two)
    if len(before) != len(after):
        yield f"{one.name}: {len(before)} and {len(after)} lines"
    for left, right in zip(before, after, strict=False):
        if left != right:
            yield f"{one.name}: {left} / {right}"[:300]


def _rows(path: Path) -> list[Any]:
    if path.suffix != ".csv":
        return [path.read_text()]
    rows = list(csv.reader(path.open(newline="")))
    kept = [i for i, name in enumerate(rows[0]) if name not in TIMES]
    return [[row[i] for i in kept] for row in rows]


def _metrics_that_differ(one: Path, two: Path) -> Iterator[str]:
    before, after = (flat(json.loads(path.read_text())) for path in (one, two))
    before = {renamed(key): value for key, value in before.items()}
    for key in [key for key in before if key.endswith(".threshold_from")]:
        before[key] = before[key].replace("other drives", "other groups")
    for key in sorted(before.keys() | after.keys()):
        is_new = key not in before and NEW.search(key)
        if is_new or key.rpartition(".")[2] in TIMES or key == "command":
            continue
        if before.get(key) != after.get(key):
            yield f"{one.parent.name}: {key}: {before.get(key)} / {after.get(key)}"


def renamed(key: str) -> str:
    """The key under its new name."""
    key = re.sub(r"\.floor$", ".baseline", key)
    for old, new in RENAMED.items():
        key = re.sub(rf"(\.settings(?:\..*)?)\.{re.escape(old)}(?=\.|$)", rf"\1.{new}", key)
    return key


def flat(values: Any, path: str = "") -> dict[str, Any]:
    """Nested values as one level."""
    if isinstance(values, Mapping):
        parts = [flat(value, f"{path}.{key}" if path else key) for key, value in values.items()]
        return {key: value for part in parts for key, value in part.items()}
    return {path: values}


def _answers_that_differ(one: Path, two: Path) -> Iterator[str]:
    before, after = (json.loads(path.read_text()) for path in (one, two))
    for name in before:
        for what, left, right in zip(
            ("exit", "stdout", "stderr"), before[name], after[name], strict=True
        ):
            if left != right:
                yield f"{name}: {what}:\n--- before\n{left}\n--- after\n{right}"


def _weights(run: Path) -> dict[str, bytes]:
    from safetensors.torch import load_file

    tensors = load_file(run / "weights.safetensors")
    return {name: value.numpy().tobytes() for name, value in sorted(tensors.items())}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser("record")
    one.add_argument("data", type=Path)
    one.add_argument("out", type=Path)
    three = commands.add_parser("thumbnails")
    three.add_argument("file", type=Path)
    two = commands.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.command == "record":
        record(given.data, given.out)
        return 0
    if given.command == "thumbnails":
        lines = [f"{json.dumps(name)}: {json.dumps(maps)}" for name, maps in thumbnails().items()]
        given.file.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        return 0
    found = list(differences(given.before, given.after))
    print("\n".join(found) if found else "equal")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
