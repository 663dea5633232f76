"""What is installed here, and whether it works: the report of ``roadtorch doctor``.

Each section imports what it looks at when it looks: what cannot be imported breaks itself alone.
"""

import json
import os
import platform
import re
import statistics
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import click

from roadtorch.base.bounded import reason
from roadtorch.base.compute import peak_mebibytes
from roadtorch.base.version import __version__

PACKAGE = "roadtorch"
OF_DEVELOPERS = ("docs", "test")  # extras that users have no need of

VIDEO = ("h264", "hevc", "vp9", "av1", "mpeg4", "mjpeg")  # that cameras and archives have

SCENE = 0  # seed of the rendered street
HEIGHT, WIDTH = 360, 480  # as the README's table of times
ROUNDS = 9  # of the self-test, after a first one
MIN_F = 0.85
"""Ours: the shipped weights have .95 on this street. Below this bound something is broken."""

AGAIN = "install roadtorch again"


@dataclass(frozen=True)
class Check:
    """What is found out about one part of an installation: a line of the report.

    state: missing is what can do without, broken is what cannot. what: version, figures, or what
    is wrong. remedy: what to do, where something is to be done. figures: numbers of ``what``, for
    programs.
    """

    name: str
    state: Literal["ok", "missing", "broken"]
    what: str
    remedy: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)


Report = dict[str, list[Check]]

# --- machine ----------------------------------------------------------------------------


def check_machine() -> list[Check]:
    """roadtorch, Python, the system, its memory, its processors and who takes how many of them."""
    is_checkout = (Path(__file__).parents[2] / "pyproject.toml").is_file()
    origin = "a checkout" if is_checkout else "an installed package"
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # the system does not say
        memory = 0
    gib = f"{memory / 2**30:.1f} GiB" if memory else "unknown"
    checks = [
        Check("roadtorch", "ok", f"{__version__}, {origin}"),
        Check("python", "ok", f"{platform.python_version()}, {platform.python_implementation()}"),
        Check("system", "ok", f"{platform.system()} {platform.release()}, {platform.machine()}"),
        Check("memory", "ok", gib, figures={"bytes": memory}),
    ]
    import cv2
    import torch

    from roadtorch.run.workers import processors

    figures = {
        "processors": processors(),
        "torch": torch.get_num_threads(),
        "opencv": cv2.getNumThreads(),
    }
    counts = [f"{name} {count}" for name, count in figures.items()]
    if limit := os.environ.get("OMP_NUM_THREADS"):
        counts.append(f"OMP_NUM_THREADS {limit}")
    return [*checks, Check("threads", "ok", ", ".join(counts), "", figures)]


# --- packages ---------------------------------------------------------------------------


def check_packages() -> list[Check]:
    """Check every package that roadtorch cannot do without, in the order of their names."""
    versions = {name: _installed(name) for name in _requirements("")}
    return [
        Check(name, "ok", release)
        if release
        else Check(name, "broken", "is not installed", f"pip install {name}")
        for name, release in versions.items()
    ]


def check_extras() -> list[Check]:
    """Check every extra: ok when all its packages are installed."""
    checks: list[Check] = []
    for name in sorted({*(metadata(PACKAGE).get_all("Provides-Extra") or [])} - {*OF_DEVELOPERS}):
        versions = {package: _installed(package) for package in _requirements(name)}
        absent = [package for package, release in versions.items() if not release]
        if absent:
            what = f"{', '.join(absent)} not installed"
            checks.append(Check(name, "missing", what, f"pip install '{PACKAGE}[{name}]'"))
        else:
            what = ", ".join(f"{package} {release}" for package, release in versions.items())
            checks.append(Check(name, "ok", what))
    return checks


def _requirements(extra: str) -> list[str]:
    """Return the names of the packages that an extra adds; for "", of those needed without any."""
    names = []
    for text in requires(PACKAGE) or []:
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


# --- videos -----------------------------------------------------------------------------


def check_codecs() -> list[Check]:
    """Check which codecs of videos PyAV reads and writes."""
    if find_spec("av") is None:
        remedy = "pip install 'roadtorch[video]'"
        return [Check("video", "missing", "PyAV is not installed", remedy)]
    import av

    read = [name for name in VIDEO if name in av.codecs_available]
    absent = [name for name in VIDEO if name not in read]
    library = ".".join(map(str, av.library_versions["libavcodec"]))
    writes = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    what = f"PyAV {av.__version__}, libavcodec {library}: reads {' '.join(read)}; writes {writes}"
    what += f"; does not read {' '.join(absent)}" if absent else ""
    return [Check("video", "ok", what)]


# --- weights ----------------------------------------------------------------------------


def check_weights() -> list[Check]:
    """Every weight file that comes with roadtorch: read, and held against its header's hash."""
    from roadtorch.base.atomic import digest_of
    from roadtorch.base.errors import WeightsError
    from roadtorch.layout.weights import list_shipped_weights, load_network, shipped_weights

    checks: list[Check] = []
    for path in map(shipped_weights, list_shipped_weights()):
        try:
            network = load_network(path)
        except WeightsError as problem:
            checks.append(Check(path.name, "broken", problem.what, AGAIN))
            continue
        count = sum(weight.numel() for weight in network.parameters())
        what = f"{count:,} weights, SHA-256 {digest_of(path)[:12]}…"
        checks.append(Check(path.name, "ok", what, figures={"weights": count}))
    return checks or [Check("weights", "broken", "none are there", AGAIN)]


# --- a street ---------------------------------------------------------------------------


def check_self_test() -> list[Check]:
    """``fusion`` on one rendered street: F, median ms, most memory; the same bytes each time."""
    import torch

    from roadtorch.detectors.catalogue import load_detector
    from roadtorch.evaluation.metrics import count_mask, f_measure
    from roadtorch.testing.scenes import render_scene

    scene, detector = render_scene(SCENE, HEIGHT, WIDTH), load_detector("fusion")
    first = detector.detect(scene.image)  # what is built on first use is no part of the time
    times: list[float] = []
    same = True
    for _ in range(ROUNDS):
        start = perf_counter()
        again = detector.detect(scene.image)
        times.append(1000 * (perf_counter() - start))
        same &= torch.equal(first.likelihood, again.likelihood)
    f = round(float(f_measure(count_mask(first.mask, scene.road, ~scene.void))), 4)
    ms, peak = round(statistics.median(times), 1), round(peak_mebibytes())
    figures = {"f": f, "ms": ms, "rounds": ROUNDS, "peak_mib": peak}
    what = f"F {f:.3f}, {ms:.0f} ms at {WIDTH}×{HEIGHT} (median of {ROUNDS}), {peak} MiB at most"
    wrong = "" if same else "; two runs differ"
    if not f >= MIN_F:  # also true of NaN
        wrong = f"; F is to be {MIN_F}"
    if wrong:
        return [Check("fusion", "broken", what + wrong, "report it with this page", figures)]
    return [Check("fusion", "ok", what, "", figures)]


# --- the report -------------------------------------------------------------------------

SECTIONS: dict[str, Callable[[], list[Check]]] = {
    "machine": check_machine,
    "packages": check_packages,
    "extras": check_extras,
    "codecs": check_codecs,
    "weights": check_weights,
    "self-test": check_self_test,
}
"""What is looked at, in this order."""


def examine() -> Report:
    """Look at every section."""
    report: Report = {}
    for section, look in SECTIONS.items():
        try:
            report[section] = look()
        except Exception as problem:  # an installation can be broken in any way
            what = f"{type(problem).__name__}: {reason(problem)}"
            report[section] = [Check(section, "broken", what, AGAIN)]
    return report


def is_well(report: Report) -> bool:
    """Whether nothing is broken; what is missing can be done without."""
    return all(check.state != "broken" for checks in report.values() for check in checks)


def as_text(report: Report) -> str:
    """A line for each check under the name of its section; the remedies in brackets."""
    width = max(len(check.name) for checks in report.values() for check in checks)
    lines = [f"roadtorch {__version__}"]
    for name, checks in report.items():
        lines += ["", name]
        for check in checks:
            remedy = f" ({check.remedy})" if check.remedy else ""
            lines.append(f"  {check.state:<8} {check.name:<{width}}  {check.what}{remedy}")
    return "\n".join(lines)


def as_document(report: Report) -> dict[str, Any]:
    """The same for programs: as JSON can hold it."""
    checks = [
        {"section": section, **asdict(check)}
        for section, of_section in report.items()
        for check in of_section
    ]
    return {"roadtorch": __version__, "well": is_well(report), "checks": checks}


@click.command()
@click.option("--json", "machine_readable", is_flag=True, help="For programs.")
@click.pass_context
def doctor(context: click.Context, machine_readable: bool) -> None:
    """Check this installation and run it on a rendered street, in about five seconds.

    Versions, threads, video codecs, extras, the weights' hashes, and of the street:
    F, time and memory. Paste what it prints into a report. The exit code is 1 when something is
    broken; what is only missing comes with the line that installs it.
    """
    report = examine()
    text = json.dumps(as_document(report), indent=2) if machine_readable else as_text(report)
    click.echo(text)
    context.exit(0 if is_well(report) else 1)
