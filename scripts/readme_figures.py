"""The figures of README and docs: written from records of evaluations, and held against them.

    python scripts/readme_figures.py evaluate DATA   # score, keep the records, write the documents
    python scripts/readme_figures.py write           # documents as docs/figures have them
    python scripts/readme_figures.py check           # is every number bound, and as recorded?

DATA holds many/, camvid/ and idd_lite/. ``evaluate`` takes about ten minutes on two quiet cores;
--only NAME… does some of it (camvid-slow, idd-slow: detectors of seconds a picture). A figure is
bound by a comment right after it, which no reader sees, with the name of a record::

    F of the mask is .827<!-- figure: many.fusion.f_mask --> on average
    the worst camera is `dn_tas500`<!-- figure: many.fusion.f_mask.worst.camera -->

It is said with as many digits as it has there. What the code itself says is a record, too:
``code:MODULE:NAME``, ``setting:DETECTOR:KEY``, ``config:NAME:KEY`` of configs/NAME.toml and
``card:NAME:SOME_WORDS``, the first number before these words on a card of weights; ``/GiB``
behind it divides. Every other number that was measured names the study that it is of
(scripts/readme_numbers.py). What stands between ``<!-- table: NAME -->`` and
``<!-- end -->`` is written whole. A file of records is {"command": …, "values": {name: value}};
names are RUN.DETECTOR.MEASURE, with ``.low`` and ``.high`` its interval, ``@GROUP`` one camera,
drive or condition, ``.worst`` and ``.worst.camera`` the lowest of the groups, ``.less`` the
difference to ``fusion``, ``.iou`` that of an F.
"""

import argparse
import csv
import difflib
import importlib
import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.base.settings import build_settings, read_settings_file
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.layout.weights import card_of, shipped_weights
from roadtorch.oneclass import CLASSIFIERS
from scripts.readme_numbers import unbound
from scripts.readme_tables import FUSIONS, MINUS, ROAD, SLOW, TABLES, Records, restated

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"

# --- what is scored ------------------------------------------------------------------------


class Run(NamedTuple):
    """One evaluation: the words of its command, who is scored, and the commands before it.

    In the words DATA is the folder of the data, OUT that of all runs. compared: of ``compare``,
    whose mean IoU of both masks is a record as well.
    """

    words: str
    detectors: Sequence[str]
    before: Sequence[str] = ()
    compared: str = ""

    def commands(self, name: str) -> list[str]:
        """What is run: ``evaluate`` is the last but ``compare``."""
        named = " ".join(f"--detector {detector}" for detector in self.detectors)
        scored = f"{self.words} {named} --against fusion --montage 0 --out OUT/{name}"
        last = [f"roadtorch compare {self.compared} --out OUT/{name}"] if self.compared else []
        return [*self.before, f"roadtorch evaluate {scored}", *last]


EXPORTED = ("fusion", "fusion:large")


def of_exported(words: str, root: str, detectors: Sequence[str], compared: str = "") -> Run:
    """Detectors beside their exported networks, which examples/infer.py runs on a set."""
    before, maps = [], ""
    for detector in detectors:
        file, folder = f"OUT/{detector}.onnx", f"OUT/maps/{detector}"
        before.append(f"roadtorch export {detector} --out {file}")
        before.append(f"python docs/examples/infer.py {file} {root} {folder}")
        maps += f" --maps {detector}={folder}"
    return Run(words + maps, detectors, before, compared)


RUNS = {
    "many": Run("folder DATA/many --leave-out india_zed", (*FUSIONS, "labeller", "ufl")),
    "camvid": Run("camvid DATA/camvid", ROAD),
    "idd": Run(
        "idd-lite DATA/idd_lite --mean-from camvid:DATA/camvid "
        "--threshold-from OUT/camvid/metrics.json",
        ROAD,
    ),
    "export": of_exported(
        "folder DATA/many --leave-out india_zed",
        "DATA/many",
        EXPORTED,
        "fusion OUT/maps/fusion --images 'DATA/many/[!i]*/images/*.jpg'",
    ),
    "export-camvid": of_exported("camvid DATA/camvid", "DATA/camvid", EXPORTED[:1]),
    "camvid-slow": Run("camvid DATA/camvid --limit 24", SLOW),
    "idd-slow": Run("idd-lite DATA/idd_lite --limit 24", SLOW),
}


def evaluate(data: Path, out: Path, names: Sequence[str], jobs: int) -> None:
    """Run evaluations, and keep what documents use of them; CalledProcessError where one fails."""
    asked = used()
    for name in names:
        commands = RUNS[name].commands(name)
        for command in commands:
            words = shlex.split(command.replace("DATA", str(data)).replace("OUT", str(out)))
            start = [sys.executable, "-m", "roadtorch"] if words[0] == "roadtorch" else []
            words = [*(start or [sys.executable]), *words[1:]]
            words += ["--jobs", str(jobs)] * (words[3:4] == ["evaluate"])
            subprocess.run(words, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
        metrics = json.loads((out / name / "metrics.json").read_text(encoding="utf-8"))
        values = records_of(name, metrics) | records_of_masks(name, out / name)
        kept = {key: values[key] for key in sorted(values) if key in asked}
        text = json.dumps({"command": " && ".join(commands), "values": kept}, indent=0)
        (FIGURES / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


def records_of_masks(run: str, folder: Path) -> dict[str, float]:
    """The mean IoU of two masks of each picture, where ``compare`` looked at them."""
    path = folder / "disagreement.csv"
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        return {f"{run}.masks.iou": fmean(float(row["iou"]) for row in csv.DictReader(file))}


NOT_FIGURES = ("settings", "ci95", "groups", "left_out", "pooled", "conditions")


def records_of(run: str, metrics: Mapping[str, Any]) -> dict[str, float | str]:
    """All numbers of a metrics.json, flat."""
    values: dict[str, float | str] = {f"{run}.images": metrics["images"]}
    base = metrics["detectors"].get("lbp", {}).get("auc_pooled")
    for detector, scores in metrics["detectors"].items():
        own, groups = f"{run}.{detector}", scores.get("groups", {})
        values |= {f"{own}.{key}": value for key, value in _flat(scores)}
        values |= _ends(own, scores["ci95"])
        for group, figures in {**groups, **scores.get("conditions", {})}.items():
            values |= {f"{own}.{key}@{group}": value for key, value in _flat(figures)}
        for key in ("f_mask", "maxf"):
            f_of = {name: each[key] for name, each in groups.items() if each.get(key) is not None}
            if f_of:
                worst = min(f_of, key=lambda name: f_of[name])
                values |= {f"{own}.{key}.worst": f_of[worst], f"{own}.{key}.worst.camera": worst}
                values |= {f"{own}.{key}.iou@{name}": f / (2 - f) for name, f in f_of.items()}
        if base:  # P2's improvement
            values[f"{own}.auc_pooled.over_lbp"] = scores["auc_pooled"] / base - 1
        for key, change in metrics["paired"]["detectors"].get(detector, {}).items():
            values[f"{own}.{key}.less"] = change["difference"]
            values |= _ends(own, {f"{key}.less": change["ci95"]})
    return values


def _flat(figures: Mapping[str, Any], under: str = "") -> Iterator[tuple[str, float]]:
    for key, value in figures.items():
        if isinstance(value, Mapping) and key not in NOT_FIGURES:
            yield from _flat(value, f"{under}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield under + key, value


def _ends(own: str, intervals: Mapping[str, Sequence[float] | None]) -> dict[str, float]:
    known = {key: ends for key, ends in intervals.items() if ends and None not in ends}
    return {
        f"{own}.{key}.{end}": value
        for key, ends in known.items()
        for end, value in zip(("low", "high"), ends, strict=True)
    }


class _Known(dict[str, float | str]):
    """Records by name, and what the code, settings and cards say where they are asked."""

    def __missing__(self, key: str) -> float | str:
        kind, _, place = key.partition(":")
        if kind not in STATED:
            raise KeyError(key)
        place, _, unit = place.partition("/")
        value = STATED[kind](*place.rsplit(":", 1))
        self[key] = value / SIZES[unit] if unit else value
        return self[key]


def _constant(module: str, name: str) -> Any:
    return attrgetter(name)(importlib.import_module(module))


def _setting(detector: str, key: str) -> Any:
    entry = detector_entry(detector)
    return attrgetter(key)(build_settings(entry.settings, entry.values))


def _config(name: str, key: str) -> Any:
    value: Any = read_settings_file(ROOT / "configs" / f"{name}.toml")
    for part in key.split("."):
        value = value[part]
    return value


def _on_card(name: str, words: str) -> float:
    number = re.findall(
        rf"\b([\d,]*\d) {words.replace('_', ' ')}\b", card_of(shipped_weights(name))
    )[0]
    return float(number.replace(",", ""))


STATED = {"code": _constant, "setting": _setting, "config": _config, "card": _on_card}
SIZES = {"GiB": 2**30, "MB": 1e6}


def records() -> _Known:
    """All records that are kept, and what the code itself says."""
    grid = {name.rpartition(":")[2] for name in list_detectors("oneclass:*")}
    values = _Known({"facts.classifiers": len(CLASSIFIERS), "facts.representations": len(grid)})
    for path in sorted(FIGURES.glob("*.json")):
        values.update(json.loads(path.read_text(encoding="utf-8"))["values"])
    return values


# --- documents -----------------------------------------------------------------------------

NUMBER = rf"[+{MINUS}-]?(?:\d{{1,3}}(?:,\d{{3}})+|\d+)?(?:\.\d+|(?<=\d))(?:\s?%)?"
MARK = re.compile(rf"(?P<said>`[^`\n]+`|{NUMBER})<!-- figure: (?P<key>\S[^\n>]*?) -->")
TABLE = re.compile(r"<!-- table: (?P<name>\S+) -->\n.*?<!-- end -->", re.S)


def rewritten(text: str, known: Records) -> str:
    """A document with every figure and table as its records have it; KeyError for a name of none.

    A figure that agrees with its record stays as it is written.
    """

    def figure(match: re.Match[str]) -> str:
        now = restated(match["said"], known[match["key"]])
        return match[0] if now == match["said"] else f"{now}<!-- figure: {match['key']} -->"

    def table(match: re.Match[str]) -> str:
        return f"<!-- table: {match['name']} -->\n{TABLES[match['name']](known)}<!-- end -->"

    return MARK.sub(figure, TABLE.sub(table, text))


def documents() -> Iterator[Path]:
    """README and every page of docs."""
    yield ROOT / "README.md"
    yield from sorted((ROOT / "docs").rglob("*.md"))


class _Asked(dict[str, float | str]):
    """Records that are all there, and remember who asked."""

    def __missing__(self, key: str) -> float | str:
        return self.setdefault(key, 0.0)

    def __contains__(self, key: object) -> bool:
        self.setdefault(str(key), 0.0)
        return True


def used() -> set[str]:
    """The records that documents and their tables name."""
    asked = _Asked()
    for path in documents():
        rewritten(path.read_text(encoding="utf-8"), asked)
    return set(asked)


def stale() -> Iterator[tuple[Path, str, str]]:
    """Documents that are not as their records have them: before and after."""
    known = records()
    for path in documents():
        before = path.read_text(encoding="utf-8")
        after = rewritten(before, known)
        if after != before:
            yield path, before, after


def loose() -> Iterator[tuple[Path, list[str]]]:
    """Documents with numbers that neither a record nor a study stands behind."""
    for path in documents():
        if numbers := unbound(path.read_text(encoding="utf-8")):
            yield path, numbers


def main(words: Sequence[str] | None = None) -> int:
    """Do what is asked; 1 where ``check`` finds a stale or a loose figure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("task", choices=("evaluate", "write", "check"))
    parser.add_argument("data", type=Path, nargs="?", help="for evaluate")
    parser.add_argument("--out", type=Path, default=Path("out/figures"), help="of the evaluations")
    parser.add_argument("--only", nargs="*", choices=RUNS, default=["many", "camvid", "idd"])
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args(words)
    if options.task == "evaluate":
        if options.data is None:
            parser.error("evaluate DATA: give the folder of the data")
        evaluate(options.data.resolve(), options.out.resolve(), options.only, options.jobs)
    changed = list(stale())
    for path, before, after in changed:
        lines = difflib.unified_diff(
            before.splitlines(), after.splitlines(), str(path), lineterm=""
        )
        print("\n".join(lines))
        if options.task != "check":
            path.write_text(after, encoding="utf-8")
    bare = list(loose())
    for path, numbers in bare:
        print(f"{path}: of no record and no study: {', '.join(numbers)}")
    return 1 if options.task == "check" and (changed or bare) else 0


if __name__ == "__main__":
    sys.exit(main())
