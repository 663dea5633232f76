"""Runs with made-up numbers, as `roadtorch evaluate` hands them to its report."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

DRIVES = ("0001TP", "0006R0", "0016E5")
NAMES = ("fusion", "labeller", "prior:mean", "cpf:v2", "prior:rows")
CLASSES = ("sky", "vertical", "horizontal")


def made_run(
    names: Sequence[str] = NAMES, drives: Sequence[str] = DRIVES
) -> tuple[dict[str, Any], dict[str, Any], list[dict[str, Any]]]:
    """(document, curves, rows): the first detector is the best, each next one a little worse."""
    quality = {name: 0.95 - 0.3 * place / len(names) for place, name in enumerate(names)}
    document = {
        "roadtorch": "0.1.0",
        "dataset": "camvid",
        "split": "dev",
        "images": 30,
        "void": "ignored",
        "command": "roadtorch evaluate camvid data --detector 'cpf*'",
        "levels": 65536,
        "view": "the picture",
        "failed": [{"image": "0001TP_9", "reason": "is not a picture"}],
        "detectors": {name: made_figures(score, drives) for name, score in quality.items()},
        "paired": made_pairs(quality),
    }
    curves = {name: made_curves(score, drives) for name, score in quality.items()}
    rows = [
        {"image": f"{drive}_{i}", "group": drive, "detector": name, "f": score - 0.02 * i}
        for name, score in quality.items()
        for drive in drives or ("all",)
        for i in range(10)
    ]
    return document, curves, rows


def made_figures(score: float, drives: Sequence[str]) -> dict[str, Any]:
    """Figures of one detector; a drive has a hundredth more than the one before."""
    parts = {drive: made_part(score + 0.01 * (i - 1)) for i, drive in enumerate(drives)}
    figures = {
        **made_part(score),
        "ci95": {"maxf": [score - 0.015, score + 0.0125]},
        "threshold_from": "the other drives",
        "settings": {"seed": {"height": 30}},
    }
    return {**figures, "groups": parts, "pooled": made_part(score)} if drives else figures


def made_part(score: float) -> dict[str, Any]:
    confusion = {truth: dict.fromkeys(CLASSES, 0.05) | {truth: 0.9} for truth in CLASSES}
    return {
        "images": 10,
        "maxf": score,
        "auc_pooled": 0.5 + score / 2,
        "auc_mean": 0.51 + score / 2.1,
        "ap": score - 0.011,
        "iou": score - 0.1,
        "f": score - 0.021,
        "precision": score - 0.005,
        "recall": score - 0.031,
        "iou_mask": score - 0.12,
        "threshold": 0.4375,
        "eer": 1 - score,
        "brier": (1 - score) / 2,
        "ece": (1 - score) / 3,
        "boundary_f": {"0.005": score / 3, "0.0025": score / 4},
        "working_point": {"precision": score, "recall": score, "fpr": 0.03, "fnr": 1 - score},
        "ms_per_image": 12.34,
        "layout": {
            **dict.fromkeys(CLASSES, score),
            "mean": score,
            "accuracy": score - 0.01,
            "void_as_vertical": {"mean": score - 0.02},
            "confusion": confusion,
        },
    }


def made_pairs(quality: dict[str, float]) -> dict[str, Any]:
    """Everybody less the first, with intervals that reach 0.03 to both sides."""
    against = next(iter(quality))
    changes = {name: score - quality[against] for name, score in quality.items()}
    return {
        "against": against,
        "detectors": {
            name: {
                key: {"difference": change, "ci95": [change - 0.03, change + 0.03]}
                for key in ("maxf", "auc_pooled", "iou")
            }
            for name, change in changes.items()
            if name != against
        },
    }


def made_curves(score: float, drives: Sequence[str]) -> dict[str, Any]:
    x = np.linspace(0, 1, 50)
    one = {
        "roc": [x.tolist(), (x ** (1 - score)).tolist()],
        "pr": [x.tolist(), (1 - (1 - score) * x).tolist()],
        "reliability": [[0.1, 0.5, 0.9], [0.1, score / 2, score], [0.7, 0.1, 0.2]],
    }
    return {"mean": one, "groups": dict.fromkeys(drives, one)}


def made_sheet(kind: str = ".png", width: int = 64, height: int = 24) -> bytes:
    """A sheet of pictures, encoded."""
    ramp = np.tile(np.arange(width, dtype=np.uint8)[None, :, None], (height, 1, 3))
    return cv2.imencode(kind, ramp)[1].tobytes()
