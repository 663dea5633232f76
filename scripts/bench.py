"""Time detectors beside their peers (LRASPP, scikit-image's superpixels), commands, and the tests.

    python scripts/bench.py                                      # every detector, one thread
    python scripts/bench.py fusion ufl --against ../before       # another checkout's beside them
    python scripts/bench.py --write                              # and keep what documents show
    python scripts/bench.py --runtimes --against ../before       # the networks by each runtime
    python scripts/bench.py --commands DATA --against ../before  # images a second, 1 and 2 jobs
    python scripts/bench.py infer --commands DATA                # and its share of two detectors
    python scripts/bench.py video video-hd bag grid-bag --commands DATA --against ../before --write
    python scripts/bench.py --suite -n 2                         # CPU seconds of the tests

Each round runs every contestant once, every other round in the reverse order. Times are medians
over the rounds; a ratio is the median of the rounds' ratios: what slows the whole machine for a
while slows both sides of it. Other work on the same cores does not; measure on a quiet machine.

A command runs as a process of its own, on few images and on all of them. Its rate is that of the
images between, so that imports, weights and the start of workers do not count. Training gets as
many processors instead of jobs, and ``detect`` (read an image, detect, write nothing) as many
processes; in the same rounds as ``infer``. ``--suite`` hands the words behind it to pytest.
"""

import importlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from argparse import REMAINDER, ArgumentParser, RawDescriptionHelpFormatter
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

import roadtorch.detectors.detector as stages
from roadtorch.base.image import to_pixels
from roadtorch.detectors.catalogue import list_detectors, load_detector
from roadtorch.imaging.slic import slic
from roadtorch.layout.runtimes import REFERENCE, RUNTIMES, ExportGraph, open_onnxruntime, trace_onnx
from roadtorch.layout.weights import BackboneNetwork
from roadtorch.testing.scenes import render_scene
from scripts.readme_figures import FIGURES, flatten, keep_records

ROOT = Path(__file__).resolve().parents[1]
COMMAND = "python scripts/bench.py --write"
COMMANDS_COMMAND = "python scripts/bench.py --commands DATA --against BEFORE --write"
LRASPP = "LRASPP (torchvision)"
SEGMENTS = 400
SLIC, SKIMAGE = f"slic, {SEGMENTS} segments", f"slic, {SEGMENTS} segments (scikit-image)"
PEERS = {LRASPP: "LRASPP", SLIC: "slic", SKIMAGE: "slic-skimage"}
"""Peers, with the names of their records."""

BEFORE = ", before"
WARM_UP = 2  # rounds that are not counted

Calls = Mapping[str, Callable[[], Any]]  # functions to time once a round, by name
Times = dict[str, list[float]]  # milliseconds by name, a number for each round


def interleaved(calls: Calls, rounds: int) -> Times:
    """Time every call in every counted round, in milliseconds, on one thread of torch."""
    torch.set_num_threads(1)
    times: Times = {name: [] for name in calls}
    for number in range(WARM_UP + rounds):
        for name in list(calls)[:: -1 if number % 2 else 1]:
            start = time.perf_counter()
            calls[name]()
            if number >= WARM_UP:
                times[name].append((time.perf_counter() - start) * 1000)
    return times


def ratio(times: Sequence[float], reference: Sequence[float]) -> float:
    """Return the median of the rounds' ratios."""
    return median(a / b for a, b in zip(times, reference, strict=True))


def lraspp(image: Tensor, runtime: str = REFERENCE) -> Callable[[], Any]:
    """Return torchvision's small network for segmentation on this image, with random weights."""
    from roadtorch.base.vision import import_torchvision

    torch.manual_seed(0)
    segmentation = import_torchvision().models.segmentation
    network = segmentation.lraspp_mobilenet_v3_large(weights=None, weights_backbone=None).eval()
    if runtime != REFERENCE:
        program = trace_onnx(ExportGraph(network, network, ("out",)), image[None], "image")
        compiled = open_onnxruntime(program.model_proto.SerializeToString(), 1)
        return partial(compiled, image[None].numpy())
    return torch.inference_mode()(partial(network, image[None]))


def detects_of(checkout: Path, names: Sequence[str]) -> dict[str, Callable[[Any], Any]]:
    """Return ``detect`` of another checkout's detectors; modules that are loaded stay loaded."""

    def loaded() -> dict[str, ModuleType]:
        ours = [name for name in sys.modules if name.partition(".")[0] == "roadtorch"]
        return {name: sys.modules[name] for name in ours}

    own_modules = loaded()
    for name in own_modules:
        del sys.modules[name]
    sys.path.insert(0, str(checkout))
    try:
        catalogue = importlib.import_module("roadtorch.detectors.catalogue")
        detects = {name: catalogue.load_detector(name).detect for name in names}
        image = render_scene(0).image
        for detect in detects.values():
            detect(image)  # what is imported late is that checkout's own, too
        return detects
    finally:
        sys.path.remove(str(checkout))
        for name in loaded():
            del sys.modules[name]
        sys.modules.update(own_modules)


def contestants(names: Sequence[str], image: Tensor, checkout: Path | None = None) -> Calls:
    """Return ``detect`` of the named detectors, that of another checkout, and the peers."""
    import skimage.segmentation

    detects = detects_of(checkout.resolve(), names) if checkout else {}
    calls: dict[str, Callable[[], Any]] = {}
    for name in names:
        calls[name] = partial(load_detector(name).detect, image)
        if checkout:
            calls[f"{name}{BEFORE}"] = partial(detects[name], image)
    rows = np.ascontiguousarray(image.permute(1, 2, 0).numpy())
    theirs = partial(skimage.segmentation.slic, rows, SEGMENTS, compactness=10)
    return {**calls, LRASPP: lraspp(image), SLIC: partial(slic, image, SEGMENTS), SKIMAGE: theirs}


def table(times: Times) -> str:
    """Format a row for each contestant, with its ratio to LRASPP and to the other checkout."""
    lines = ["| one thread | ms | of LRASPP | of before |", "|---|---:|---:|---:|"]
    for name, values in times.items():
        ratios = [f"{ratio(values, times[LRASPP]):.2f}"]
        ratios += [f"{ratio(values, times[name + BEFORE]):.2f}" if name + BEFORE in times else ""]
        lines.append(f"| {name} | {median(values):.1f} | {' | '.join(ratios)} |")
    return "\n".join(lines)


def suite(words: Sequence[str]) -> str:
    """Measure CPU seconds of the tests for each millisecond of LRASPP before and after them."""
    calls = {LRASPP: lraspp(render_scene(0, 480, 640).image.contiguous())}
    reference = interleaved(calls, 20)[LRASPP]
    subprocess.run([sys.executable, "-m", "pytest", "-q", *words], cwd=ROOT, check=False)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu, ms = used.ru_utime + used.ru_stime, median(reference + interleaved(calls, 20)[LRASPP])
    return f"tests: {cpu:.0f} s of CPU; {LRASPP}: {ms:.1f} ms; {cpu / ms:.2f} s per ms"


# --- runtimes -----------------------------------------------------------------------------

STAGES = ("decode", "network", "outlines", "rest")
RUNTIME_COLUMNS = (*STAGES, "detect", "of_lraspp", "of_before")
LARGE_AND_SMALL = ("fusion", "fusion:large")


def staged(name: str, runtime: str, data: bytes, rows: list[dict[str, float]]) -> Callable[[], Any]:
    """Return ``detect`` of a JPEG by a runtime; each call appends its stages' milliseconds."""
    detector, spent = load_detector(name, runtime=runtime), dict[str, float]()

    def timed(function: Callable[..., Any], stage: str) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            start = time.perf_counter()
            result = function(*arguments, **named)
            spent[stage] += (time.perf_counter() - start) * 1000
            return result

        return run

    for network in detector.modules():
        if isinstance(network, BackboneNetwork):
            setattr(network, "encode", timed(network.encode, "network"))  # noqa: B010
    decode, refine = timed(stages.as_image, "decode"), timed(stages.refine, "outlines")

    def detect() -> None:
        spent.update(dict.fromkeys(STAGES, 0.0))
        with patch.object(stages, "as_image", decode), patch.object(stages, "refine", refine):
            timed(detector.detect, "rest")(data)
        spent["rest"] -= spent["decode"] + spent["network"] + spent["outlines"]
        rows.append(dict(spent))

    return detect


def time_runtimes(image: Tensor, checkout: Path | None, rounds: int) -> dict[str, dict[str, float]]:
    """Time `fusion`, `fusion:large` and LRASPP by each runtime, and stages, all in turn.

    of_before: ratio to ``detect`` of another checkout by torch, for the same JPEG.
    """
    data = cv2.imencode(".jpg", to_pixels(image)[..., ::-1])[1].tobytes()
    earlier = detects_of(checkout.resolve(), LARGE_AND_SMALL) if checkout else {}
    rows: dict[str, list[dict[str, float]]] = defaultdict(list)
    calls: dict[str, Callable[[], Any]] = {}
    for name in LARGE_AND_SMALL:
        calls |= {f"{name}{BEFORE}": partial(earlier[name], data)} if earlier else {}
        calls |= {f"{name}:{by}": staged(name, by, data, rows[f"{name}:{by}"]) for by in RUNTIMES}
    calls |= {f"LRASPP:{by}": lraspp(image, by) for by in RUNTIMES}
    times, results = interleaved(calls, rounds), dict[str, dict[str, float]]()
    for key, values in times.items():
        name, _, runtime = key.rpartition(":")
        counted = rows[key][WARM_UP:]
        results[key] = {stage: median(row[stage] for row in counted) for stage in STAGES if counted}
        results[key]["detect"] = median(values)
        if runtime in RUNTIMES:
            results[key]["of_lraspp"] = ratio(values, times[f"LRASPP:{runtime}"])
        if runtime in RUNTIMES and name in earlier:
            results[key]["of_before"] = ratio(values, times[f"{name}{BEFORE}"])
    return results


def runtime_table(results: Mapping[str, Mapping[str, float]]) -> str:
    """Format milliseconds by stage, and the ratios."""
    lines = [f"| | {' | '.join(RUNTIME_COLUMNS)} |", f"|---|{'---:|' * len(RUNTIME_COLUMNS)}"]
    for key, values in results.items():
        cells = [f"{values[name]:.2f}" if name in values else "" for name in RUNTIME_COLUMNS]
        lines.append(f"| {key} | {' | '.join(cells)} |")
    return "\n".join(lines)


# --- commands -----------------------------------------------------------------------------

DETECT = """
import sys, torch
from roadtorch import load_detector
torch.set_num_threads(1)
detector = load_detector("fusion")
for path in sys.argv[1:]:
    detector.detect(path)
"""
COMMANDS = {
    "detect": DETECT,
    "infer": "infer images",
    "video": "infer clip.mp4 --limit {count}",
    "video-hd": "infer hd.mp4 --limit {count}",
    "bag": "infer drive",
    "grid": "infer images --save grid --set grid.height=1.5 --set grid.pitch=3 --set grid.fov=60",
    "grid-bag": "infer drive --save grid,bag --set grid.height=1.5 --set grid.pitch=3",
    "label": "label images",
    "evaluate": "evaluate camvid camvid --limit {count}",
    "train": "train --config adapt --images images --set stopping.epochs=1 "
    "--set samples_per_epoch=1",  # what is left of it is the preparation
}
FEW, ALL = 4, 100


def make_inputs(data: Path, folder: Path, count: int) -> None:
    """Link or write ``count`` images; a drive in two sizes and as a bag; CamVid."""
    from scripts.freeze import write_bags

    (folder / "images").mkdir(parents=True)
    for file in sorted((data / "camvid/train").glob("*.jpg"))[:count]:
        (folder / "images" / file.name).symlink_to(file)
    (folder / "camvid").symlink_to(data / "camvid")
    for name, size in {"clip.mp4": (640, 480), "hd.mp4": (1280, 720)}.items():
        resize_video(data / "clips/us_rural_damp.mp4", folder / name, size)
    write_bags(folder, slice(count))


def resize_video(path: Path, target: Path, size: tuple[int, int]) -> None:
    """Write a video in another size, width and height."""
    import av

    with av.open(str(path)) as source, av.open(str(target), "w") as container:
        stream = container.add_stream("libx264", rate=source.streams.video[0].average_rate)
        stream.width, stream.height = size
        for frame in source.decode(video=0):
            container.mux(stream.encode(frame.reformat(*size, interpolation="BICUBIC")))
        container.mux(stream.encode(None))


def seconds(checkout: Path, line: str, jobs: int, folder: Path) -> float:
    """Time a command of a checkout in a folder of inputs."""
    words = [sys.executable, "-m", "roadtorch", *line.split(), "--out", "out"]
    lines = [[*words, "--jobs", str(jobs)]]
    if line == DETECT:
        images = sorted(map(str, folder.glob("images/*")))
        lines = [[sys.executable, "-c", DETECT, *images[n::jobs]] for n in range(jobs)]
    elif line.startswith("train"):
        processors = sorted(os.sched_getaffinity(0))[:jobs]
        lines = [["taskset", "--cpu-list", ",".join(map(str, processors)), *words]]
    start = time.perf_counter()
    environment, quiet = {**os.environ, "PYTHONPATH": str(checkout.resolve())}, subprocess.DEVNULL
    processes = [
        subprocess.Popen(words, cwd=folder, env=environment, stdout=quiet, stderr=quiet)
        for words in lines
    ]
    if any([process.wait() for process in processes]):
        raise subprocess.SubprocessError(line)
    elapsed = time.perf_counter() - start
    shutil.rmtree(folder / "out", ignore_errors=True)
    return elapsed


def rates(
    data: Path,
    checkouts: Sequence[Path],
    rounds: int,
    names: Sequence[str],
    records: dict[str, float],
) -> Iterator[str]:
    """Yield rows with the images a second of each command and checkout, with one job and two.

    ``detect`` is timed in the rounds of ``infer``, whose fraction of it, with two jobs, comes last.
    records: gets the rates, those of the second checkout with ``before``.
    """
    yield "| command | checkout | 1 job | 2 jobs | ratio | of detect |"
    yield "|---|---|---:|---:|---:|---:|"
    with tempfile.TemporaryDirectory() as folder:
        for count in (FEW, ALL):
            make_inputs(data.resolve(), Path(folder, str(count)), count)
        for group in (["detect", "infer"] if name == "infer" else [name] for name in names):
            ways = list(product(group, checkouts, (1, 2), (FEW, ALL)))
            times: dict[tuple[str, Path, int, int], list[float]] = {way: [] for way in ways}
            for turn in range(rounds):
                for way in ways[turn % len(ways) :] + ways[: turn % len(ways)]:
                    name, checkout, jobs, count = way
                    line = COMMANDS[name].format(count=count)
                    times[way].append(seconds(checkout, line, jobs, Path(folder, str(count))))
            for name, checkout in product(group, checkouts):
                single, double, reference = (
                    (ALL - FEW) / (median(times[*way, ALL]) - median(times[*way, FEW]))
                    for way in ((name, checkout, 1), (name, checkout, 2), (group[0], checkout, 2))
                )
                record = f"commands.{name}" + (".before" if checkout != checkouts[0] else "")
                values = {"1": single, "2": double, "ratio": double / single}
                records.update({f"{record}.{key}": value for key, value in values.items()})
                fraction = f"{double / reference:.2f}" if len(group) > 1 else ""
                cells = f"{single:.1f} | {double:.1f} | {double / single:.2f} | {fraction}"
                yield f"| {name} | {checkout.resolve().name} | {cells} |"


def main(words: Sequence[str] | None = None) -> None:
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("detectors", nargs="*", help="or commands; by default nearly all")
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--write", action="store_true", help="into docs/figures")
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--runtimes", action="store_true", help="torch, ONNX Runtime")
    parser.add_argument("--commands", type=Path, metavar="DATA", help="has camvid/ and clips/")
    parser.add_argument("--suite", nargs=REMAINDER, help="the tests, with pytest's words")
    options = parser.parse_args(words)
    if options.suite is not None:
        print(suite(options.suite))
        return
    image = render_scene(0, 480, 640).image.contiguous()
    if options.commands:
        checkouts = [ROOT, options.against] if options.against else [ROOT]
        names = options.detectors or [name for name in COMMANDS if name != "detect"]
        run, command = "commands", COMMANDS_COMMAND
        records = json.loads((FIGURES / "commands.json").read_text(encoding="utf-8"))["values"]
        for row in rates(options.commands, checkouts, options.rounds, names, records):
            print(row, flush=True)
    elif options.runtimes:
        run, command = "runtimes", f"{COMMAND} --runtimes --against BEFORE"
        results = time_runtimes(image, options.against, options.rounds)
        records = dict(flatten(results, "runtimes."))
        print(runtime_table(results))
    else:
        names = options.detectors or [name for name in list_detectors() if "<" not in name]
        run, command = "bench", COMMAND
        times = interleaved(contestants(names, image, options.against), options.rounds)
        print(table(times))
        records = {f"bench.{PEERS.get(name, name)}.ms": median(ms) for name, ms in times.items()}
    if options.write:
        keep_records(run, command, records)


if __name__ == "__main__":
    main()
