"""Score the students of ``train.claim`` and their teachers.

    python -m train.claim_scores score DATA --out RUNS       # resumable
    python -m train.claim_scores tables --out RUNS --write DOCS/research

Measures are of the layout (recalls of its strongest class) and of the ground's potential, at every
second pixel of every second row. The area under the ROC curve and the average precision use 4,096
levels of a quarter of the log odds, so that potentials near 1 keep their order. Intervals of 95 %
are over images, drawn within their camera, and over seeds, by Student's t.
"""

import argparse
import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import torch
from matplotlib.figure import Figure
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.evaluation import metrics
from roadtorch.evaluation.curves import brier_score, expected_calibration_error
from roadtorch.evaluation.metrics import RoadCounts
from roadtorch.evaluation.uncertainty import (
    BOOTSTRAP_SEED,
    percentile_interval,
    sample_weights,
    student_weights,
)
from roadtorch.imaging.resize import resize_to_image, resize_to_work, spatial_size
from roadtorch.imaging.slic import Superpixels
from roadtorch.layout.classes import HORIZONTAL, SKY, UNLABELLED, VERTICAL
from roadtorch.layout.labeller import LabellerSettings, label_at_image_size
from roadtorch.layout.patch_network import PatchNetwork
from roadtorch.layout.weights import load_network
from roadtorch.train.config import PatchTraining
from roadtorch.train.run_folder import WEIGHTS
from train.claim import CONFUSED, DOMAINS, DRIVES, INDEPENDENT, Run, plan_runs, split_domain
from train.superpixels import SuperpixelTeacher

SETS = (*DOMAINS, "many")
TITLES = {"idd": "IDD", "many": "eight cameras", **{drive: drive for drive in DRIVES}}
HONEST = ("untuned", "superpixels", "tuned")
"""Teachers without labels of the images that they teach; the last one's constants chose labels."""

RANKS, LEVELS, STRETCH = 4096, 1024, 4.0

# --- scores of images ---------------------------------------------------------------------

Labeller = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Potentials (3, h, w) and log odds of the ground (h, w) of an image at working size."""


def as_teacher(potentials: Tensor) -> tuple[Tensor, Tensor]:
    """Return potentials that sum to 1, and the ground's log odds, from what the other two have."""
    not_ground = potentials[SKY] + potentials[VERTICAL]
    return potentials, potentials[HORIZONTAL].log() - not_ground.log()


def make_labeller(name: str, out: Path) -> Labeller:
    """Return a teacher, or the student of a run's folder."""
    superpixels = Superpixels()
    if name == "superpixels":
        trees = SuperpixelTeacher(out / "superpixels.pickle", superpixels)
        return lambda image: as_teacher(trees.potentials(image).double())
    if name in HONEST:
        settings = LabellerSettings.model_validate({"constants": name, "margin": 0.0})
        return lambda image: as_teacher(
            label_at_image_size(image, settings, superpixels, 0.0).potentials.double()
        )
    network = load_network(out / name / WEIGHTS)
    assert isinstance(network, PatchNetwork)

    def student(image: Tensor) -> tuple[Tensor, Tensor]:
        potentials = network.potentials(image).double()
        return potentials, potentials[HORIZONTAL].logit(1e-12)

    return student


class Counts(NamedTuple):
    """Counts of n images: the ground by rank and by likelihood (n, levels), layout (n, 4, 4)."""

    ranks: RoadCounts
    likelihoods: RoadCounts
    layout: Tensor
    groups: list[str]


def open_set(data: Path, name: str) -> tuple[Dataset, list[LabelledItem]]:
    """Open a set and the images that are scored: of many those whose layout is labelled."""
    if name != "many":
        dataset, _, scored = split_domain(data, name)
        return dataset, scored
    dataset = open_dataset("folder", data / "many")
    return dataset, [item for item in dataset.items if dataset.truth(item).layout is not None]


@torch.inference_mode()
def count_images(dataset: Dataset, items: Sequence[LabelledItem], labeller: Labeller) -> Counts:
    """Count what a labeller says of images."""
    parts = list[tuple[Tensor, ...]]()
    for item in items:
        image, truth = dataset.read(item)
        assert truth.layout is not None
        layout = truth.layout[::2, ::2]
        output = labeller(resize_to_work(image, PatchTraining().network.working))
        potentials, odds = (
            resize_to_image(part, spatial_size(image))[..., ::2, ::2]
            for part in (output[0], output[1][None])
        )
        ground, valid = layout == HORIZONTAL, layout != UNLABELLED
        ranks = metrics.count_levels((odds[0] / STRETCH).sigmoid(), ground, valid, RANKS)
        chances = metrics.count_levels(odds[0].sigmoid(), ground, valid, LEVELS)
        decided = metrics.count_layout(potentials.argmax(0), layout)
        parts.append((ranks.road, ranks.background, chances.road, chances.background, decided))
    road, background, sure, unsure, decided = map(torch.stack, zip(*parts, strict=True))
    groups = [item.group or "" for item in items]
    return Counts(RoadCounts(road, background), RoadCounts(sure, unsure), decided, groups)


def names_of(name: str, out: Path) -> list[str]:
    """Return teachers and finished students that are scored on a set."""
    runs = [run.name for run in plan_runs() if run.images in ("free", name)]
    return [*HONEST, *(run for run in runs if (out / run / "done").exists())]


def score(data: Path, out: Path) -> None:
    """Score every teacher and student on every set, unless its file is there."""
    torch.set_num_threads(1)
    for name in SETS:
        folder = out / "scores" / name
        folder.mkdir(parents=True, exist_ok=True)
        left = [key for key in names_of(name, out) if not (folder / key).exists()]
        dataset, items = open_set(data, name)
        for key in left:
            torch.save(count_images(dataset, items, make_labeller(key, out)), folder / key)
        print(f"{TITLES[name]}: {len(items)} images, {len(left)} scored", flush=True)


# --- measures -----------------------------------------------------------------------------

MEASURES: dict[str, Callable[[RoadCounts, RoadCounts, Tensor], Tensor]] = {
    "mean recall": lambda ranks, chances, layout: metrics.mean_class_recall(layout),
    **{
        f"recall {title}": lambda ranks, chances, layout, c=c: metrics.class_recalls(layout)[..., c]
        for c, title in ((SKY, "sky"), (VERTICAL, "vertical"), (HORIZONTAL, "ground"))
    },
    "AP": lambda ranks, chances, layout: metrics.average_precision(ranks),
    "AUC": lambda ranks, chances, layout: metrics.auc(ranks),
    "F": lambda ranks, chances, layout: metrics.f_measure(metrics.confusion_at(chances, 0.5)),
    "Brier": lambda ranks, chances, layout: brier_score(chances),
    "ECE": lambda ranks, chances, layout: expected_calibration_error(chances),
}
"""Measures of counts: ground by rank, ground by likelihood, layout."""


def measure(counts: Counts) -> dict[str, Tensor]:
    """Compute the measures, float64 (replicates + 1,), the first of all images; mean of groups."""
    generator = torch.Generator().manual_seed(BOOTSTRAP_SEED)
    values: dict[str, list[Tensor]] = {key: [] for key in MEASURES}
    for group in sorted(set(counts.groups)):
        members = torch.tensor([name == group for name in counts.groups])
        weights = sample_weights([group] * int(members.sum()), generator)

        def pool(part: Tensor, members: Tensor = members, weights: Tensor = weights) -> Tensor:
            chosen = part[members].to(torch.float64)
            return (weights @ chosen.flatten(1)).reshape(-1, *chosen.shape[1:])

        ranks, chances = (
            RoadCounts(pool(part.road), pool(part.background))
            for part in (counts.ranks, counts.likelihoods)
        )
        layout = pool(counts.layout)
        for key, formula in MEASURES.items():
            values[key].append(formula(ranks, chances, layout))
    return {key: torch.stack(parts).nanmean(0) for key, parts in values.items()}


Scores = Mapping[str, Mapping[str, Tensor]]
"""Measures by contender."""


def mean_of_seeds(values: Sequence[Tensor]) -> Tensor:
    """Return the mean of seeds' scores (replicates + 1,), their replicates of Student's t."""
    weights = student_weights(len(values), torch.Generator().manual_seed(BOOTSTRAP_SEED + 1))
    weights = torch.cat([torch.ones_like(weights[:1]), weights])
    return (weights * torch.stack(list(values), 1)).mean(1)


# --- tables -------------------------------------------------------------------------------


def write_tables(out: Path, folder: Path) -> None:
    """Write the scores of studies and of seeds, the losses, and the table and figure of noise."""
    scores: dict[str, Scores] = {}
    for name in SETS:
        keys = [key for key in names_of(name, out) if (out / "scores" / name / key).exists()]
        files = {key: out / "scores" / name / key for key in keys}
        scores[name] = {
            key: measure(torch.load(file, weights_only=False)) for key, file in files.items()
        }
    write_csv(folder / "claim.csv", list(study_rows(scores)))
    write_csv(folder / "claim_seeds.csv", list(seed_rows(scores)))
    write_csv(folder / "claim_losses.csv", list(loss_rows(out)))
    noise = list(noise_rows(scores[DRIVES[0]]))
    write_csv(folder / "claim_noise.csv", noise)
    draw_noise(noise, folder / "claim_noise.svg")


def studies(scores: Scores, name: str) -> dict[Run, list[str]]:
    """Return the students of a set by study: a run without its seed."""
    groups: dict[Run, list[str]] = {}
    for run in plan_runs():
        if run.images in ("free", name) and run.name in scores:
            groups.setdefault(run._replace(seed=0), []).append(run.name)
    return {run: names for run, names in groups.items() if len(names) > 1}


def study_rows(scores: Mapping[str, Scores]) -> Iterator[dict[str, str]]:
    """Yield teacher, students and their difference, by set, study and measure."""
    for name, contenders in scores.items():
        for run, students in studies(contenders, name).items():
            if run.noise:
                continue
            for key in MEASURES:
                values = [contenders[student][key] for student in students]
                first = torch.stack([value[0] for value in values])
                row = {
                    "set": TITLES[name],
                    "teacher": run.teacher,
                    "images": images_of(run),
                    "recipe": run.recipe,
                    "measure": key,
                    "seeds": str(len(students)),
                    "of the teacher": "",
                    "mean of the students": f"{first.mean():.3f}",
                    "sd": f"{first.std():.3f}",
                    "difference": "",
                    "difference, 95 %": "",
                }
                if run.teacher in contenders:
                    reference = contenders[run.teacher][key]
                    change = mean_of_seeds(values) - reference
                    low, high = percentile_interval(change[1:])
                    row["of the teacher"] = f"{reference[0]:.3f}"
                    row["difference"] = f"{change[0]:+.3f}"
                    row["difference, 95 %"] = f"{low:+.3f} to {high:+.3f}"
                yield row


def images_of(run: Run) -> str:
    """Return what taught the students of a run: free, domain or both."""
    return "both" if run.first else "free" if run.images == "free" else "domain"


def seed_rows(scores: Mapping[str, Scores]) -> Iterator[dict[str, str]]:
    """Yield the scores of every teacher and student on every set."""
    for name, contenders in scores.items():
        for key, values in contenders.items():
            numbers = {title: f"{float(value[0]):.4f}" for title, value in values.items()}
            yield {"set": TITLES[name], "of": key, **numbers}


def loss_rows(out: Path) -> Iterator[dict[str, str]]:
    """Yield the mean loss of every epoch of every student."""
    for run in plan_runs():
        if (out / run.name / "done").exists():
            for row in read_csv(out / run.name / "log.csv"):
                loss = f"{float(row['loss']):.4f}"
                yield {"of": run.name, **{k: row[k] for k in ("epoch", "samples")}, "loss": loss}


# --- noise ----------------------------------------------------------------------------------


def noise_rows(scores: Scores) -> Iterator[dict[str, str]]:
    """Yield the mean recall of noisy labels and of the students that they taught.

    A class keeps 1 - rate of its labels under independent noise, or all but a share of the
    labeller's errors.
    """
    errors = 1 - float(scores["untuned"]["mean recall"][0])
    for run, students in studies(scores, DRIVES[0]).items():
        if run.teacher == "truth":
            recalls = torch.stack([scores[name]["mean recall"][0] for name in students])
            labels = 1 - run.rate * (errors if run.noise == CONFUSED else 1)
            yield {
                "noise": run.noise,
                "rate": str(run.rate),
                "seeds": str(len(students)),
                "mean recall of the labels": f"{labels:.3f}",
                "mean recall of the students": f"{recalls.mean():.3f}",
                "sd": f"{recalls.std():.3f}",
            }


def draw_noise(rows: Sequence[Mapping[str, str]], file: Path) -> None:
    """Draw the students' mean recall over that of the labels which taught them."""
    figure = Figure(figsize=(5, 3.6), layout="constrained")
    axes = figure.subplots()
    for noise, title in ((INDEPENDENT, "independent noise"), (CONFUSED, "the labeller's errors")):
        part = [row for row in rows if row["noise"] in ("", noise)]
        x, y, sd = (
            [float(row[key]) for row in part]
            for key in ("mean recall of the labels", "mean recall of the students", "sd")
        )
        axes.errorbar(x, y, sd, marker="o", capsize=3, label=title)
    axes.axline((0.8, 0.8), slope=1, color="grey", linestyle=":", label="as good as the labels")
    axes.set(xlabel="mean recall of the labels", ylabel="mean recall of the students")
    axes.legend()
    figure.savefig(file, metadata={"Date": None})


# --- the page -----------------------------------------------------------------------------


def page_rows(folder: Path) -> Iterator[str]:
    """Yield the rows of the page's table: mean recall of teachers, of students, differences."""
    rows = [row for row in read_csv(folder / "claim.csv") if row["recipe"] == "cnn7"]
    rows = [row for row in rows if row["measure"] == "mean recall"]
    for teacher in dict.fromkeys(row["teacher"] for row in rows):
        scores = {row["set"]: row["of the teacher"] for row in rows if row["teacher"] == teacher}
        yield format_row(f"**{teacher}**", *(scores.get(TITLES[name], "") for name in SETS))
        for images in ("domain", "free", "both"):
            part = [r for r in rows if (r["teacher"], r["images"]) == (teacher, images)]
            cells = {row["set"]: format_cell(row) for row in part}
            if cells:
                yield format_row(images, *(cells.get(TITLES[name], "") for name in SETS))


def format_cell(row: Mapping[str, str]) -> str:
    """Format the students' mean, and the difference from their teacher with its interval."""
    mean, low_high = row["mean of the students"], row["difference, 95 %"].replace(" to ", "…")
    return f"{mean}, {row['difference']} ({low_high})" if row["difference"] else mean


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
        writer = csv.DictWriter(file, list(rows[0]) if rows else [], lineterminator="\n")
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
