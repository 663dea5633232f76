"""Choose what many cameras share, and tell what the choice is worth.

    python train/choose_many.py calibration DATA
    python train/choose_many.py thresholds DATA
    python train/choose_many.py trust DATA
    python train/choose_many.py ego DATA     (how often it is found, and what road it takes)

``--detector fusion:research`` chooses for it instead of `fusion`.
DATA holds ``many/`` and ``camvid/``. A camera is a folder of many/ or a drive of CamVid (every
fourth frame); each counts the same. What is told of a camera was chosen on the others; IDD has
no part in it. Masks are those of the threshold alone: isolated regions stay.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from sklearn.linear_model import Ridge
from tqdm import tqdm

from roadtorch import Detection, load_detector
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detector import Detector
from roadtorch.evaluation.measure import Trusted
from roadtorch.evaluation.metrics import (
    RoadCounts,
    count_levels,
    count_mask,
    decisions_at,
    f_measure,
)
from roadtorch.evaluation.trust import (
    BAD,
    correlation_within,
    failure_auc,
    rank_correlation,
)
from roadtorch.road.fusion import centred_odds
from roadtorch.road.trust import Signs, signs_of

EVERY = 4
"""Every how many-th frame of CamVid is used."""

TOO_FEW = ("india_zed",)
"""Folders that the set's own README leaves out of means."""

LOST = 0.02
"""Share of the true road above which an ego car takes some."""

DRIVES = ("0001TP", "0006R0", "0016E5")
"""CamVid's, beside the folders of many/."""

UNCALIBRATED = ("layout", "layout:research", "fusion:untrained", "labeller")
THRESHOLDS = (0.2, 0.3, 0.39, 0.5, 0.7, 0.82, 0.87, 0.92, 0.95, 0.97, 0.99)

CENTRES = np.arange(-4, 1.01, 0.25)
OWNS = (0.0, 0.25, 0.5, 0.75, 1.0)


def pictures(root: Path, detector: Detector) -> Iterator[tuple[str, Detection, Truth]]:
    """Camera, detection and truth of every picture of many/ and every fourth of CamVid."""
    many, camvid = open_dataset("folder", root / "many"), open_dataset("camvid", root / "camvid")
    items = [(many, item) for item in many.items if item.group not in TOO_FEW]
    items += [(camvid, item) for item in camvid.items[::EVERY]]
    for dataset, item in tqdm(items, disable=None):
        image, truth = dataset.read(item)
        yield str(item.group), detector.detect(image), truth


# --- calibration ------------------------------------------------------------------------


def choose_calibration(root: Path, name: str) -> None:
    """Print the best centre and share of Otsu's threshold, and each camera's F by the others'."""
    plain = {"centre": 0.0, "own": 0.0, "temperature": 1.0}
    detector = load_detector(name, calibration=plain)
    counts: dict[str, np.ndarray] = {}
    for camera, found, truth in pictures(root, detector):
        counts[camera] = counts.get(camera, 0) + _outcomes(found, truth)
    f = {camera: 2 * c[0] / np.maximum(2 * c[0] + c[1] + c[2], 1) for camera, c in counts.items()}
    table = np.stack(list(f.values()))  # camera, own, centre
    for number, camera in enumerate(f):
        others = np.delete(table, number, 0).mean(0)
        at = np.unravel_index(others.argmax(), others.shape)
        own, centre = OWNS[at[0]], CENTRES[at[1]]
        print(f"{camera:16} {table[number][at]:.3f} at own {own:.2f} centre {centre:+.2f}")
    for number, own in enumerate(OWNS):
        at = int(table[:, number].mean(0).argmax())
        worth = table[:, number, at]
        print(
            f"own {own:.2f} centre {CENTRES[at]:+.2f}: {worth.mean():.4f} worst {worth.min():.3f}"
        )


def _outcomes(found: Detection, truth: Truth) -> np.ndarray:
    """(3, owns, centres): true positives, false positives, false negatives."""
    odds = torch.logit(found.likelihood, eps=1e-6)
    free = ~found.cues["ego"]
    rows = []
    for own in OWNS:
        centred = centred_odds(odds, 0.0, own)  # Otsu's once; the rest of the centre is its share
        for centre in CENTRES:
            mask = (centred >= (1 - own) * float(centre)) & free
            outcome = count_mask(mask, truth.road, truth.valid)
            rows.append([outcome.true_positive, outcome.false_positive, outcome.false_negative])
    return np.array(rows, dtype=float).T.reshape(3, len(OWNS), len(CENTRES))


# --- thresholds -------------------------------------------------------------------------


def choose_thresholds(root: Path, only: str) -> None:
    """Print the mean F of those without a calibration, by threshold: all cameras, CamVid alone."""
    for name in [only] if only in UNCALIBRATED else UNCALIBRATED:
        levels: dict[str, RoadCounts] = {}
        for camera, found, truth in pictures(root, load_detector(name)):
            counts = count_levels(found.likelihood, truth.road, truth.valid)
            levels[camera] = levels[camera] + counts if camera in levels else counts
        for threshold in THRESHOLDS:
            f = {
                camera: float(f_measure(decisions_at(counts, threshold)))
                for camera, counts in levels.items()
            }
            drives = np.mean([f[camera] for camera in DRIVES])
            print(f"{name} at {threshold}: {np.mean(list(f.values())):.3f}, CamVid {drives:.3f}")


# --- trust ------------------------------------------------------------------------------


class Judged(NamedTuple):
    """n pictures: signs (n,k), F of their masks (n,), cameras (n,)."""

    signs: np.ndarray
    f: np.ndarray
    camera: np.ndarray


def choose_trust(root: Path, name: str) -> None:
    """Print the weights of the signs of trust, and their worth on cameras left out."""
    judged = judge_all(root, name)
    expected = np.empty_like(judged.f)
    for camera in np.unique(judged.camera):
        mine = judged.camera == camera
        expected[mine] = _fit(judged, ~mine).predict(judged.signs[mine])
    many = ~np.isin(judged.camera, DRIVES)
    held_out, f = torch.from_numpy(expected[many]), torch.from_numpy(judged.f[many])
    within = correlation_within(Trusted(held_out, f, judged.camera[many].tolist()))
    error = float((held_out.clamp(0, 1) - f).abs().mean())
    print("on cameras left out, over the pictures of many:")
    print(f"rank correlation {rank_correlation(held_out, f):.3f}, within cameras {within:.3f},")
    print(f"ROC of F < {BAD} {failure_auc(held_out, f):.3f}, mean error {error:.3f}")
    model = _fit(judged, judged.f > -1)
    print("WEIGHTS", [round(float(weight), 2) for weight in model.coef_])
    print("CONSTANT", round(float(model.intercept_), 3))
    print("USUAL", judged.signs.mean(0).round(2).tolist())
    for number, sign in enumerate(Signs._fields):
        alone = rank_correlation(torch.from_numpy(judged.signs[many, number]), f)
        print(f"{sign} alone {alone:+.2f}")


def judge_all(root: Path, name: str) -> Judged:
    """The signs and the F of every picture."""
    signs, f, cameras = [], [], []
    for camera, found, truth in pictures(root, load_detector(name)):
        of_mask = f_measure(count_mask(found.mask, truth.road, truth.valid))
        signs.append(signs_of(found.likelihood, found.mask, found.cues))
        f.append(float(torch.nan_to_num(of_mask)))
        cameras.append(camera)
    return Judged(np.array(signs), np.array(f), np.array(cameras))


def _fit(judged: Judged, chosen: np.ndarray) -> Ridge:
    """F by the signs of the chosen pictures; every camera weighs the square root of its size."""
    cameras = judged.camera[chosen]
    weight = [1 / np.sqrt((cameras == camera).sum()) for camera in cameras]
    return Ridge(alpha=0.05).fit(judged.signs[chosen], judged.f[chosen], sample_weight=weight)


# --- ego car ----------------------------------------------------------------------------


def count_ego_cars(root: Path, name: str) -> None:
    """Print in how many pictures of each camera an ego car is found, and takes true road."""
    counts: dict[str, np.ndarray] = {}
    for camera, found, truth in pictures(root, load_detector(name)):
        ego, road = found.cues["ego"], truth.road & truth.valid
        lost = int((ego & road).sum()) > LOST * int(road.sum())
        counts[camera] = counts.get(camera, 0) + np.array([1, bool(ego.any()), lost])
    for camera, (number, with_ego, lossy) in counts.items():
        print(f"{camera:16} {with_ego} of {number}, takes more than {LOST:.0%} of road in {lossy}")


CHOICES = {
    "calibration": choose_calibration,
    "thresholds": choose_thresholds,
    "trust": choose_trust,
    "ego": count_ego_cars,
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose what many cameras share.")
    parser.add_argument("what", choices=tuple(CHOICES))
    parser.add_argument("data", type=Path, help="the folder that holds many/ and camvid/")
    parser.add_argument("--detector", default="fusion")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    CHOICES[arguments.what](arguments.data, arguments.detector)


if __name__ == "__main__":
    main()
