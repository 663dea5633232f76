"""The evaluations whose figures stand in README and docs: commands, and what they found."""

import json
import shlex
import subprocess
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.layout.weights import load_network, shipped_weights
from roadtorch.oneclass import CLASSIFIERS
from scripts.bound_figures import Record, Records, write_records

ROOT = Path(__file__).resolve().parents[1]

FUSIONS = ("fusion", "fusion:research", "fusion:untrained", "fusion:paper")
ROAD = (
    *FUSIONS,
    *("layout", "layout:cnn-7", "labeller", "ufl", "ufl:original", "cpf", "cpf:v2", "cpf:squares"),
    *("grey-uniformity", "lbp", "prior:uniform"),
)
SLOW = ("fusion", "ufl:kitti", "kmeans-road", "vanishing-point")


class Run(NamedTuple):
    """One evaluation: its name in records, the words of its command, and who is scored.

    In the words DATA is the folder of the data, OUT that of all runs.
    """

    name: str
    words: tuple[str, ...]
    detectors: tuple[str, ...]

    def command(self, data: str, out: str) -> list[str]:
        """What is run, from ``evaluate`` on."""
        given = [word.replace("DATA", data).replace("OUT", out) for word in self.words]
        named = [word for name in self.detectors for word in ("--detector", name)]
        into = ["--against", "fusion", "--montage", "0", "--out", f"{out}/{self.name}"]
        return ["evaluate", *given, *named, *into]


CAMVID, IDD = ("camvid", "DATA/camvid"), ("idd-lite", "DATA/idd_lite")

RUNS = (
    Run(
        "many",
        ("folder", "DATA/many", "--leave-out", "india_zed"),
        (*FUSIONS, "layout", "labeller", "ufl"),
    ),
    Run("camvid", CAMVID, ROAD),
    Run(
        "idd",
        (*IDD, "--mean-from", "camvid:DATA/camvid", "--threshold-from", "OUT/camvid/metrics.json"),
        ROAD,
    ),
)

SLOW_RUNS = (
    Run("camvid-slow", (*CAMVID, "--limit", "24"), SLOW),
    Run("idd-slow", (*IDD, "--limit", "24"), SLOW),
)
"""Detectors of seconds a picture, on few pictures; only where they are asked for by name."""


def evaluate(data: Path, out: Path, names: Collection[str], jobs: int) -> None:
    """Run the evaluations of these names, in their order; CalledProcessError where one fails."""
    for run in (*RUNS, *SLOW_RUNS):
        if run.name in names:
            words = run.command(str(data), str(out))
            more = ["--jobs", str(jobs)]
            command = [sys.executable, "-m", "roadtorch", *words, *more]
            print(shlex.join(["roadtorch", *words]), file=sys.stderr)
            subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)


def collect(out: Path, figures: Path, used: Collection[str]) -> list[Path]:
    """Write the records that documents use, of every run in ``out``, a file each."""
    written = []
    for run in (*RUNS, *SLOW_RUNS):
        path = out / run.name / "metrics.json"
        if not path.exists():
            continue
        command = shlex.join(["roadtorch", *run.command("DATA", "OUT")])
        metrics = json.loads(path.read_text(encoding="utf-8"))
        found = records_of(run.name, metrics, command)
        kept = {name: one for name, one in found.items() if name in used}
        if kept:
            written.append(figures / f"{run.name}.json")
            write_records(written[-1], kept)
    return written


# --- metrics.json as records ---------------------------------------------------------------

NOT_FIGURES = ("settings", "images_by_f", "ci95", "groups", "left_out", "pooled", "conditions")


def records_of(name: str, metrics: Mapping[str, Any], command: str) -> dict[str, Record]:
    """All numbers of a metrics.json, flat.

    ``RUN.DETECTOR.MEASURE``, with ``.low`` and ``.high`` its interval, ``@GROUP`` one camera, drive
    or condition, ``.worst`` and ``.worst.camera`` the lowest of the groups, ``.less`` and then low
    and high its difference to ``fusion``; ``RUN.images``, ``RUN.groups``.
    """
    found: dict[str, float | str] = {f"{name}.images": metrics["images"]}
    for detector, one in metrics["detectors"].items():
        own = f"{name}.{detector}"
        found[f"{name}.groups"] = len(one.get("groups", {}))
        found |= {f"{own}.{key}": value for key, value in _flat(one)}
        for part in ("groups", "conditions"):
            for group, figures in one.get(part, {}).items():
                found |= {f"{own}.{key}@{group}": value for key, value in _flat(figures)}
        found |= _worst(own, one.get("groups", {})) | _over_lbp(own, one, metrics["detectors"])
        found |= _ends(own, one["ci95"])
        for key, change in metrics["paired"]["detectors"].get(detector, {}).items():
            found[f"{own}.{key}.less"] = change["difference"]
            found |= _ends(own, {f"{key}.less": change["ci95"]})
    return {
        key: Record(value, _unit(key), command) for key, value in found.items() if value is not None
    }


def _flat(figures: Mapping[str, Any], under: str = "") -> Iterator[tuple[str, float]]:
    for key, value in figures.items():
        if isinstance(value, Mapping) and key not in NOT_FIGURES:
            yield from _flat(value, f"{under}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield under + key, value


def _worst(own: str, groups: Mapping[str, Mapping[str, Any]]) -> dict[str, float | str]:
    """The lowest F of the mask and MaxF of all groups, and whose they are."""
    found: dict[str, float | str] = {}
    for key in ("f_mask", "maxf"):
        values = {name: one[key] for name, one in groups.items() if one.get(key) is not None}
        if values:
            name = min(values, key=lambda each: values[each])
            found |= {f"{own}.{key}.worst": values[name], f"{own}.{key}.worst.camera": name}
    return found


def _over_lbp(own: str, one: Mapping[str, Any], every: Mapping[str, Any]) -> dict[str, float]:
    """How much larger the pooled AUC is than that of ``lbp``, as a share: P2's improvement."""
    other = every.get("lbp", {}).get("auc_pooled")
    return {f"{own}.auc_pooled.over_lbp": one["auc_pooled"] / other - 1} if other else {}


def _ends(own: str, intervals: Mapping[str, Sequence[float] | None]) -> dict[str, float]:
    found = {}
    for key, ends in intervals.items():
        if ends is not None and None not in ends:
            found |= {f"{own}.{key}.low": ends[0], f"{own}.{key}.high": ends[1]}
    return found


def _unit(key: str) -> str:
    last = key.rpartition(".")[2].partition("@")[0]
    return {"images": "pictures", "groups": "groups", "ms_per_image": "ms", "camera": "name"}.get(
        last, "share"
    )


# --- what the code itself says ---------------------------------------------------------------


def facts() -> Records:
    """Numbers that the code or its files know; found anew each time they are asked for."""
    grid = {name.rpartition(":")[2] for name in list_detectors("oneclass:*")}
    network = load_network(shipped_weights("layout"))
    settings = detector_entry("fusion").settings()
    with (ROOT / "train" / "pictures.csv").open(encoding="utf-8") as file:
        taught = sum(1 for _ in file) - 1
    values: dict[str, tuple[float, str]] = {
        "facts.classifiers": (len(CLASSIFIERS), "classifiers"),
        "facts.representations": (len(grid), "representations"),
        "facts.network.weights": (sum(each.numel() for each in network.parameters()), "weights"),
        "facts.training_pictures": (taught, "pictures"),
        "facts.working_pixels": (settings.model_dump()["working"]["pixels"], "pixels"),
    }
    return {name: Record(value, unit, "the code") for name, (value, unit) in values.items()}
