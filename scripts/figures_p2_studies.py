"""What P2's own formulas and numbers do: the ridge of eq. 3, the priors of eq. 4, superpixels."""

from pathlib import Path

import torch

from roadtorch.evaluation import metrics
from roadtorch.evaluation.methods import Look
from scripts.figures_p2_streets import (
    Counts,
    Found,
    auc,
    found_on,
    look_of,
    mean_over_drives,
    pooled,
    streets,
    tell,
)

RIDGES = (0.0, 1e-6, 3e-3, 3e-2, 1.0)

INDEPENDENT = ("R", "G", "B", "nr", "ng", "S")
"""P2's planes without those that are linear in R, G and B, and without V, one of them."""

EIGHTH = 8
"""Where figures differ little, every so-manieth picture is looked at."""

PIXELS = {"P2's, about 1,920": 40, "ours, about 300": 256}
"""4.8 M patches / 500 pictures / 5 patches = 1,920 superpixels; pixels of each at 320×240."""


def ridges(data: Path, out: Path) -> None:
    """Eq. 3 by its ridge: AUC of `cpf` with P2's nine planes, and with six that are independent."""
    looks = {f"nine planes, ridge {ridge:g}": _cpf(ridge=ridge) for ridge in RIDGES}
    looks |= {
        f"six planes, ridge {ridge:g}": _cpf(ridge=ridge, planes=INDEPENDENT) for ridge in RIDGES
    }
    tell(road_rows(found_on(streets(data, EIGHTH), looks)), out / "p2-ridge.csv")


def _cpf(**texture: object) -> Look:
    return look_of("cpf", {"texture": texture})


def priors(data: Path, out: Path) -> None:
    """Eq. 4 by its prior and its descriptor, and the same cues multiplied as odds."""
    looks = {
        f"{prior}, {descriptor}": look_of(
            "fusion:paper", {"prior": prior, "descriptor": descriptor}
        )
        for prior in ("uniform", "rows", "triangle")
        for descriptor in ("cpf", "cpf:v2")
    }
    tell(road_rows(found_on(streets(data), looks)), out / "p2-eq4.csv")


def superpixel_counts(data: Path, out: Path) -> None:
    """P2's 1,920 superpixels a picture beside our 300: road, and layout of the labeller."""
    dataset = streets(data, EIGHTH)
    looks = {
        f"{name}, {text}": look_of(name, {"superpixels": {"pixels": pixels}})
        for name in ("fusion:paper", "cpf", "labeller")
        for text, pixels in PIXELS.items()
    }
    found = found_on(dataset, looks)
    rows = road_rows(found)
    for row in rows:
        row["layout"] = layout_recall(found, row["method"])
    tell(rows, out / "p2-superpixels.csv")


def layout_recall(found: Found, name: str) -> str:
    """Mean class recall over drives; a dash where a detector has no layout."""
    layouts = [counts.layout for counts in found[name].values() if counts.layout is not None]
    return (
        f"{float(metrics.mean_class_recall(torch.stack(layouts)).mean()):.3f}" if layouts else "-"
    )


def road_rows(found: Found) -> list[dict[str, str]]:
    """AUC pooled; AUC, MaxF and F of the own mask as means over the drives."""
    return [
        {
            "method": name,
            "AUC, pooled": f"{float(auc(pooled(drives))):.3f}",
            "AUC": f"{mean_over_drives(drives, auc):.3f}",
            "MaxF": f"{mean_over_drives(drives, _max_f):.3f}",
            "F": f"{mean_over_drives(drives, _f_of_mask):.3f}",
        }
        for name, drives in found.items()
    ]


def _max_f(counts: Counts) -> torch.Tensor:
    return metrics.max_f(counts.road)[0]


def _f_of_mask(counts: Counts) -> torch.Tensor:
    return metrics.f_measure(counts.mask)
