"""roadtorch doctor: check this installation.

Each section imports the packages that it checks, so that one that fails breaks only its section.
"""

import importlib
import os
import platform
import re
import statistics
from base64 import urlsafe_b64decode
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib.metadata import (
    PackageNotFoundError,
    distribution,
    metadata,
    packages_distributions,
    requires,
    version,
)
from itertools import product
from pathlib import Path
from pkgutil import walk_packages
from time import perf_counter
from typing import TYPE_CHECKING, Literal, NamedTuple

import click

from roadtorch.base.bounded import reason
from roadtorch.base.compute import peak_memory_mib
from roadtorch.base.version import __version__

if TYPE_CHECKING:
    from roadtorch.detectors.detector import Detector

DEVELOPER_EXTRAS = ("docs", "test")  # not reported as missing
VIDEO_CODECS = ("h264", "hevc", "vp9", "av1", "mpeg4", "mjpeg")  # of cameras and archives
STREET_HEIGHT, STREET_WIDTH = 360, 480  # of the self-test
ROUNDS = 9  # timed runs of each runtime
BENCH_DETECTORS = ("fusion", "fusion:large")
MIN_F = 0.85
"""F-score below which the self-test fails; ours: the shipped weights have .95 on this street."""

BUSY_LOAD = 0.5
"""Load for each processor above which times mean little."""

REINSTALL_HINT = "reinstall with pip install --force-reinstall --no-deps roadtorch"


class Check(NamedTuple):
    """One part of an installation: a line of the report."""

    name: str
    state: Literal["ok", "missing", "broken"]  # missing parts are optional, broken ones are not
    details: str  # version, figures or problem
    hint: str = ""


def check_machine() -> list[Check]:
    """Report Python, the system, its processors and the threads of libraries."""
    import cv2
    import torch

    from roadtorch.run.workers import count_processors

    load, processors = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0, count_processors()
    limit = os.environ.get("OMP_NUM_THREADS", "not set")
    threads = f"processors {processors}, torch {torch.get_num_threads()}, "
    threads += f"opencv {cv2.getNumThreads()}, OMP_NUM_THREADS {limit}"
    busy = f"load {load:.1f} on {processors} processors"
    busy += ": the times below mean little" if load > BUSY_LOAD * processors else ""
    board = Path("/proc/device-tree/model")  # such as Raspberry Pi 5 Model B
    model = platform.machine()
    with suppress(OSError, ValueError):
        model = board.read_text().strip("\0")
    return [
        Check("python", "ok", f"{platform.python_version()}, {platform.python_implementation()}"),
        Check("system", "ok", f"{platform.system()} {platform.release()}, {model}"),
        Check("threads", "ok", threads),
        Check("load", "ok", busy),
    ]


def check_files() -> list[Check]:
    """Compare roadtorch's files with the hashes that pip recorded, and import every module."""
    import roadtorch
    from roadtorch.base.atomic import file_digest

    recorded = {
        file: file.hash.value for file in distribution("roadtorch").files or () if file.hash
    }
    broken = {
        str(file): "differs from what was installed" if digest else "is missing"
        for file, record in recorded.items()
        if (digest := file_digest(Path(str(file.locate()))))
        != urlsafe_b64decode(f"{record}=").hex()
    }
    for module in walk_packages(roadtorch.__path__, "roadtorch.", onerror=lambda name: None):
        try:
            importlib.import_module(module.name)
        except ImportError as error:  # of a package of an extra
            if (error.name or "roadtorch").split(".")[0] == "roadtorch":
                broken[module.name] = reason(error)
    if broken:
        return [Check(name, "broken", problem, REINSTALL_HINT) for name, problem in broken.items()]
    return [Check("roadtorch", "ok", f"{len(recorded)} files are those that were installed")]


def check_packages() -> list[Check]:
    """Check the required packages, and those of each extra."""
    checks = [
        Check(name, "ok", release)
        if (release := _installed(name))
        else Check(name, "broken", "is not installed", f"pip install {name}")
        for name in _requirements("")
    ]
    extras: set[str] = {*(metadata("roadtorch").get_all("Provides-Extra") or [])}
    for extra in sorted(extras):
        versions = {name: _installed(name) for name in _requirements(extra)}
        absent = [name for name, release in versions.items() if not release]
        if absent and extra not in DEVELOPER_EXTRAS:
            details = f"{', '.join(absent)} not installed"
            checks.append(Check(extra, "missing", details, f"pip install 'roadtorch[{extra}]'"))
        elif not absent:
            details = ", ".join(f"{name} {release}" for name, release in versions.items())
            checks.append(Check(extra, "ok", details))
    return checks


def _requirements(extra: str) -> list[str]:
    """Return the names of the packages of an extra; for "", of the required ones."""
    names = []
    for text in requires("roadtorch") or []:
        marker = re.search(r"""extra == ["']([^"']+)""", text)
        if (marker[1] if marker else "") == extra:
            names.append(re.split(r"[^\w.-]", text, maxsplit=1)[0])
    return sorted(names)


def _installed(package: str) -> str:
    """Return the installed version of a package, or of another with its module; "" without any."""
    try:
        return version(package)
    except PackageNotFoundError:  # it may be onnxruntime-gpu
        names = packages_distributions().get(package, ())
        return version(names[0]) if names else ""


def check_video() -> list[Check]:
    """Check PyAV and its video codecs."""
    try:
        import av
    except ImportError:
        hint = "pip install 'roadtorch[video]'"
        return [Check("video", "missing", "PyAV is not installed", hint)]
    readable = [name for name in VIDEO_CODECS if name in av.codecs_available]
    absent = [name for name in VIDEO_CODECS if name not in readable]
    writes = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    details = f"PyAV {av.__version__}: reads {' '.join(readable)}; writes {writes}"
    details += f"; does not read {' '.join(absent)}" if absent else ""
    return [Check("video", "ok", details)]


def check_weights() -> list[Check]:
    """Load every shipped weight file, which compares it with the hash in its header."""
    from roadtorch.base.atomic import file_digest
    from roadtorch.base.errors import WeightsError
    from roadtorch.layout.weights import list_shipped_weights, load_network, shipped_weights

    checks: list[Check] = []
    for path in map(shipped_weights, list_shipped_weights()):
        try:
            load_network(path)
            checks.append(Check(path.name, "ok", f"SHA-256 {file_digest(path)[:12]}…"))
        except WeightsError as error:
            checks.append(Check(path.name, "broken", error.problem, REINSTALL_HINT))
    return checks or [Check("weights", "broken", "no weight files", REINSTALL_HINT)]


def check_self_test() -> list[Check]:
    """Run ``fusion`` on a rendered street: F-score, peak memory, determinism."""
    import torch

    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.evaluation.metrics import count_mask, f_measure
    from roadtorch.testing.scenes import render_scene

    scene, detector = render_scene(0, STREET_HEIGHT, STREET_WIDTH), load_detector("fusion")
    first, repeat = detector.detect(scene.image), detector.detect(scene.image)
    is_deterministic = torch.equal(first.likelihood, repeat.likelihood)
    f = float(f_measure(count_mask(first.mask, scene.road, ~scene.void)))
    details = f"F {f:.3f} at {STREET_WIDTH}×{STREET_HEIGHT}, {peak_memory_mib():.0f} MiB at most"
    fault = "" if is_deterministic else "; not deterministic: two results for one image"
    if not f >= MIN_F:  # also true of NaN
        fault = f"; F should be at least {MIN_F}"
    if fault:
        return [Check("fusion", "broken", details + fault, "report it with this output")]
    return [Check("fusion", "ok", details)]


def check_runtimes(names: Sequence[str] = ("fusion",)) -> list[Check]:
    """Time detectors by each runtime on one thread, in turn: medians."""
    from roadtorch.base.errors import ConfigError
    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.layout.runtimes import RUNTIMES
    from roadtorch.testing.scenes import render_scene

    detectors: dict[str, Detector] = {}
    checks: list[Check] = []
    for name, runtime in product(names, RUNTIMES):
        title = f"{name}, {runtime}"
        try:
            detectors[title] = load_detector(name, runtime=runtime)
        except ConfigError as error:
            state = "missing" if "not installed" in error.problem else "broken"
            checks.append(Check(title, state, error.problem, error.hint))
    image, times = render_scene(0, 480, 640).image, defaultdict[str, list[float]](list)
    for _, (title, detector) in product(range(1 + ROUNDS), detectors.items()):
        start = perf_counter()
        detector.detect(image)
        times[title].append(1000 * (perf_counter() - start))
    for title, (_, *counted) in times.items():
        ms = statistics.median(counted)
        checks.append(Check(title, "ok", f"{ms:.1f} ms, {1000 / ms:.1f} fps at 640×480"))
    return checks


CHECKS: dict[str, Callable[[], list[Check]]] = {
    "machine": check_machine,
    "files": check_files,
    "packages": check_packages,
    "video": check_video,
    "weights": check_weights,
    "self-test": check_self_test,
    "runtimes": check_runtimes,
}
"""Checks by section of the report, in order."""

BENCH = {"machine": check_machine, "runtimes": partial(check_runtimes, BENCH_DETECTORS)}
"""The sections with ``--bench``."""


@click.command()
@click.option("--bench", is_flag=True, help="Print only the machine, and speeds by runtime.")
@click.pass_context
def doctor_command(context: click.Context, bench: bool) -> None:
    """Check this installation and run it on a rendered street, in about ten seconds.

    Prints versions, threads, video codecs, extras, hashes of the weights, F-score and memory on the
    street, and the time with each runtime. Paste the output into a bug report. The exit code
    is 1 if something is broken; missing extras are listed with the command that installs them.
    """
    click.echo(f"roadtorch {__version__}")
    is_sound = True
    for section, run_checks in (BENCH if bench else CHECKS).items():
        try:
            checks = run_checks()
        except Exception as error:  # an installation can be broken in any way
            details = f"{type(error).__name__}: {reason(error)}"
            checks = [Check(section, "broken", details, REINSTALL_HINT)]
        click.echo(f"\n{section}")
        for check in checks:
            hint = f" ({check.hint})" if check.hint else ""
            click.echo(f"  {check.state:<8} {check.name:<28} {check.details}{hint}")
            is_sound &= check.state != "broken"
    context.exit(0 if is_sound else 1)
