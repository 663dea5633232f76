"""roadtorch doctor: what is installed here, and whether it works.

Each section imports what it looks at when it looks: what cannot be imported breaks itself alone.
"""

import os
import platform
import re
import statistics
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from time import perf_counter
from typing import Literal, NamedTuple

import click

from roadtorch.base.bounded import reason
from roadtorch.base.compute import peak_mebibytes
from roadtorch.base.version import __version__

OF_DEVELOPERS = ("docs", "test")  # extras that users have no need of

VIDEO = ("h264", "hevc", "vp9", "av1", "mpeg4", "mjpeg")  # that cameras and archives have

HEIGHT, WIDTH = 360, 480  # of the street, as the README's table of times
ROUNDS = 9  # of the self-test, after a first one
MIN_F = 0.85
"""Ours: the shipped weights have .95 on this street. Below this bound something is broken."""

AGAIN = "install roadtorch again"


class Check(NamedTuple):
    """One part of an installation: a line of the report.

    state: missing is what can do without, broken is what cannot. what: version, figures, or what
    is wrong. remedy: what to do, where something is to be done.
    """

    name: str
    state: Literal["ok", "missing", "broken"]
    problem: str
    hint: str = ""


def check_machine() -> list[Check]:
    """Look at Python, the system, its processors and who takes how many of them."""
    import cv2
    import torch

    from roadtorch.run.workers import processors

    limit = os.environ.get("OMP_NUM_THREADS", "not set")
    threads = f"processors {processors()}, torch {torch.get_num_threads()}, "
    threads += f"opencv {cv2.getNumThreads()}, OMP_NUM_THREADS {limit}"
    return [
        Check("python", "ok", f"{platform.python_version()}, {platform.python_implementation()}"),
        Check("system", "ok", f"{platform.system()} {platform.release()}, {platform.machine()}"),
        Check("threads", "ok", threads),
    ]


def check_packages() -> list[Check]:
    """Look at the packages that roadtorch cannot do without, and at those of each extra."""
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
        if absent and extra not in OF_DEVELOPERS:
            problem = f"{', '.join(absent)} not installed"
            checks.append(Check(extra, "missing", problem, f"pip install 'roadtorch[{extra}]'"))
        elif not absent:
            problem = ", ".join(f"{name} {release}" for name, release in versions.items())
            checks.append(Check(extra, "ok", problem))
    return checks


def _requirements(extra: str) -> list[str]:
    """Return the names of the packages that an extra adds; for "", of those needed without any."""
    names = []
    for text in requires("roadtorch") or []:
        marker = re.search(r"""extra == ["']([^"']+)""", text)
        if (marker[1] if marker else "") == extra:
            names.append(re.split(r"[^\w.-]", text, maxsplit=1)[0])
    return sorted(names)


def _installed(package: str) -> str:
    """Return the installed version of a package; "" where there is none."""
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def check_video() -> list[Check]:
    """Look at the codecs of videos that PyAV reads and writes."""
    try:
        import av
    except ImportError:
        hint = "pip install 'roadtorch[video]'"
        return [Check("video", "missing", "PyAV is not installed", hint)]
    read = [name for name in VIDEO if name in av.codecs_available]
    absent = [name for name in VIDEO if name not in read]
    writes = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    problem = f"PyAV {av.__version__}: reads {' '.join(read)}; writes {writes}"
    return [
        Check("video", "ok", problem + (f"; does not read {' '.join(absent)}" if absent else ""))
    ]


def check_weights() -> list[Check]:
    """Read every weight file that comes with roadtorch, and hold it against its header's hash."""
    from roadtorch.base.atomic import digest_of
    from roadtorch.base.errors import WeightsError
    from roadtorch.layout.weights import list_shipped_weights, load_network, shipped_weights

    checks: list[Check] = []
    for path in map(shipped_weights, list_shipped_weights()):
        try:
            load_network(path)
            checks.append(Check(path.name, "ok", f"SHA-256 {digest_of(path)[:12]}…"))
        except WeightsError as error:
            checks.append(Check(path.name, "broken", error.problem, AGAIN))
    return checks or [Check("weights", "broken", "none are there", AGAIN)]


def check_self_test() -> list[Check]:
    """Run ``fusion`` on a rendered street: F, median ms, most memory; the same bytes each time."""
    import torch

    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.evaluation.metrics import count_mask, f_measure
    from roadtorch.testing.scenes import render_scene

    scene, detector = render_scene(0, HEIGHT, WIDTH), load_detector("fusion")
    first = detector.detect(scene.image)  # what is built on first use is no part of the time
    times: list[float] = []
    same = True
    for _ in range(ROUNDS):
        start = perf_counter()
        again = detector.detect(scene.image)
        times.append(1000 * (perf_counter() - start))
        same &= torch.equal(first.likelihood, again.likelihood)
    f, ms = (
        float(f_measure(count_mask(first.mask, scene.road, ~scene.void))),
        statistics.median(times),
    )
    problem = f"F {f:.3f}, {ms:.0f} ms at {WIDTH}×{HEIGHT} (median of {ROUNDS}), "
    problem += f"{peak_mebibytes():.0f} MiB at most"
    wrong = "" if same else "; two runs differ"
    if not f >= MIN_F:  # also true of NaN
        wrong = f"; F is to be {MIN_F}"
    if wrong:
        return [Check("fusion", "broken", problem + wrong, "report it with this page")]
    return [Check("fusion", "ok", problem)]


SECTIONS: dict[str, Callable[[], list[Check]]] = {
    "machine": check_machine,
    "packages": check_packages,
    "video": check_video,
    "weights": check_weights,
    "self-test": check_self_test,
}
"""What is looked at, in this order."""


@click.command()
@click.pass_context
def doctor(context: click.Context) -> None:
    """Check this installation and run it on a rendered street, in about five seconds.

    Versions, threads, video codecs, extras, the weights' hashes, and of the street:
    F, time and memory. Paste what it prints into a report. The exit code is 1 when something is
    broken; what is only missing comes with the line that installs it.
    """
    click.echo(f"roadtorch {__version__}")
    is_well = True
    for section, look in SECTIONS.items():
        try:
            checks = look()
        except Exception as error:  # an installation can be broken in any way
            problem = f"{type(error).__name__}: {reason(error)}"
            checks = [Check(section, "broken", problem, AGAIN)]
        click.echo(f"\n{section}")
        for check in checks:
            hint = f" ({check.hint})" if check.hint else ""
            click.echo(f"  {check.state:<8} {check.name:<28} {check.problem}{hint}")
            is_well &= check.state != "broken"
    context.exit(0 if is_well else 1)
