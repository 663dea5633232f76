"""The figures of README and docs: written from records of evaluations, and held against them.

    python scripts/readme_figures.py evaluate DATA   # score, keep the records, write the documents
    python scripts/readme_figures.py write           # documents as docs/figures have them
    python scripts/readme_figures.py check           # is every number bound, and as recorded?

docs/figures/RUN.json is {"command": …, "commit": of the package, "weights": digests, "values":
{name: value}}. DATA holds many/, camvid/ and idd_lite/; ``evaluate`` runs the commands anew and
keeps what documents use, in about ten minutes on two quiet cores; --only RUN… does some of it.
Names are RUN.DETECTOR.MEASURE, with ``.low`` and ``.high`` its interval, ``@GROUP`` one camera,
drive or condition, ``.worst`` and ``.worst.camera`` the lowest of the groups, ``.less`` the
difference to ``fusion``, ``.iou`` that of an F. Code and files state records, too:
``code:MODULE:NAME``, ``setting:DETECTOR:KEY``, ``config:NAME:KEY`` of configs/NAME.toml,
``model:DETECTOR:KEY`` as ``describe_networks``; ``/GiB`` behind one divides.

A figure is bound to a record by a comment right after it, and keeps as many digits as it has::

    F of the mask is .827<!-- figure: many.fusion.f_mask --> on average
    the worst camera is `dn_tas500`<!-- figure: many.fusion.f_mask.worst.camera -->

A table is written whole. Its comment has the cells behind the first one, with ``[[RECORD|STYLE]]``
for a record in the style of a figure (".000" where none is given; "ci": with its interval; a dash
where a record with "?" does not exist), and the record by which rows are sorted::

    <!-- table by many.{row}.maxf: [[many.{row}.maxf|ci]] | [[many.{row}.images|0]] -->

{row} is the code in a row's first cell, or else its text, or what a comment there names
(<!-- row: NAME -->); an "@" in it begins {at}.

Every other number that was measured (with a fraction, in percent, or of a unit) has to be of a
study: of a paragraph that names the commit and the date, "F rose by .031 (at 3f5c3f1, 2026-10-30)",
or of a page or section for which docs/studies.json does, by its heading.
"""

import difflib
import importlib
import json
import re
import shlex
import subprocess
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the package beside

from roadtorch.base.settings import build_settings, read_settings_file
from roadtorch.detectors.catalogue import detector_entry, list_detectors, load_detector
from roadtorch.layout.weights import SHIPPED, LayoutNetwork, hash_tensors, load_network
from roadtorch.oneclass import CLASSIFIERS

ROOT = Path(__file__).resolve().parents[1]
FIGURES = ROOT / "docs" / "figures"
RUNS = tuple(sorted(path.stem for path in FIGURES.glob("*.json")))
TIMES = ("bench", "commands", "ros", "runtimes")  # of any weights of these networks
Records = Mapping[str, float | str]

# --- records ------------------------------------------------------------------------------


def evaluate(data: Path, out: Path, runs: Sequence[str], jobs: int) -> None:
    """Run evaluations and keep their records; CalledProcessError where a command fails."""
    for run in runs:
        command = json.loads((FIGURES / f"{run}.json").read_text(encoding="utf-8"))["command"]
        for line in command.split(" && "):
            words = shlex.split(line.replace("DATA", str(data)).replace("OUT", str(out)))
            program = ["-m", "roadtorch"] if words[0] == "roadtorch" else []
            words += ["--jobs", str(jobs)] * (words[1] == "evaluate")
            process = [sys.executable, *program, *words[1:]]
            subprocess.run(process, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
        if (metrics := out / run / "metrics.json").is_file():  # others keep theirs
            scores = json.loads(metrics.read_text(encoding="utf-8"))
            keep_records(run, command, records_of(run, scores))


def keep_records(run: str, command: str, values: Records) -> None:
    """Write the records that documents use, beside the commit of the package and its weights.

    CalledProcessError where the package differs from that commit.
    """
    subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "roadtorch"], check=True, cwd=ROOT)
    log = ["git", "log", "-1", "--format=%h", "--abbrev=7", "--", "roadtorch"]
    commit = subprocess.run(log, check=True, cwd=ROOT, capture_output=True, text=True).stdout
    values = {key: values[key] for key in sorted(used() & values.keys())}
    weights = weights_of(run, " ".join((command, *values)))
    record = {"command": command, "commit": commit.strip(), "weights": weights, "values": values}
    (FIGURES / f"{run}.json").write_text(f"{json.dumps(record, indent=0)}\n", encoding="utf-8")


def weights_of(run: str, text: str) -> dict[str, str]:
    """Return digests of the weights of the detectors that a text names, or else of ``fusion``."""
    names = set(list_detectors()) & set(re.split(r"[ .=]|:torch|:onnxruntime", text))
    digest = count_weights if run in TIMES else digest_weights
    digests = {name: digest(name) for name in sorted(names) or ["fusion"]}
    return {name: digest for name, digest in digests.items() if digest}


@cache
def digest_weights(detector: str) -> str:
    """Return eight hexadecimal digits of a detector's weights; "" without any."""
    state = load_detector(detector).state_dict()
    return hash_tensors(state)[:8] if state else ""


def records_of(run: str, metrics: Mapping[str, Any]) -> dict[str, float | str]:
    """Flatten the numbers of a metrics.json."""
    values: dict[str, float | str] = {f"{run}.images": metrics["images"]}
    for detector, scores in metrics["detectors"].items():
        prefix, groups = f"{run}.{detector}", scores.get("groups", {})
        values |= {f"{prefix}.{key}": value for key, value in flatten(scores)}
        values |= intervals_of(prefix, scores["ci95"])
        for group, figures in {**groups, **scores.get("conditions", {})}.items():
            values |= {f"{prefix}.{key}@{group}": value for key, value in flatten(figures)}
        for key in ("f_mask", "maxf"):
            f_of = {name: f[key] for name, f in groups.items() if f.get(key) is not None}
            if f_of:
                worst = min(f_of, key=lambda name: f_of[name])
                values |= {f"{prefix}.{key}.worst": f_of[worst]}
                values |= {f"{prefix}.{key}.worst.camera": worst}
                values |= {f"{prefix}.{key}.iou@{name}": f / (2 - f) for name, f in f_of.items()}
        for key, change in metrics["paired"]["detectors"].get(detector, {}).items():
            values[f"{prefix}.{key}.less"] = change["difference"]
            values |= intervals_of(prefix, {f"{key}.less": change["ci95"]})
    return values


NOT_FIGURES = ("settings", "ci95", "groups", "left_out", "pooled", "conditions")


def flatten(figures: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of nested figures by their keys, joined by dots."""
    for key, value in figures.items():
        if isinstance(value, Mapping) and key not in NOT_FIGURES:
            yield from flatten(value, f"{prefix}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield prefix + key, value


def intervals_of(prefix: str, intervals: Mapping[str, Sequence[float] | None]) -> dict[str, float]:
    """Return the ends of confidence intervals."""
    return {
        f"{prefix}.{key}.{end}": value
        for key, ends in intervals.items()
        if ends and None not in ends
        for end, value in zip(("low", "high"), ends, strict=True)
    }


class RecordsAndCode(dict[str, float | str]):
    """Records by name, and what code and settings state when it is asked for."""

    def __missing__(self, key: str) -> float | str:
        kind, _, place = key.partition(":")
        if kind not in STATED:
            raise KeyError(key)
        place, _, unit = place.partition("/")
        value = STATED[kind](*place.rsplit(":", 1))
        self[key] = value / SIZES[unit] if unit else value
        return self[key]


def setting_of(detector: str, key: str) -> Any:
    """Return a setting of a detector."""
    entry = detector_entry(detector)
    return attrgetter(key)(build_settings(entry.settings, entry.defaults))


def config_value(name: str, key: str) -> Any:
    """Return a value of a shipped config."""
    value: Any = read_settings_file(ROOT / "configs" / f"{name}.toml")
    for part in key.split("."):
        value = value[part]
    return value


@cache
def describe_networks(detector: str) -> dict[str, float | str]:
    """Return weights, parameters, bytes on disk and input (rows × columns) of the networks."""
    parts = [part for part in load_detector(detector).modules() if isinstance(part, LayoutNetwork)]
    files = {hash_tensors(load_network(path).state_dict()): path for path in SHIPPED.glob("*.s*")}
    paths = [files[hash_tensors(part.state_dict())] for part in parts]
    shapes = [part.settings.model_dump() for part in parts]
    sizes = {
        "{height}×{width}".format(**shape)
        if "height" in shape
        else "{patch}×{patch}".format(**shape["topology"])
        for shape in shapes
    }
    return {
        "weights": ", ".join(path.stem for path in paths) or "none",
        "parameters": sum(weight.numel() for part in parts for weight in part.parameters()),
        "bytes": sum(path.stat().st_size for path in paths),
        "input": " ".join(sorted(sizes)) or "none",
    }


def count_weights(detector: str) -> str:
    """Return the number of a detector's weights; "" without any."""
    return str(describe_networks(detector)["parameters"] or "")


STATED = {
    "model": lambda detector, key: describe_networks(detector)[key],
    "code": lambda module, name: attrgetter(name)(importlib.import_module(module)),
    "setting": setting_of,
    "config": config_value,
}
SIZES = {"GiB": 2**30, "MB": 10**6}


def records() -> RecordsAndCode:
    """Return all records that are kept, and what the code itself states."""
    grid = {name.rpartition(":")[2] for name in list_detectors("oneclass:*")}
    facts = {"facts.classifiers": len(CLASSIFIERS), "facts.representations": len(grid)}
    values = RecordsAndCode(facts)
    for run in RUNS:
        values.update(json.loads((FIGURES / f"{run}.json").read_text(encoding="utf-8"))["values"])
    return values


# --- figures and tables -------------------------------------------------------------------

MINUS = "\N{MINUS SIGN}"
NUMBER = rf"[+{MINUS}-]?(?:\d{{1,3}}(?:,\d{{3}})+|\d+)?(?:\.\d+|(?<=\d))(?:\s?%)?"
MARK = re.compile(rf"(?P<text>`[^`\n]+`|{NUMBER})<!-- figure: (?P<key>\S[^\n>]*?) -->")
TABLE = re.compile(
    r"(?P<comment><!-- table(?: by (?P<order>\S+))?:\s(?P<cells>.*?)\s-->\n)"
    r"(?P<header>[^\n]*\n[^\n]*\n)(?P<rows>.*?)<!-- end -->",
    re.S,
)


def rewrite(text: str, values: Records) -> str:
    """Return a document with every figure and table as its records have it.

    KeyError for a name without a record. A figure that agrees with its record stays as it is.
    """

    def figure(match: re.Match[str]) -> str:
        return f"{restate(match['text'], values[match['key']])}<!-- figure: {match['key']} -->"

    def table(match: re.Match[str]) -> str:
        first_cells = [row.removeprefix("| ").split(" | ")[0] for row in match["rows"].splitlines()]
        if order := match["order"]:
            first_cells.sort(key=lambda cell: -float(values[with_row(order, cell)]))
        rows = [
            f"| {cell} | {table_cells(with_row(match['cells'], cell), values)} |\n"
            for cell in first_cells
        ]
        return f"{match['comment']}{match['header']}{''.join(rows)}<!-- end -->"

    return MARK.sub(figure, TABLE.sub(table, text))


def with_row(template: str, cell: str) -> str:
    """Fill the row that a first cell names into a template."""
    named = re.search(r"<!-- row: (\S*?) ?-->", cell) or re.search(r"`([^`]+)`", cell)
    row, at, group = (named[1] if named else cell).partition("@")
    filled = template.replace("{row}", row).replace("{at}", at + group)
    return re.sub(r"@(?=[]|])", "", " ".join(filled.split()))


def table_cells(cells: str, values: Records) -> str:
    """Fill records into the cells of a row."""

    def cell(match: re.Match[str]) -> str:
        key, _, style = match[1].removeprefix("?").partition("|")
        if match[1].startswith("?") and key not in values:
            return "–"
        if style != "ci":
            return restate(style or ".000", values[key])
        ends = (restate(".000", values[name]) for name in (key, f"{key}.low", f"{key}.high"))
        return "{} ({}–{})".format(*ends)

    return re.sub(r"\[\[(.+?)\]\]", cell, cells)


def restate(figure: str, value: float | str) -> str:
    """Write a value in the form of an old figure: its digits, its sign, its percent.

    ".827" and .8312 → ".831"; "1,318" and 55 → "55"; "470,000" and 474,373 → "474,000"; "18 %"
    and .2 → "20 %"; "`a`" and "b" → "`b`". A minus is a true one.
    """
    if figure.startswith("`"):
        return f"`{value}`"
    percent = re.search(r"\s?%$", figure)
    digits = figure.removesuffix(percent[0] if percent else "")
    places = len(digits.partition(".")[2])
    if not places and (zeros := len(digits) - len(digits.rstrip("0,"))) >= 3:
        places = -3 * (zeros // 4) if "," in digits else -zeros
    number = round(float(value) * (100 if percent else 1), places)
    text = f"{abs(number):{',' if ',' in figure else ''}.{max(places, 0)}f}"
    if places > 0 and re.match(rf"[+{MINUS}-]?\.", figure):
        text = text.removeprefix("0")
    signed = figure[0] in f"+-{MINUS}"
    sign = MINUS if number < 0 else "+" if signed else ""
    return sign + text + (percent[0] if percent else "")


# --- numbers ------------------------------------------------------------------------------

STUDY = re.compile(r"\bat (?P<commit>[0-9a-f]{7}), (?P<date>\d{4}-\d\d-\d\d)\b")
STUDIES = json.loads((ROOT / "docs" / "studies.json").read_text(encoding="utf-8"))

HIDDEN = (
    TABLE.pattern,
    r"^( *)(`{3,}).*?^\1\2 *$",  # code
    r"\$\$.*?\$\$|\$[^$\n]+\$",  # formulas
    r"(?:`[^`\n]+`|[^\s(`|]+(?:\s%)?)<!-- figure: [^\n>]*? -->",  # bound
    r"<!--.*?-->",
    r"`[^`\n]*`",
    r"\]\([^)\s]*\)|https?://\S+",  # addresses
    r"\b(?:arXiv|Python|torch|ROS|License|BY|BY-NC-SA|Fig\.|Figs\.|Table|eq\.|§) ?[\d.]*\d"
    r"(?:(?:,| or| to) [\d.]+\d)*",  # names
    r"\b95 %",  # the level of every interval
)
"""What holds no numbers of the page's own, in this order."""

UNITS = (
    *("ms", "s", "seconds?", "minutes?", "hours?", "[KMG]i?B", "bytes", "Hz", "fps"),
    *("cm", "m", "degrees", "times", "pixels", "images", "frames", "worlds", "weights"),
    r"(?:(?:real|rendered|free) )?(?:images|streets)",
)
MEASURED = re.compile(
    r"(?<![\w.,/-])"
    r"(?:[+\N{MINUS SIGN}×]?\d*\.\d+(?![\w.]*\d)|\d[\d,]* ?%"
    rf"|\d[\d,]*\s(?:{'|'.join(UNITS)})\b)"
)

HEADING = re.compile(r"^#{1,6} .*$", re.M)


def unbound_numbers(page: str, studies: Sequence[str] = ()) -> list[str]:
    """List the numbers of a page that no record and no study (a heading of it) stands behind."""
    headings = re.findall(HEADING.pattern, re.sub(HIDDEN[1], "", page, flags=re.M | re.S), re.M)
    if headings and headings[0].lstrip("# ") in studies:
        return []
    for heading in headings:
        if heading.lstrip("# ") in studies:
            page = re.sub(rf"^{re.escape(heading)}$.*?(?=^#|\Z)", "", page, flags=re.M | re.S)
    for pattern in HIDDEN:
        page = re.sub(pattern, " ", page, flags=re.M | re.S)
    return [
        number[0]
        for paragraph in re.split(r"\n\s*\n|^\s*[-*] ", page, flags=re.M)
        if not STUDY.search(paragraph)
        for number in MEASURED.finditer(paragraph)
    ]


# --- documents ----------------------------------------------------------------------------


def documents() -> Iterator[Path]:
    """Yield README and every page of docs."""
    yield ROOT / "README.md"
    yield from sorted((ROOT / "docs").rglob("*.md"))


class UsedNames(dict[str, float | str]):
    """Records that exist for every name, and remember the names used."""

    def __missing__(self, key: str) -> float | str:
        return self.setdefault(key, 0.0)

    def __contains__(self, key: object) -> bool:
        self.setdefault(str(key), 0.0)
        return True


def used() -> set[str]:
    """Return the records that documents and their tables name."""
    names = UsedNames()
    for path in documents():
        rewrite(path.read_text(encoding="utf-8"), names)
    return set(names)


def main(words: Sequence[str] | None = None) -> int:
    """Run a task; return 1 if ``check`` finds a stale figure or an unrecorded number."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
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
    values, errors = records(), 0
    for path in documents():
        old = path.read_text(encoding="utf-8")
        new = rewrite(old, values)
        lines = old.splitlines(), new.splitlines()
        for line in difflib.unified_diff(*lines, str(path), lineterm=""):
            print(line)
        if options.task != "check" and new != old:
            path.write_text(new, encoding="utf-8")
        if numbers := unbound_numbers(new, STUDIES.get(path.relative_to(ROOT).as_posix(), ())):
            print(f"{path}: of no record and no study: {', '.join(numbers)}")
        errors += bool(numbers) + (new != old)
    return 1 if options.task == "check" and errors else 0


if __name__ == "__main__":
    sys.exit(main())
