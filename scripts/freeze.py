"""Freeze what roadtorch does, and compare: the check for changes that must not change anything.

    python scripts/freeze.py record DATA frozen/before        # on the commit before
    python scripts/freeze.py record DATA frozen/after         # on the commit after
    python scripts/freeze.py compare frozen/before frozen/after
    python scripts/freeze.py thumbnails tests/frozen.json  # what tests/test_detectors.py holds to

Recorded are hashes of every detection (all detectors of the catalogue, ten images) and of every
file that the command lines of OUTPUTS leave, with what they print and their exit status. The files
stay in the folder, to look at what differs; ``--only PART`` records parts anew. Bytes depend on the
machine: record both sides on one. What may differ from run to run is taken out by `settled`. DATA
holds camvid/, clips/, idd_lite/, kitti_road/, many/ and unlabelled_free/.
"""

import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, product
from pathlib import Path

import av
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch import list_detectors, load_detector, read_image
from roadtorch.testing.scenes import render_scene
from tests.inputs.bags import write_drive

CELLS = (
    *("oneclass:nn:RGB", "oneclass:hist64_s:HS", "oneclass:gaussian:Lab"),
    *("oneclass:robust_gaussian:RGB", "oneclass:mog_opt:O1O2", "oneclass:svdd:S"),
    *("oneclass:pca:HSV", "oneclass:mst:nrng", "oneclass:kmeans:H", "oneclass:dlp:G"),
)
IMAGES = (
    ("camvid/train/*.jpg", 4),
    ("idd_lite/images/*.jpg", 3),
    ("many/cityscapes/images/*.jpg", 1),
    ("many/dn_tas500/images/*.jpg", 1),
    ("unlabelled_free/**/*.jpg", 1),
)
MAPS = "likelihood,mask,overlay,cues,npy,polygons,json"
FOOTAGE = f"{MAPS},overlay-frames,mask-video,likelihood-video,bag"
GRID = "--set grid.height=1.5 --save grid"
EPOCH = "--quiet --threads 1 --set stopping.epochs=1"
OUTPUTS = {
    "infer/folder": f"infer images --save {MAPS}",
    "infer/ufl": "infer images --detector ufl --save likelihood,cues --depth 16 --jobs 2",
    "footage/video": f"infer clip.mp4 --save {FOOTAGE} --every 4 --limit 8",
    "footage/unsmoothed": "infer clip.mp4 --no-smoothing --start 2 --end 2.5",
    "footage/ros2": f"infer drive --save {FOOTAGE}",
    "footage/ros1": f"infer drive.bag --save {FOOTAGE}",
    "footage/mixed": "infer images clip.mp4 drive.bag --detector labeller --limit 3",
    "grid/images": f"infer images {GRID},grid-likelihood,grid-image --set grid.fov=60",
    "grid/pitched": f"infer images {GRID},grid-likelihood --set grid.fov=60 --set grid.pitch=3",
    "grid/video": f"infer clip.mp4 {GRID},grid-image --set grid.fov=60 --limit 8",
    "grid/ros2": f"infer drive {GRID},bag",
    "grid/ros1": f"infer drive.bag {GRID},bag --set grid.pitch=3",
    "label/margin": "label images",
    "label/maximum": "label images --set support=maximum",
    "label/submit": "evaluate kitti-road kitti --submit",
    "evaluate/camvid": "evaluate camvid ../data/camvid --limit 12 {all}",
    "evaluate/idd": "evaluate idd-lite ../data/idd_lite --limit 6 {all} "
    "--mean-from camvid:../data/camvid",
    "evaluate/kitti": "evaluate kitti-road kitti --bev --detector fusion --detector cpf",
    "evaluate/tune": "evaluate camvid ../data/camvid --limit 6 --detector cpf --detector fusion "
    "--tune",
    "evaluate/labelled": "evaluate camvid ../data/camvid --limit 6 --detector fusion --against cpf",
    "adapt/clip": f"adapt clip.mp4 --limit 40 {EPOCH} --set samples_per_epoch=16",
    "train/cnn7": f"train --config cnn7 --images footage {EPOCH} --set passes=1",
    "commands/version": "--version",
    "commands/help": "--help",
    "commands/infer-help": "infer --help",
    "commands/no-command": "infr",
    "commands/detectors": "detectors",
    "commands/explained": "detectors cpf",
    "commands/misspelt": "detectors fuson",
    "commands/no-key": "infer images --set texture.bin=32",
    "commands/wrong-value": "infer images --set texture.bins=1",
    "commands/nothing": "infer nowhere --out ../commands/nothing",
}
"""Command lines, run in the folder of inputs, by PART/OUTPUT, which is also their ``--out``."""

REFUSED = ("no-command", "misspelt", "no-key", "wrong-value", "nothing")
"""Those of commands/ that are wrong usage; all others end with 0."""

PARTS = ("detections", *dict.fromkeys(output.split("/")[0] for output in OUTPUTS))
HASHES = "hashes.csv"


def detectors() -> list[str]:
    """List all names of the catalogue, and ten cells of its grid of one-class detectors."""
    return [*(name for name in list_detectors() if "<" not in name), *CELLS]


def spread(data: Path) -> list[Path]:
    """Choose ten images of five sets, evenly spread over each."""
    chosen = list[Path]()
    for pattern, count in IMAGES:
        files = sorted(data.glob(pattern))
        chosen += [files[index * len(files) // count] for index in range(count)]
    return chosen


def make_inputs(data: Path, folder: Path) -> None:
    """Write two folders of images, a video, bags of ROS 1 and 2, and four images of KITTI."""
    free = sorted((data / "unlabelled_free").rglob("*.jpg"))
    copies = {f"images/{file.name}": file for file in spread(data)[::3]}
    copies |= {f"footage/{file.name}": file for file in free[::5]}
    copies |= {"clip.mp4": data / "clips/us_rural_damp.mp4"}
    for lens in sorted((data / "kitti_road/calib").iterdir()):
        truth = f"gt_image_2/{lens.stem.replace('_', '_road_')}.png"
        for name in (f"calib/{lens.name}", f"image_2/{lens.stem}.png", truth):
            copies[f"kitti/{name}"] = data / "kitti_road" / name
    for name, file in copies.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(file, folder / name)
    write_bags(folder, slice(0, 24, 4))


def write_bags(folder: Path, part: slice) -> None:
    """Write frames of clip.mp4 and their lens: ``drive`` of ROS 2, ``drive.bag`` of ROS 1."""
    with av.open(str(folder / "clip.mp4")) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)][part]
    for form in ("mcap", "bag"):
        write_drive(folder, form, frames, focal=400)


def detections(data: Path) -> Iterator[tuple[str, bytes]]:
    """Yield ``NAME/IMAGE/MAP`` and its content, for likelihood, mask, cues and trust."""
    torch.set_num_threads(1)
    images = {path.name: read_image(path) for path in spread(data)}
    for name in detectors():
        detector = load_detector(name)
        for file, image in images.items():
            detection = detector.detect(image)
            maps = {"likelihood": detection.likelihood, "mask": detection.mask}
            maps |= {f"cue {cue}": values for cue, values in detection.cues.items()}
            for key, values in maps.items():
                yield f"{name}/{file}/{key}", values.contiguous().numpy().tobytes()
            yield f"{name}/{file}/trust", repr(detection.trust).encode()


def outputs(part: str, data: Path, out: Path) -> Iterator[tuple[str, bytes]]:
    """Yield the files that a part's command lines make; ``OUTPUT.txt`` is what one prints."""
    env = {**os.environ, "PYTHONPATH": str(Path.cwd()), "COLUMNS": "100"}
    env |= {f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS")}
    every = " ".join(f"--detector {name}" for name in detectors())
    shutil.rmtree(out / part, ignore_errors=True)
    (out / part).mkdir()
    if part == "inputs":
        make_inputs(data, out / part)
    for output in [output for output in OUTPUTS if output.startswith(f"{part}/")]:
        command = [sys.executable, "-m", "roadtorch", *OUTPUTS[output].format(all=every).split()]
        command += ["--out", f"../{output}"] if part != "commands" else []
        done = subprocess.run(command, cwd=out / "inputs", env=env, capture_output=True, text=True)
        if done.returncode != (2 if output.removeprefix("commands/") in REFUSED else 0):
            sys.exit(f"{output}: exit {done.returncode}\n{done.stderr}")
        text = f"exit {done.returncode}\n--- stdout\n{done.stdout}--- stderr\n{done.stderr}"
        (out / f"{output}.txt").write_text(text)
    for file in sorted((out / part).rglob("*")):
        if file.is_file() and file.suffix != ".pt":  # a checkpoint, which holds times
            yield str(file.relative_to(out / part)), settled(file)


def record(data: Path, out: Path, parts: Sequence[str]) -> None:
    """Record parts in a folder, replacing earlier records of them."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "data").unlink(missing_ok=True)
    (out / "data").symlink_to(data.resolve())  # so that no absolute path is in what is written
    out = out.resolve()
    table = hashes(out) if (out / HASHES).exists() else {}
    for part in ("inputs", *parts):
        table = {key: value for key, value in table.items() if key[0] != part}
        contents = detections(data) if part == "detections" else outputs(part, data, out)
        for name, content in contents:
            table[part, name] = hashlib.sha256(content).hexdigest()[:16]
        with (out / HASHES).open("w", newline="") as file:
            csv.writer(file).writerows((*key, value) for key, value in sorted(table.items()))
        print(f"{part} is recorded", file=sys.stderr)


def hashes(out: Path) -> dict[tuple[str, str], str]:
    """Read the recorded hashes by part and name."""
    with (out / HASHES).open(newline="") as file:
        return {(part, name): value for part, name, value in csv.reader(file)}


# --- what may differ from run to run -----------------------------------------------------

TEXT = {".csv", ".html", ".json", ".md", ".toml", ".txt", ".yaml"}
# method: the key by which a second run knows what the first one did
UNSETTLED_COLUMNS = {"index.csv": {"ms", "method"}, "images.csv": {"ms"}, "log.csv": {"seconds"}}
UNSETTLED = (
    (r'"versions": \{[^}]*\}', '"versions": {}'),
    (r'\\?"roadtorch\\?": \\?"[\w.+]*\\?"', '"roadtorch": VERSION'),
    (r"(roadtorch, version) \S+", r"\1 VERSION"),
    (r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d[\d.]*([+-]\d\d:\d\d|Z)?", "DATE"),
    (r'"(index_sha256|ms|ms_per_image|seconds)": "?[\w.+-]+"?', r'"\1": TIME'),
    (r"(<td>|\| )\d+\.\d(?=</td>| \|)", r"\1TIME"),  # reports and their tables tell ms alone so
    (r"(?m) +\d+\.\d(?=  [ \d.-]+$)", " TIME"),  # and so does the table on the screen
    (r"\bin \d+(\.\d+)? s\b", "in TIME"),
    (r"(?m)^roadtorch: .*(, [\d:?]+ left| in [\d:]+)\n", ""),  # how far a long run is
)
"""Patterns of versions, dates and times in text, and their replacements."""


def settled(file: Path) -> bytes:
    """Return a file's content without versions, dates and times."""
    content, binary = file.read_bytes(), b""
    if file.suffix == ".safetensors":  # behind eight bytes that tell its length, its head is JSON
        end = 8 + int.from_bytes(content[:8], "little")
        content, binary = content[8:end], content[end:]
    elif file.suffix not in TEXT:
        return content
    text = content.decode().replace(str(Path.cwd()), "REPO")
    if file.name in UNSETTLED_COLUMNS:
        rows = list(csv.DictReader(text.splitlines()))
        for row, name in product(rows, UNSETTLED_COLUMNS[file.name]):
            row.pop(name, None)
        text = "\n".join(map(json.dumps, rows))
    for pattern, word in UNSETTLED:
        text = re.sub(pattern, word, text)
    return text.encode() + binary


def differences(old_out: Path, new_out: Path) -> Iterator[str]:
    """Yield the differences by output and file, then the number of equal ones."""
    old, new = hashes(old_out), hashes(new_out)
    parts = {part for part, _ in old} & {part for part, _ in new}
    keys = sorted(key for key in old.keys() | new.keys() if key[0] in parts)
    unequal = [key for key in keys if old.get(key) != new.get(key)]
    for output, group in groupby(unequal, lambda key: f"{key[0]}/{key[1].split('/')[0]}"):
        differing = list(group)
        yield f"{output}: {len(differing)} differ"
        for key in differing[:12]:
            state = "gone" if key not in new else "other bytes" if key in old else "new"
            yield f"  {'/'.join(key)}: {state}"
    yield f"equal: {len(keys) - len(unequal)} of {len(keys)} in {', '.join(sorted(parts))}"


def thumbnails(names: Iterable[str]) -> dict[str, list[list[int]]]:
    """Return likelihoods in two rendered streets, 6×8 means of each, in 255ths, by detector."""
    scenes = ({"seed": 3}, {"seed": 5, "dusk": 0.6})
    images = [render_scene(height=96, width=128, **options).image for options in scenes]
    rows: dict[str, list[list[int]]] = {}
    for name in names:
        detector = load_detector(name)
        maps = torch.stack([detector.detect(image).likelihood for image in images])
        means = torch.nn.functional.adaptive_avg_pool2d(maps, (6, 8))
        rows[name] = means.mul(255).round().int().flatten(1).tolist()
    return rows


def main() -> int:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("record", "compare", "thumbnails"))
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    options = parser.parse_args()
    if options.command == "record":
        record(*options.paths, parts=options.only)
    if options.command == "thumbnails":
        maps = thumbnails(detectors())
        rows = [f"{json.dumps(name)}: {json.dumps(means)}" for name, means in maps.items()]
        options.paths[0].write_text("{\n" + ",\n".join(rows) + "\n}\n")
    lines = list(differences(*options.paths)) if options.command == "compare" else []
    print(*lines, sep="\n", end="\n" * bool(lines))
    return int(len(lines) > 1)


if __name__ == "__main__":
    sys.exit(main())
