"""Score the students of ``train/claim.py`` and their teachers.

    python -m train.claim_scores score DATA --out RUNS       # resumable; an hour on one core
    python -m train.claim_scores tables --out RUNS --write DOCS/research

DATA is the folder that holds camvid/, idd_lite/ and many/. Layout is scored by the mean class
recall of the strongest potentials, void ignored, where a set has sky and vertical labels; road by
the area under the ROC curve of the ground's potential. Groups (the drives of CamVid, the cameras of
many) count the same. The intervals are of 95 % over images, drawn within their group, and seeds.
"""

import argparse
import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset
from roadtorch.evaluation import metrics
from roadtorch.evaluation.evaluate import tally_images
from roadtorch.evaluation.methods import Contender, contender_from_name
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.tally import Tally, pool
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    REPLICATES,
    percentile_interval,
    sample_weights,
    student_weights,
)
from scripts.figures.p2_layout import PRINTED_ORDER
from train.calibrate import EXCLUDED
from train.claim import CONFIGS, RUNS, SEEDS, TEACHERS, run_name

SETS = {"idd": "IDD", "camvid": "CamVid", "many": "many"}
TEACHER_DETECTORS = {"untuned": "labeller:untuned", "tuned": "labeller"}
TEXTURE, ROWS = "cpf", "prior:rows"


def open_sets(data: Path) -> dict[str, Dataset]:
    """Open the sets that students are scored on."""
    return {
        "idd": open_dataset("idd-lite", data / "idd_lite"),
        "camvid": open_dataset("camvid", data / "camvid"),
        "many": open_dataset("folder", data / "many"),
    }


# --- scores of images ---------------------------------------------------------------------


def contenders(out: Path) -> dict[str, Contender]:
    """Return teachers, students, and their products with the texture, by name."""
    entries = {name: contender_from_name(name, {}) for name in TEACHER_DETECTORS.values()}
    entries |= {name: contender_from_name(name, {}) for name in (TEXTURE, ROWS)}
    for run in RUNS:
        weights = out / run_name(*run) / "weights.safetensors"
        if weights.exists():
            settings = {"weights": {"file": str(weights)}}
            entries[run_name(*run)] = contender_from_name("layout:cnn-7", settings)
            entries[product_name(*run)] = contender_from_name("fusion:paper", settings)
    return {name: replace(entry, name=name) for name, entry in entries.items()}


def product_name(teacher: str, config: str, seed: int) -> str:
    """Return the name of a student's product with the texture."""
    return f"{run_name(teacher, config, seed)} × {TEXTURE}"


def score(data: Path, out: Path) -> None:
    """Score every contender that has no file of scores yet."""
    folder = out / "scores"
    folder.mkdir(exist_ok=True)
    for name, dataset in open_sets(data).items():
        entries = [
            entry
            for key, entry in contenders(out).items()
            if not (folder / f"{name} {key}").exists()
        ]
        if not entries:
            continue
        print(f"{name}: {len(entries)} contenders, {len(dataset.items)} images", flush=True)
        tallies, failures = tally_images(dataset, entries, 1, quiet=False)
        for failure in failures:
            raise RuntimeError(f"{failure.image}: {failure.reason}")
        for entry in entries:
            torch.save(tallies[entry.name], folder / f"{name} {entry.name}")


# --- measures -----------------------------------------------------------------------------


class Scores(NamedTuple):
    """Measures of replicates, float64 (replicates + 1,) each; the first is of the images as are."""

    recall: Tensor
    auc: Tensor
    pooled_auc: Tensor


def measure(tally: Tally) -> Scores:
    """Compute the measures of a contender for every replicate; all contenders have the same."""
    generator = torch.Generator().manual_seed(BOOTSTRAP_SEED)
    recalls, roads = [], []
    for group in sorted(tally.road.keys() - set(EXCLUDED)):
        table = tally.table([group])
        weights = sample_weights(table.groups, generator)
        part = pool(table, {}, weights)
        roads.append(part.road)
        if part.layout is not None and bool(part.layout[0, 0].any()):
            recalls.append(metrics.mean_class_recall(part.layout))
    undefined = torch.full((REPLICATES + 1,), torch.nan, dtype=torch.float64)
    areas = torch.stack([metrics.auc(road) for road in roads])
    pooled = reduce(RoadCounts.__add__, roads)
    recall = torch.stack(recalls or [undefined]).mean(0)
    return Scores(recall, areas.mean(0), metrics.auc(pooled))


def mean_of_seeds(values: Sequence[Tensor]) -> Tensor:
    """Return the mean of the seeds' scores (replicates + 1,), their replicates of Student's t."""
    weights = student_weights(len(values), torch.Generator().manual_seed(BOOTSTRAP_SEED + 1))
    weights = torch.cat([torch.ones_like(weights[:1]), weights])
    return (weights * torch.stack(list(values), 1)).mean(1)


def difference_columns(title: str, values: Tensor) -> dict[str, str]:
    """Format a difference (replicates + 1,) and its 95 % interval."""
    low, high = percentile_interval(values[1:])
    return {title: f"{values[0]:+.3f}", f"{title}, 95 %": f"{low:+.3f} to {high:+.3f}"}


# --- tables -------------------------------------------------------------------------------


def write_tables(out: Path, folder: Path) -> None:
    """Write claim.csv, claim_fusion.csv (products with the texture) and claim_confusion.csv."""
    tallies: dict[str, dict[str, Tally]] = {name: {} for name in SETS}
    for file in sorted((out / "scores").iterdir()):
        name, _, contender = file.name.partition(" ")
        tallies[name][contender] = torch.load(file, weights_only=False)
    scores = {
        name: {contender: measure(tally) for contender, tally in part.items()}
        for name, part in tallies.items()
    }
    studies = [(teacher, config) for config in CONFIGS for teacher in TEACHERS]
    studies = [s for s in studies if run_name(*s, SEEDS[-1]) in scores["many"]]
    write_csv(folder / "claim.csv", [row for s in studies for row in claim_rows(out, scores, *s)])
    rows = [row for s in studies for row in fusion_rows(scores, *s)]
    write_csv(folder / "claim_fusion.csv", rows)
    rows = [row for s in studies for row in confusion_rows(tallies["camvid"], *s)]
    write_csv(folder / "claim_confusion.csv", rows)


def claim_rows(
    out: Path, scores: Mapping[str, Mapping[str, Scores]], teacher: str, config: str
) -> Iterator[dict[str, str]]:
    """Yield the scores of a teacher and its students, by set and measure."""
    runs = [run_name(teacher, config, seed) for seed in SEEDS]
    epochs = [len((out / run / "log.csv").read_text().splitlines()) - 1 for run in runs]
    for name, title in SETS.items():
        for key in ("recall", "auc"):
            students = [getattr(scores[name][run], key) for run in runs]
            first = torch.stack([values[0] for values in students])
            reference = getattr(scores[name][TEACHER_DETECTORS[teacher]], key)
            yield {
                "teacher": teacher,
                "training": config,
                "set": title,
                "measure": key,
                "of the teacher": f"{reference[0]:.3f}",
                "mean of 5 students": f"{first.mean():.3f}",
                "sd": f"{first.std():.3f}",
                **difference_columns("difference", mean_of_seeds(students) - reference),
                "epochs": " ".join(map(str, epochs)),
            }


def fusion_rows(
    scores: Mapping[str, Mapping[str, Scores]], teacher: str, config: str
) -> Iterator[dict[str, str]]:
    """Yield the AUC of texture, layout and their product, and what layout adds, by set."""
    for name, title in SETS.items():
        for key, average in (("auc", "by groups"), ("pooled_auc", "pooled")):
            areas = {contender: getattr(part, key) for contender, part in scores[name].items()}
            layout = mean_of_seeds([areas[run_name(teacher, config, seed)] for seed in SEEDS])
            products = [areas[product_name(teacher, config, seed)] for seed in SEEDS]
            product = mean_of_seeds(products)
            yield {
                "teacher": teacher,
                "training": config,
                "set": title,
                "average": average,
                "texture": f"{areas[TEXTURE][0]:.3f}",
                "layout": f"{layout[0]:.3f}",
                "product": f"{product[0]:.3f}",
                "sd": f"{torch.stack(products)[:, 0].std():.3f}",
                **difference_columns("product - texture", product - areas[TEXTURE]),
                **difference_columns("product - layout", product - layout),
                ROWS: f"{areas[ROWS][0]:.3f}",
            }


def confusion_rows(
    tallies: Mapping[str, Tally], teacher: str, config: str
) -> Iterator[dict[str, str]]:
    """Yield P2's Figs. 4b and 4c on CamVid, its drives pooled: void counts as vertical.

    Ratios of the students are means of the seeds.
    """
    students = [run_name(teacher, config, seed) for seed in SEEDS]
    for title, names in (("students", students), ("teacher", [TEACHER_DETECTORS[teacher]])):
        confusions = [tallies[name].table().layout for name in names]
        counts = [metrics.void_as_vertical(part.sum(0)) for part in confusions if part is not None]
        ratios = torch.stack([metrics.normalised_confusion(part) for part in counts]).mean(0)
        recalls = ratios.diagonal()
        for truth, row in PRINTED_ORDER.items():
            decisions = {key: f"{ratios[row, column]:.3f}" for key, column in PRINTED_ORDER.items()}
            accuracy = {"global average accuracy": f"{recalls.mean():.3f}"}
            origin = {"teacher": teacher, "training": config, "of": title, "truth": truth}
            yield {**origin, **decisions, **accuracy}


# --- the page -----------------------------------------------------------------------------


def page_rows(folder: Path) -> Iterator[str]:
    """Yield the rows of the page's two tables from the files of ``write_tables``."""
    claims, products = read_csv(folder / "claim.csv"), read_csv(folder / "claim_fusion.csv")
    for teacher in TEACHERS:
        rows = [r for r in claims if (r["teacher"], r["measure"]) == (teacher, "recall")]
        scores = {row["set"]: row["of the teacher"] for row in rows}
        yield format_row(f"**{teacher} teacher**", *scores.values())
        for config in dict.fromkeys(row["training"] for row in rows):
            cells = [
                f"{row['mean of 5 students']} ± {row['sd']}: {row['difference']} "
                f"({row['difference, 95 %']})"
                for row in rows
                if row["training"] == config
            ]
            yield format_row(f"`{config}`", *cells)
    for row in products:
        if (row["training"], row["average"]) == ("cnn7-paper", "by groups"):
            cells = [
                f"{row[kind]} ({row[f'{kind}, 95 %']})"
                for kind in ("product - texture", "product - layout")
            ]
            areas = [row["texture"], row["layout"], row["product"]]
            yield format_row(f"{row['set']}, {row['teacher']}", *areas, *cells, row[ROWS])


def format_row(*cells: str) -> str:
    """Format a row of a table, with the signs and the decimals of the pages."""
    text = "| " + " | ".join(cells) + " |"
    return re.sub(r"(?<!\d)0\.", ".", text).replace("-.", "\N{MINUS SIGN}.")


def read_csv(path: Path) -> list[dict[str, str]]:
    """Read the rows of a file."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def write_csv(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Write rows with a header."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def main() -> None:
    """Run a command of this script."""
    parser = argparse.ArgumentParser(description="Score students and teachers.")
    commands = parser.add_subparsers(dest="command", required=True)
    scoring = commands.add_parser("score")
    scoring.add_argument("data", type=Path)
    scoring.add_argument("--out", type=Path, required=True)
    tables = commands.add_parser("tables")
    tables.add_argument("--out", type=Path, required=True)
    tables.add_argument("--write", type=Path, required=True)
    options = parser.parse_args()
    if options.command == "score":
        score(options.data, options.out)
    else:
        write_tables(options.out, options.write)
        print("\n".join(page_rows(options.write)))


if __name__ == "__main__":
    main()
