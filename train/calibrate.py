"""Choose how far `fusion` trusts its network, its calibration, and what tells a good mask.

    python -m train.calibrate pool DATA [--detector fusion:large] [--weights FILE]
    python -m train.calibrate trust DATA [--detector fusion:large]
    python -m train.calibrate threshold DATA --detector layout

DATA holds ``many/`` and ``camvid/``. A camera is a folder of many/ or a drive of CamVid (every
fourth frame); each counts the same, and what is said of a camera was chosen on the others. IDD
has no part. ``pool`` chooses ``learned.weight``, ``learned.detail`` and ``calibration.centre`` by
the mean F of masks at .5, and ``calibration.temperature`` by the cross-entropy of pixels; ``trust``
fits the weights of ``roadtorch.road.trust``; ``threshold`` is for detectors without a calibration.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from sklearn.linear_model import Ridge
from tqdm import tqdm

from roadtorch import Detection, load_detector
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detector import Detector
from roadtorch.evaluation.metrics import (
    RoadCounts,
    count_levels,
    count_mask,
    decisions_at,
    f_measure,
)
from roadtorch.evaluation.trust import (
    BAD,
    Trusted,
    correlation_within,
    failure_auc,
    rank_correlation,
)
from roadtorch.road.fusion import log_odds
from roadtorch.road.trust import Signs, signs_of

EVERY = 4
"""Every how many-th frame of CamVid is used."""

DRIVES = ("0001TP", "0006R0", "0016E5")
"""CamVid's, beside the folders of many/."""

TOO_FEW = ("india_zed",)
"""Folders of many/ that its README leaves out of means."""

WEIGHTS, DETAILS = (1.0, 2.0), (1.0, 2.0, 4.0)
LEVELS = np.arange(-40, 40.01, 0.25)
"""Of log odds, between which pixels are counted."""


def pictures(root: Path, detector: Detector) -> Iterator[tuple[str, Detection, Truth]]:
    """Camera, detection and truth of every picture of many/ and every fourth of CamVid."""
    many, camvid = open_dataset("folder", root / "many"), open_dataset("camvid", root / "camvid")
    items = [(many, item) for item in many.items if item.group not in TOO_FEW]
    items += [(camvid, item) for item in camvid.items[::EVERY]]
    for dataset, item in tqdm(items, disable=None):
        image, truth = dataset.read(item)
        yield str(item.group), detector.detect(image), truth


# --- pool -------------------------------------------------------------------------------


def choose_pool(root: Path, name: str, settings: dict[str, Any]) -> None:
    """Print the choices by mean F, and F of each camera with what the others choose."""
    seen: dict[tuple[float, float], dict[str, np.ndarray]] = {}
    plain = {"centre": 0.0, "temperature": 1.0}
    for weight in WEIGHTS:
        learned = {"weight": weight, "detail": 0.0}
        detector = load_detector(name, learned=learned, calibration=plain, **settings)
        for camera, found, truth in pictures(root, detector):
            for detail in DETAILS:
                by_camera = seen.setdefault((weight, detail), {})
                counts = counts_by_odds(found, truth, detail)
                by_camera[camera] = by_camera.get(camera, 0) + counts
    counts = np.array([list(each.values()) for each in seen.values()])  # choice, camera, 2, level
    above = counts[..., ::-1].cumsum(-1)[..., ::-1][..., 1:]  # at or above each of LEVELS
    hits, alarms = above[:, :, 0], above[:, :, 1]
    table = 2 * hits / (hits + alarms + counts[:, :, :1, :].sum((2, 3))[..., None])
    at = table.mean(1).argmax(1)
    for number in np.argsort(-table.mean(1).max(1)):
        (weight, detail), f = list(seen)[number], table[number][:, at[number]]
        print(
            f"weight {weight} detail {detail} centre {LEVELS[at[number]]:+.2f} temperature "
            f"{temperature_of(counts[number], float(LEVELS[at[number]])):.1f}: F {f.mean():.4f} "
            f"worst {f.min():.3f} best of each {table[number].max(1).mean():.4f}"
        )
    for number, camera in enumerate(next(iter(seen.values()))):
        others = np.delete(table, number, 1).mean(1)
        choice, centre = np.unravel_index(others.argmax(), others.shape)
        print(f"{camera:16} {table[choice, number, centre]:.3f} as the others choose")


def counts_by_odds(found: Detection, truth: Truth, detail: float) -> np.ndarray:
    """Pixels (2,levels + 1) of road and of background between LEVELS; the ego car is lowest."""
    odds = torch.logit(found.likelihood, eps=1e-7) + detail * log_odds(found.cues["learned_road"])
    odds = torch.where(found.cues["ego"], -torch.inf, odds)
    edges = np.concatenate([[-np.inf], LEVELS, [np.inf]])
    parts = (truth.valid & truth.road, truth.valid & ~truth.road)
    return np.stack([np.histogram(odds[part].numpy(), edges)[0] for part in parts]).astype(float)


def temperature_of(counts: np.ndarray, centre: float) -> float:
    """By which log odds less ``centre`` are divided so that they say how often road is there.

    counts: (cameras,2,levels + 1); every camera counts the same. By the least cross-entropy.
    """
    shares = (counts / counts.sum((1, 2), keepdims=True)).mean(0)[:, 1:-1]
    odds = (LEVELS[1:] + LEVELS[:-1]) / 2 - centre

    def loss(temperature: float) -> float:
        said = odds / temperature
        return float((shares[0] * np.logaddexp(0, -said) + shares[1] * np.logaddexp(0, said)).sum())

    return min(np.arange(0.5, 10.1, 0.1), key=loss)


# --- threshold --------------------------------------------------------------------------


def choose_threshold(root: Path, name: str, settings: dict[str, Any]) -> None:
    """Print the threshold with the best mean F over the cameras, and what it is worth."""
    seen: dict[str, RoadCounts] = {}
    for camera, found, truth in pictures(root, load_detector(name, **settings)):
        counts = count_levels(found.likelihood, truth.road, truth.valid)
        seen[camera] = seen[camera] + counts if camera in seen else counts
    levels = np.arange(0.02, 1, 0.01)
    table = np.array(
        [[float(f_measure(decisions_at(c, t))) for t in levels] for c in seen.values()]
    )
    at = int(table.mean(0).argmax())
    chosen = [np.delete(table, k, 0).mean(0).argmax() for k in range(len(table))]
    held_out = np.mean([row[k] for row, k in zip(table, chosen, strict=True)])
    print(
        f"threshold {levels[at]:.2f}: F {table[:, at].mean():.3f}, as others choose {held_out:.3f}"
    )


# --- trust ------------------------------------------------------------------------------


class Judged(NamedTuple):
    """n pictures: signs (n,k), F of their masks (n,), cameras (n,)."""

    signs: np.ndarray
    f: np.ndarray
    camera: np.ndarray


def choose_trust(root: Path, name: str, settings: dict[str, Any]) -> None:
    """Print the weights of the signs of trust, and their worth on cameras left out."""
    rows = []
    for camera, found, truth in pictures(root, load_detector(name, **settings)):
        f = float(torch.nan_to_num(f_measure(count_mask(found.mask, truth.road, truth.valid))))
        rows.append((signs_of(found.likelihood, found.mask, found.cues), f, camera))
    judged = Judged(*(np.array(column) for column in zip(*rows, strict=True)))
    expected = np.empty_like(judged.f)
    for camera in np.unique(judged.camera):
        mine = judged.camera == camera
        expected[mine] = fitted(judged, ~mine).predict(judged.signs[mine])
    many = ~np.isin(judged.camera, DRIVES)
    held_out, f = torch.from_numpy(expected[many]), torch.from_numpy(judged.f[many])
    within = correlation_within(Trusted(held_out, f, judged.camera[many].tolist()))
    error = float((held_out.clamp(0, 1) - f).abs().mean())
    print("on cameras left out, over the pictures of many:")
    print(f"rank correlation {rank_correlation(held_out, f):.3f}, within cameras {within:.3f},")
    print(f"ROC of F < {BAD} {failure_auc(held_out, f):.3f}, mean error {error:.3f}")
    model = fitted(judged, judged.f > -1)
    print("WEIGHTS", [round(float(weight), 2) for weight in model.coef_])
    print("CONSTANT", round(float(model.intercept_), 3))
    print("USUAL", judged.signs.mean(0).round(2).tolist())
    for number, sign in enumerate(Signs._fields):
        alone = rank_correlation(torch.from_numpy(judged.signs[many, number]), f)
        print(f"{sign} alone {alone:+.2f}")


def fitted(judged: Judged, chosen: np.ndarray) -> Ridge:
    """F by the signs of the chosen pictures; every camera weighs the square root of its size."""
    cameras = judged.camera[chosen]
    weight = [1 / np.sqrt((cameras == camera).sum()) for camera in cameras]
    return Ridge(alpha=0.05).fit(judged.signs[chosen], judged.f[chosen], sample_weight=weight)


CHOICES = {"pool": choose_pool, "trust": choose_trust, "threshold": choose_threshold}


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose what all cameras share.")
    parser.add_argument("what", choices=tuple(CHOICES))
    parser.add_argument("data", type=Path, help="the folder that holds many/ and camvid/")
    parser.add_argument("--detector", default="fusion")
    parser.add_argument("--weights", default="", help="of the detector's network, to be tried")
    given = parser.parse_args()
    torch.set_num_threads(1)
    settings = {"weights": {"file": given.weights}} if given.weights else {}
    CHOICES[given.what](given.data, given.detector, settings)


if __name__ == "__main__":
    main()
