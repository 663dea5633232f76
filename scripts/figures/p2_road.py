"""P2, Figs. 6a, 6b, 7 and 8: road by texture, by layout and by their product."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from roadtorch.base.image import tint_mask, to_pixels
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.evaluation import metrics
from roadtorch.evaluation.curves import Curve, area, operating_points
from roadtorch.evaluation.methods import Predictor, contender_from_name
from roadtorch.evaluation.report.montage import apply_colormap
from roadtorch.evaluation.tally import PooledCounts
from roadtorch.road.seed_area import seed_rectangle
from scripts.figures.chart import chart, show_table
from scripts.figures.counting import (
    Replicates,
    Tallies,
    count_images,
    observe,
    replicate,
    with_interval,
)
from scripts.figures.p2_layout import open_camvid
from scripts.figures.sheets import read_labelled, write_sheet

IDD_EVERY = 5
"""Step between IDD's images in Fig. 6a, of which CamVid's alone take eight minutes on one core."""

BASELINE, TEXTURE, COMBINED = "LBP (baseline)", "CPF", "CNN-7 × CPF"
BLIND = "row / height (blind)"

LINES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    BASELINE: ("lbp", {}),
    "U of grey": ("grey-uniformity", {}),
    TEXTURE: ("cpf", {}),
    "CPFv2": ("cpf:v2", {}),
    "CNN-7": ("layout:paper", {}),
    "CNN-7, trained as we do": ("layout:cnn-7", {}),
    COMBINED: ("fusion:paper", {}),
    "CNN-7 × CPFv2": ("fusion:paper", {"descriptor": "cpf:v2"}),
    "CNN-7, trained as we do, × CPF": ("fusion:paper", {"weights": {"file": "cnn-7"}}),
    BLIND: ("prior:rows", {}),
}
"""What Fig. 6a compares; the blind baseline and the grey plane (Fig. 7) are ours to add."""

GAINS = {TEXTURE: "8 %", COMBINED: "24 %"}
"""P2, section 6.2: by how much these are better than the baseline. (The areas themselves are
printed in the figure alone.)"""

WHOLE = " (isolated areas kept)"
"""Suffix of lines whose likelihood is used unchanged."""


def fig6a(data: Path, out: Path) -> None:
    """Write P2's Fig. 6a: ROC curves and AUC without isolated areas, on CamVid and IDD."""
    sets = {"camvid": open_camvid(data)}
    if (data / "idd_lite").is_dir():
        idd = open_dataset("idd-lite", data / "idd_lite")
        sets["idd"] = replace(idd, items=idd.items[::IDD_EVERY])
    contenders = []
    for title, (name, settings) in LINES.items():
        contender = contender_from_name(name, settings)
        joined = partial(_prepare_discarding, contender.prepare)
        contenders.append(replace(contender, name=title, prepare=joined))
        contenders.append(replace(contender, name=title + WHOLE))
    rows = []
    for name, dataset in sets.items():
        tallies = count_images(dataset, contenders)
        rows += area_rows(tallies, {"set": name, "images": len(dataset.items)})
        curves = {title: operating_points(observe(tallies[title]).pooled.road) for title in LINES}
        draw_roc(curves, out / f"p2-fig6a-{name}.png")
    show_table(out / "p2-fig6a.csv", rows)


def _prepare_discarding(prepare: Callable[[Dataset], Predictor], dataset: Dataset) -> Predictor:
    """Discard every area that does not touch the seed area, at every threshold."""
    detect = prepare(dataset)

    def predict(image: Tensor, item: LabelledItem) -> Detection:
        detection = detect(image, item)
        return replace(detection, likelihood=reach_of_seed(detection.likelihood))

    return predict


def reach_of_seed(likelihood: Tensor) -> Tensor:
    """Return the highest threshold at which each pixel of a map (H, W) is joined to the seed area.

    Thresholded, it is what is left of the map, thresholded, when isolated areas are discarded
    (P2, section 6.2): the greyscale reconstruction of the map from its seed area (Vincent 1993).
    """
    from skimage.morphology import reconstruction

    values = likelihood.numpy()
    marker = np.where(seed_rectangle(likelihood.shape).numpy(), values, 0)
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]])
    return torch.from_numpy(reconstruction(marker, values, footprint=cross).astype(np.float32))


def pooled_auc(counts: PooledCounts) -> Tensor:
    """Return the AUC of pooled pixels."""
    return metrics.auc(counts.road)


AVERAGES: Mapping[str, Callable[[Replicates], Tensor]] = {
    "pooled": lambda counts: pooled_auc(counts.pooled),
    "by drives": lambda counts: counts.mean(pooled_auc),
}
"""By name, how the AUC of a set is taken."""


def area_rows(tallies: Tallies, labels: Mapping[str, object]) -> list[dict[str, object]]:
    """Return each line's AUC, its gain over the baseline and over the blind one, and P2's gain.

    All with 95 % intervals, the gains paired.
    """
    counts = {title: (observe(tally), replicate(tally)) for title, tally in tallies.items()}
    rows = []
    for title in (title for title in tallies if not title.endswith(WHOLE)):
        row: dict[str, object] = {**labels, "method": title}
        for kind, (average, auc_of) in product(("", WHOLE), AVERAGES.items()):
            parts = [counts[name + kind] for name in (title, BASELINE, BLIND)]
            (area, replicates), (base, base_replicates), (blind, blind_replicates) = (
                (auc_of(observed), auc_of(resampled)) for observed, resampled in parts
            )
            gain, gains = 100 * (area / base - 1), 100 * (replicates / base_replicates - 1)
            ahead = area - blind, replicates - blind_replicates
            row |= {
                f"AUC, {average}{kind}": with_interval(area, replicates),
                f"over LBP, %, {average}{kind}": with_interval(gain, gains, "+.0f"),
                f"less rows, {average}{kind}": with_interval(*ahead, "+.3f"),
            }
        rows.append(row | {"P2's gain": GAINS.get(title, "")})
    return rows


def draw_roc(curves: Mapping[str, Curve], path: Path) -> None:
    """Draw ROC curves in one chart."""
    with chart(path, 6, 5.5) as figure:
        axes = figure.subplots()
        for title, curve in curves.items():
            style = ":" if title in (BASELINE, BLIND) else "-"
            axes.plot(curve.x, curve.y, style, label=f"{title}: {float(area(curve)):.3f}")
        axes.set(xlabel="false positive rate", ylabel="true positive rate")
        axes.set(xlim=(0, 1), ylim=(0, 1))
        axes.legend(loc="lower right")


ACCURACY = ("fusion:paper", "fusion:untrained", "fusion", "prior:rows")


def fpr_at_95(counts: PooledCounts) -> Tensor:
    """Return the FPR at the highest threshold whose recall is .95."""
    curve = operating_points(counts.road)
    recalled = (curve.y < 0.95).sum(-1, keepdim=True)
    return curve.x.gather(-1, recalled)[..., 0]


COLUMNS: Mapping[str, Callable[[PooledCounts], Tensor]] = {
    "road accuracy (recall)": lambda counts: metrics.recall(counts.mask),
    "FPR": lambda counts: metrics.false_positive_rate(counts.mask),
    "precision": lambda counts: metrics.precision(counts.mask),
    "F": lambda counts: metrics.f_measure(counts.mask),
    "FPR where recall is .95": fpr_at_95,
}
"""Of Fig. 6b's table: by title, a score of the detector's masks, and the last of its likelihood."""


def fig6b(data: Path, out: Path) -> None:
    """Write P2's Fig. 6b: road accuracy (recall), beside FPR, precision and F."""
    tallies = count_images(open_camvid(data), ACCURACY)
    rows = []
    for name, tally in tallies.items():
        counts, replicates = observe(tally).pooled, replicate(tally).pooled
        threshold = f"{contender_from_name(name, {}).threshold:g}"
        scores = {
            title: with_interval(score(counts), score(replicates))
            for title, score in COLUMNS.items()
        }
        rows.append({"detector": name, "threshold": threshold, **scores})
    show_table(out / "p2-fig6b.csv", rows)


# --- images -----------------------------------------------------------------------------


def likelihood_rows(data: Path, detectors: Mapping[str, str]) -> dict[str, list[np.ndarray]]:
    """Return rows of free labelled images, their truth and the likelihoods of detectors."""
    streets = read_labelled(data)
    images = [image for image, _ in streets]
    rows = {"image": [to_pixels(image) for image in images]}
    rows["truth"] = [tint_mask(to_pixels(image), truth.road.numpy()) for image, truth in streets]
    for caption, name in detectors.items():
        detector = load_detector(name)
        rows[caption] = [apply_colormap(detector.detect(image).likelihood) for image in images]
    return rows


def fig7(data: Path, out: Path) -> None:
    """Write P2's Fig. 7: uniformity of the grey plane, and of the fused planes."""
    detectors = {"U of grey": "grey-uniformity", "U of the fused planes": "cpf"}
    write_sheet(out / "p2-fig7.jpg", likelihood_rows(data, detectors))


def fig8(data: Path, out: Path) -> None:
    """Write P2's Fig. 8: likelihoods by texture and by layout, and the road of their product."""
    rows = likelihood_rows(data, {"texture, CPF": "cpf", "layout, CNN-7": "layout:paper"})
    detector = load_detector("fusion:paper")
    rows["product"] = [detector.detect(image).overlay() for image, _ in read_labelled(data)]
    write_sheet(out / "p2-fig8.jpg", rows)
