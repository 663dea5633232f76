"""P2, section 6.2: Figs. 6a, 6b, 7 and 8, road by texture, by layout, and by both."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import torch

from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation import metrics
from roadtorch.evaluation.curves import Curve, area, roc
from roadtorch.io.atomic import atomic
from roadtorch.io.image import tint_mask, to_pixels
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.report.montage import heat
from scripts.figures_p2_streets import (
    Counts,
    Found,
    auc,
    found_on,
    look_of,
    mean_over_drives,
    pooled,
    shown_items,
    streets,
    tell,
    write_sheet,
)

BASELINE, TEXTURE, COMBINED = "LBP (baseline)", "CPF", "CNN-7 × CPF"

LINES = {
    BASELINE: ("lbp", {}),
    "U of grey": ("grey-uniformity", {}),
    TEXTURE: ("cpf", {}),
    "CPFv2": ("cpf:v2", {}),
    "CNN-7": ("layout:cnn-7", {}),
    COMBINED: ("fusion:paper", {}),
    "CNN-7 × CPFv2": ("fusion:paper", {"descriptor": "cpf:v2"}),
    "row / height (floor)": ("prior:rows", {}),
}
"""What Fig. 6a compares; the floor and the grey one (Fig. 7) are ours to add."""

GAINS = {TEXTURE: "8 %", COMBINED: "24 %"}
"""P2, section 6.2: by how much these are better than the baseline. (The areas themselves are
printed in the figure alone.)"""


def roc_curves(data: Path, out: Path) -> None:
    """Fig. 6a: ROC curves and their areas, of texture, layout and their product."""
    looks = {text: look_of(name, settings) for text, (name, settings) in LINES.items()}
    found = found_on(streets(data), looks)
    tell(area_rows(found), out / "p2-fig6a.csv")
    draw_roc(
        {text: roc(pooled(drives).road) for text, drives in found.items()}, out / "p2-fig6a.png"
    )


def area_rows(found: Found) -> list[dict[str, str]]:
    """AUC pooled and by drives, and the gain over the baseline, of each line."""
    base = float(auc(pooled(found[BASELINE])))
    rows = []
    for text, drives in found.items():
        value = float(auc(pooled(drives)))
        rows.append(
            {
                "method": text,
                "AUC, pooled": f"{value:.3f}",
                "mean of drives": f"{mean_over_drives(drives, auc):.3f}",
                "over the baseline": f"{100 * (value / base - 1):+.0f} %",
                "P2's gain": GAINS.get(text, ""),
            }
        )
    return rows


def draw_roc(curves: Mapping[str, Curve], path: Path) -> None:
    """ROC curves in one picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 5.5), layout="constrained")
    axes = figure.subplots()
    for text, curve in curves.items():
        style = ":" if "floor" in text else "-"
        axes.plot(curve.x, curve.y, style, label=f"{text}: {float(area(curve)):.3f}")
    axes.set(xlabel="false positive rate", ylabel="true positive rate", xlim=(0, 1), ylim=(0, 1))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    with atomic(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
    print(path)


ACCURACY = ("fusion:paper", "fusion:untrained", "fusion", "prior:rows")


def road_accuracy(data: Path, out: Path) -> None:
    """Fig. 6b: road accuracy, the share of road that is found; what it costs stands beside."""
    found = found_on(streets(data), {name: look_of(name) for name in ACCURACY})
    rows = []
    for name, drives in found.items():
        threshold = load_detector(name).settings.threshold
        rows.append(
            {"detector": name, "threshold": f"{threshold:g}"} | accuracy_row(pooled(drives))
        )
    tell(rows, out / "p2-fig6b.csv")


def accuracy_row(counts: Counts) -> dict[str, str]:
    """Recall, FPR, precision and F of the detector's own masks; the FPR at a recall of 0.95."""
    figures = {
        "road accuracy (recall)": metrics.recall,
        "FPR": metrics.false_positive_rate,
        "precision": metrics.precision,
        "F": metrics.f_measure,
    }
    own = {text: f"{float(figure(counts.mask)):.3f}" for text, figure in figures.items()}
    curve = roc(counts.road)
    at = int(torch.searchsorted(curve.y.contiguous(), 0.95))
    return own | {"FPR where recall is .95": f"{float(curve.x[at]):.3f}"}


def texture_sheet(data: Path, out: Path) -> None:
    """Fig. 7: picture, U of the grey image, U of the fused plane."""
    dataset = streets(data)
    grey, fused = load_detector("grey-uniformity"), load_detector("cpf")
    columns = []
    for item in shown_items(dataset):
        image, _ = dataset.read(item)
        columns.append(
            {
                item.name: to_pixels(image),
                "U of grey": heat(stretched(grey.detect(image).cues["uniformity"])),
                "U of the fused plane": heat(stretched(fused.detect(image).cues["uniformity"])),
            }
        )
    write_sheet(columns, out / "p2-fig7.png")


def stretched(values: torch.Tensor) -> torch.Tensor:
    """A map (H,W) from its least value, 0, to its largest, 1; 0 where it is flat."""
    low, high = values.min(), values.max()
    return (values - low) / (high - low).clamp_min(1e-9)


def road_sheet(data: Path, out: Path) -> None:
    """Fig. 8: picture, truth, road by texture, road by CNN-7, the road of both."""
    dataset = streets(data)
    both = load_detector("fusion:paper")
    columns = []
    for item in shown_items(dataset):
        image, truth = dataset.read(item)
        found = both.detect(image)
        tinted = partial(tint_mask, to_pixels(image))
        columns.append(
            {
                item.name: to_pixels(image),
                "truth": tinted(truth.road.numpy()),
                "texture (CPF)": heat(stretched(found.cues["uniformity"])),
                "ground by CNN-7": heat(found.cues["layout"][HORIZONTAL]),
                "both: road": tinted(found.mask.numpy()),
            }
        )
    write_sheet(columns, out / "p2-fig8.png")
