"""Choose calibration and trust of fusion on many cameras, and tell what the choice is worth.

    python train/choose_many.py calibration DATA
    python train/choose_many.py trust DATA

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
from scipy.stats import rankdata
from sklearn.linear_model import Ridge
from sklearn.metrics import roc_auc_score
from tqdm import tqdm

from roadtorch import Detection, load_detector
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detector import Detector
from roadtorch.evaluation.metrics import count_mask, f_measure
from roadtorch.otsu import centred_odds
from roadtorch.trust import Signs, signs_of

EVERY = 4
"""Every how many-th frame of CamVid is used."""

TOO_FEW = ("india_zed",)
"""Folders that the set's own README leaves out of means."""

FAILED = 0.6
"""F below which a mask has failed."""

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


def choose_calibration(root: Path) -> None:
    """Print the best centre and share of Otsu's threshold, and each camera's F by the others'."""
    plain = {"centre": 0.0, "own": 0.0, "temperature": 1.0}
    detector = load_detector("fusion", calibration=plain)
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
        for centre in CENTRES:
            outcome = count_mask(
                (centred_odds(odds, float(centre), own) >= 0) & free, truth.road, truth.valid
            )
            rows.append([outcome.true_positive, outcome.false_positive, outcome.false_negative])
    return np.array(rows, dtype=float).T.reshape(3, len(OWNS), len(CENTRES))


# --- trust ------------------------------------------------------------------------------


class Judged(NamedTuple):
    """n pictures: signs (n,k), F of their masks (n,), cameras (n,)."""

    signs: np.ndarray
    f: np.ndarray
    camera: np.ndarray


def choose_trust(root: Path) -> None:
    """Print the weights of the signs of trust, and their worth on cameras left out."""
    judged = judge_all(root)
    expected = np.empty_like(judged.f)
    for camera in np.unique(judged.camera):
        mine = judged.camera == camera
        expected[mine] = _fit(judged, ~mine).predict(judged.signs[mine])
    many = ~np.isin(judged.camera, ("0001TP", "0006R0", "0016E5"))
    within = [
        _rank_correlation(expected[judged.camera == camera], judged.f[judged.camera == camera])
        for camera in np.unique(judged.camera[many])
    ]
    rank = _rank_correlation(expected[many], judged.f[many])
    failures = roc_auc_score(judged.f[many] < FAILED, -expected[many])
    error = np.abs(expected.clip(0, 1) - judged.f)[many].mean()
    print("on cameras left out, over the pictures of many:")
    print(f"rank correlation {rank:.3f}, within cameras {np.nanmean(within):.3f},")
    print(f"ROC of F < {FAILED} {failures:.3f}, mean error {error:.3f}")
    model = _fit(judged, judged.f > -1)
    print("WEIGHTS", [round(float(weight), 2) for weight in model.coef_])
    print("CONSTANT", round(float(model.intercept_), 3))
    print("USUAL", judged.signs.mean(0).round(2).tolist())
    for number, name in enumerate(Signs._fields):
        alone = _rank_correlation(judged.signs[many, number], judged.f[many])
        print(f"{name} alone {alone:+.2f}")


def judge_all(root: Path) -> Judged:
    """The signs and the F of every picture."""
    signs, f, cameras = [], [], []
    for camera, found, truth in pictures(root, load_detector("fusion")):
        of_mask = f_measure(count_mask(found.mask, truth.road, truth.valid))
        signs.append(signs_of(found.likelihood, found.mask, found.cues))
        f.append(float(torch.nan_to_num(of_mask)))
        cameras.append(camera)
    return Judged(np.array(signs), np.array(f), np.array(cameras))


def _rank_correlation(one: np.ndarray, other: np.ndarray) -> float:
    """Spearman's, of (n,) and (n,)."""
    return float(np.corrcoef(rankdata(one), rankdata(other))[0, 1])


def _fit(judged: Judged, chosen: np.ndarray) -> Ridge:
    """F by the signs of the chosen pictures; every camera weighs the square root of its size."""
    cameras = judged.camera[chosen]
    weight = [1 / np.sqrt((cameras == camera).sum()) for camera in cameras]
    return Ridge(alpha=0.05).fit(judged.signs[chosen], judged.f[chosen], sample_weight=weight)


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose calibration and trust on many cameras.")
    parser.add_argument("what", choices=("calibration", "trust"))
    parser.add_argument("data", type=Path, help="the folder that holds many/ and camvid/")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    {"calibration": choose_calibration, "trust": choose_trust}[arguments.what](arguments.data)


if __name__ == "__main__":
    main()
