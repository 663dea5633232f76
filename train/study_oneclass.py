"""P3's Table III on other pictures: every one-class classifier on every representation.

One picture after another: planes and superpixels are made once, each classifier is fitted to
the training area, and the exact AUC of its distances goes into a row of ``aucs.jsonl``. A run
that was broken off goes on where it stopped. The table is the mean over drives of the mean
AUC of their pictures, with P3's value beside it and the best of each column in bold.

    python train/study_oneclass.py ../shared/data/camvid --every 40 --out study
    python train/study_oneclass.py ../shared/data/camvid --every 40 --out study-linear --hue linear

Writes table.txt (printed as well), table.csv and table.html. P3's values are read from a CSV
of classifier, representation, auc in percent.
"""

import argparse
import csv
import html
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import fmean

import numpy as np
import torch
from scipy.stats import rankdata
from torch import Tensor
from tqdm import tqdm

from roadtorch.color import REPRESENTATIONS
from roadtorch.evaluation.datasets import Dataset, Item, Truth, open_dataset
from roadtorch.evaluation.metrics import RoadCounts, auc
from roadtorch.families.oneclass import OneClassSettings, settings_of
from roadtorch.oneclass import CLASSIFIERS, axes_of, fit
from roadtorch.oneclass.samples import representation, road_samples
from roadtorch.settings import build_settings
from roadtorch.sharing import sharing
from roadtorch.working import at_work, restored

PAPER = Path(__file__).resolve().parents[2] / "shared" / "reference" / "oneclass_table3.csv"
SINGLE = tuple(name for name, planes in REPRESENTATIONS.items() if len(planes) == 1)
COMBINED = tuple(name for name in REPRESENTATIONS if name not in SINGLE)
HALVES = {"single planes": SINGLE, "combinations": COMBINED}

Table = Mapping[tuple[str, str], float]
"""AUC in percent by classifier and representation."""


# --- measuring --------------------------------------------------------------------------


def exact_auc(distance: Tensor, index: Tensor, truth: Truth) -> float:
    """AUC of a picture from the distance (k,) of its values and where each occurs (H,W).

    Equal distances count one half; no rounding to levels. NaN where a class is missing.
    """
    levels, rank = (-distance).unique(return_inverse=True)

    def pixels(where: Tensor) -> Tensor:
        return torch.bincount(rank[index[where]], minlength=len(levels))

    road = truth.road & truth.valid
    return 100 * float(auc(RoadCounts(pixels(road), pixels(truth.valid & ~truth.road))))


def measure(
    image: Tensor, truth: Truth, choices: Mapping[str, OneClassSettings]
) -> dict[str, float]:
    """AUC in percent of every cell that makes sense, by ``classifier:representation``."""
    found = {}
    with sharing():
        for name, settings in choices.items():
            classifier = CLASSIFIERS[name]
            small = at_work(image, settings.working)
            height, width = small.shape[-2:]
            parts = (restored(part, (height, width)) for part in (truth.road, truth.valid))
            seen = Truth(*parts)
            for planes, names in REPRESENTATIONS.items():
                if classifier.refuses(len(names)):
                    continue
                samples = road_samples(small, names, settings.samples)
                generator = torch.Generator().manual_seed(settings.random)
                fitted = fit(classifier, samples, axes_of(names), settings.classifier, generator)
                values, index = representation(small, names)
                found[f"{name}:{planes}"] = exact_auc(fitted.distance(values.T), index, seen)
    return found


def chosen_settings(hue: str, reduction: str | None) -> dict[str, OneClassSettings]:
    """The settings of every classifier by name: its defaults but for these two."""
    values = {"classifier": {"hue": hue}, "samples": {"reduction": reduction} if reduction else {}}
    return {name: build_settings(settings_of(kind), values) for name, kind in CLASSIFIERS.items()}


def study(
    dataset: Dataset, items: list[Item], choices: Mapping[str, OneClassSettings], path: Path
) -> None:
    """Measure the items that ``path`` does not hold yet, and add a line for each."""
    done = {row["name"] for row in rows_of(path)}
    with path.open("a", encoding="utf-8") as file:
        for item in tqdm([item for item in items if item.name not in done], unit="picture"):
            image, truth = dataset.read(item)
            row = {"name": item.name, "group": item.group, "auc": measure(image, truth, choices)}
            file.write(json.dumps(row) + "\n")
            file.flush()


def rows_of(path: Path) -> list[dict]:
    """The rows measured so far; a last line that was cut short is left out."""
    if not path.exists():
        return []
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    if lines and not lines[-1].endswith("\n"):
        path.write_text("".join(lines[:-1]), encoding="utf-8")
        lines = lines[:-1]
    return [json.loads(line) for line in lines]


def mean_table(rows: list[dict]) -> dict[tuple[str, str], float]:
    """The mean over drives of the mean AUC of their pictures."""
    drives: dict[str, list[dict]] = {}
    for row in rows:
        drives.setdefault(str(row["group"]), []).append(row["auc"])
    table = {}
    for cell in rows[0]["auc"]:
        means = [
            [values[cell] for values in pictures if not math.isnan(values[cell])]
            for pictures in drives.values()
        ]
        classifier, planes = cell.split(":")
        table[classifier, planes] = fmean(fmean(values) for values in means if values)
    return table


# --- telling ----------------------------------------------------------------------------


def read_paper(path: Path) -> dict[tuple[str, str], float]:
    """P3's Table III; empty cells are left out."""
    with path.open(encoding="utf-8", newline="") as file:
        return {
            (row["classifier"], row["representation"]): float(row["auc"])
            for row in csv.DictReader(file)
            if row["auc"]
        }


def best_cells(table: Table, columns: tuple[str, ...]) -> set[tuple[str, str]]:
    """The best classifier of each column, to one decimal; all that share it."""
    best = set()
    for planes in columns:
        cells = {key: round(value, 1) for key, value in table.items() if key[1] == planes}
        best |= {key for key, value in cells.items() if value == max(cells.values())}
    return best


def rank_correlations(ours: Table, paper: Table) -> Iterator[tuple[str, int, float]]:
    """Spearman's coefficient over cells: all, each half, and the means of columns and rows."""
    both = [key for key in ours if key in paper]
    parts = {"all cells": both}
    parts |= {name: [key for key in both if key[1] in HALVES[name]] for name in HALVES}
    for name, keys in parts.items():
        yield name, len(keys), _spearman([(ours[key], paper[key]) for key in keys])
    for half, columns in HALVES.items():
        for name, place, labels in (("columns", 1, columns), ("rows", 0, tuple(CLASSIFIERS))):
            pairs = []
            for label in labels:
                keys = [key for key in both if key[place] == label and key[1] in columns]
                if keys:
                    pairs.append(
                        (fmean(ours[key] for key in keys), fmean(paper[key] for key in keys))
                    )
            yield f"means of {name}, {half}", len(pairs), _spearman(pairs)


def _spearman(pairs: list[tuple[float, float]]) -> float:
    ranks = [rankdata(values) for values in zip(*pairs, strict=True)]
    return float(np.corrcoef(ranks)[0, 1])


def text_table(ours: Table, paper: Table, columns: tuple[str, ...]) -> str:
    """``ours/paper`` in each cell, the best of a column between stars."""
    best = best_cells(ours, columns)
    lines = ["classifier".ljust(17) + "".join(name.center(14) for name in columns)]
    for name in CLASSIFIERS:
        cells = (_cell(ours, paper, (name, planes)) for planes in columns)
        starred = (
            f"*{text}*" if (name, planes) in best else text
            for planes, text in zip(columns, cells, strict=True)
        )
        lines.append(name.ljust(17) + "".join(text.center(14) for text in starred))
    return "\n".join(line.rstrip() for line in lines)


def _cell(ours: Table, paper: Table, key: tuple[str, str]) -> str:
    parts = (f"{table[key]:.1f}" if key in table else "-" for table in (ours, paper))
    return "/".join(parts)


def html_table(ours: Table, paper: Table, columns: tuple[str, ...]) -> str:
    """The same with the best in bold and P3's value in small print."""
    best = best_cells(ours, columns)
    rows = ["<tr><th>" + "".join(f"<th>{html.escape(name)}" for name in columns)]
    for name in CLASSIFIERS:
        cells = []
        for planes in columns:
            mine, theirs = _cell(ours, paper, (name, planes)).split("/")
            mine = f"<b>{mine}</b>" if (name, planes) in best else mine
            cells.append(f"<td>{mine} <small>{theirs}</small>")
        rows.append(f"<tr><th>{html.escape(name)}" + "".join(cells))
    return "<table>\n" + "\n".join(rows) + "\n</table>"


def tell(ours: Table, paper: Table, heading: str, out: Path) -> str:
    """Write the three files and return the text."""
    correlations = list(rank_correlations(ours, paper)) if paper else []
    told = [f"  {name} ({count}): {value:+.2f}" for name, count, value in correlations]
    parts = [heading, "ours/P3, AUC in percent; * best of the column"]
    parts += [f"{name}\n{text_table(ours, paper, columns)}" for name, columns in HALVES.items()]
    parts += ["Spearman's rank correlation with P3:\n" + "\n".join(told)] if told else []
    text = "\n\n".join(parts) + "\n"
    (out / "table.txt").write_text(text, encoding="utf-8")
    with (out / "table.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["classifier", "representation", "auc", "paper"])
        for key, value in ours.items():
            writer.writerow([*key, f"{value:.2f}", paper.get(key, "")])
    page = ["<!doctype html><meta charset=utf-8><title>One-class classifiers</title>"]
    page += [f"<p>{html.escape(heading)}. AUC in percent, P3's in small print."]
    page += [f"<h2>{name}</h2>{html_table(ours, paper, part)}" for name, part in HALVES.items()]
    page += ["<p>Spearman's rank correlation with P3:<ul>" if told else ""]
    page += [f"<li>{html.escape(line)}" for line in told]
    (out / "table.html").write_text("\n".join(page) + "\n", encoding="utf-8")
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("root", type=Path, help="folder of the data set")
    parser.add_argument("--dataset", default="camvid", help="kind of data set")
    parser.add_argument("--split", default=None, help="split; the data set's own default")
    parser.add_argument("--every", type=int, default=1, help="take every how many-th picture")
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--hue", default="unrolled", choices=("unrolled", "linear", "chord"))
    parser.add_argument("--reduction", choices=("superpixels", "grid", "none"), default=None)
    parser.add_argument("--paper", type=Path, default=PAPER, help="CSV of P3's Table III")
    options = parser.parse_args()
    dataset = open_dataset(options.dataset, options.root, options.split)
    options.out.mkdir(parents=True, exist_ok=True)
    rows = options.out / "aucs.jsonl"
    choices = chosen_settings(options.hue, options.reduction)
    study(dataset, list(dataset.items[:: options.every]), choices, rows)
    measured = rows_of(rows)
    paper = read_paper(options.paper) if options.paper.exists() else {}
    heading = f"{options.dataset} {dataset.split}: {len(measured)} pictures, hue {options.hue}"
    print(tell(mean_table(measured), paper, heading, options.out))


if __name__ == "__main__":
    main()
