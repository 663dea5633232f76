"""Choose the calibration of `fusion` and the weights of trust.

    python -m train.calibrate calibration DATA [--detector fusion:large] [--weights FILE]
    python -m train.calibrate trust DATA --worlds WORLDS [--detector fusion:large]
    python -m train.calibrate threshold DATA --detector layout:cnn-7

DATA contains ``many/`` and ``camvid/``. A camera is a folder of many/ or a drive of CamVid (every
fourth frame); all cameras count the same, and a camera is scored with what the others choose. IDD
is not used. ``calibration`` chooses ``calibration.centre`` by the mean F of masks at .5, and
``calibration.temperature`` by the cross-entropy of pixels. ``trust`` fits the weights of
``roadtorch.road.trust``, also on the kinds of rendered worlds that no network was trained on, among
them places without road. ``threshold`` is for detectors without a calibration.
"""

import argparse
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from sklearn.linear_model import LogisticRegression, Ridge
from torch import Tensor
from tqdm import tqdm

from roadtorch import Detection, load_detector
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.detectors.detector import Detector
from roadtorch.evaluation.metrics import (
    RoadCounts,
    confusion_at,
    count_levels,
    count_mask,
    f_measure,
)
from roadtorch.evaluation.trust_measures import (
    FAILURE_F,
    TrustSamples,
    failure_auc,
    mean_group_correlation,
    rank_correlation,
)
from roadtorch.road.trust import FULL_TRUST_PROBABILITY, TrustFeatures, trust_features
from train.worlds.plans import ROADLESS
from train.worlds.reader import read_world

CAMVID_STEP = 4
"""Step between the frames of CamVid."""

DRIVES = ("0001TP", "0006R0", "0016E5")
"""Drives of CamVid, cameras beside the folders of many/."""

EXCLUDED = ("india_zed",)
"""Folders of many/ that its README excludes from means."""

LEVELS = np.arange(-40, 40.01, 0.25)
"""Edges of the histograms of log odds."""


def detect_images(root: Path, detector: Detector) -> Iterator[tuple[str, Detection, Truth]]:
    """Yield camera, detection and truth of each image of many/ and every fourth of CamVid."""
    many, camvid = open_dataset("folder", root / "many"), open_dataset("camvid", root / "camvid")
    items = [(many, item) for item in many.items if item.group not in EXCLUDED]
    items += [(camvid, item) for item in camvid.items[::CAMVID_STEP]]
    for dataset, item in tqdm(items, disable=None):
        image, truth = dataset.read(item)
        yield str(item.group), detector.detect(image), truth


def detect_worlds(root: Path, detector: Detector) -> Iterator[tuple[str, Detection, Truth]]:
    """Yield the same for worlds of ``train.worlds``, whose kinds are the cameras."""
    for file in tqdm(sorted((root / "images").glob("*.jpg")), disable=None):
        image, truth = read_world(file)
        yield f"world {file.stem.split('_')[1]}", detector.detect(image), truth


# --- calibration ------------------------------------------------------------------------


def choose_calibration(root: Path, name: str, settings: dict[str, Any]) -> None:
    """Print the centre and temperature, and F of each camera at the centre the others choose."""
    plain = {"centre": 0.0, "temperature": 1.0}
    totals: dict[str, np.ndarray] = {}
    detector = load_detector(name, calibration=plain, **settings)
    for camera, detection, truth in detect_images(root, detector):
        totals[camera] = totals.get(camera, 0) + count_by_odds(detection, truth)
    counts = np.array(list(totals.values()))  # camera, 2, level
    table = f_by_level(counts)
    at = int(table.mean(0).argmax())
    print(
        f"centre {LEVELS[at]:+.2f} temperature {fit_temperature(counts, float(LEVELS[at])):.1f}: "
        f"F {table[:, at].mean():.4f} worst {table[:, at].min():.3f} "
        f"best of each {table.max(1).mean():.4f}; at centre 0 {table[:, LEVELS == 0].mean():.4f}"
    )
    for camera, f in zip(totals, cross_validated_f(table), strict=True):
        print(f"{camera:16} {f:.3f} as the others choose")


def count_by_odds(detection: Detection, truth: Truth) -> np.ndarray:
    """Count pixels by log odds, (2, levels + 1): road and background; ego pixels are lowest."""
    odds = torch.logit(detection.likelihood, eps=1e-7)
    return count_odds(torch.where(detection.cues["ego"], -torch.inf, odds), truth)


def count_odds(odds: Tensor, truth: Truth) -> np.ndarray:
    """Count pixels by log odds (H, W), (2, levels + 1): road and background."""
    edges = np.concatenate([[-np.inf], LEVELS, [np.inf]])
    parts = (truth.valid & truth.road, truth.valid & ~truth.road)
    return np.stack([np.histogram(odds[part].numpy(), edges)[0] for part in parts]).astype(float)


def f_by_level(counts: np.ndarray) -> np.ndarray:
    """Compute F (cameras, levels) of road at each level, by counts (cameras, 2, levels + 1)."""
    hits, alarms = counts[..., ::-1].cumsum(-1)[..., ::-1][..., 1:].swapaxes(0, 1)
    return 2 * hits / (hits + alarms + counts[:, 0].sum(-1)[:, None])


def cross_validated_f(table: np.ndarray) -> np.ndarray:
    """Return F of each camera (k,) at the level with the best mean over the others."""
    rows = range(len(table))
    return np.array([table[k, np.delete(table, k, 0).mean(0).argmax()] for k in rows])


def fit_temperature(counts: np.ndarray, centre: float) -> float:
    """Fit the temperature that divides log odds less ``centre``, by the least cross-entropy.

    counts: (cameras, 2, levels + 1); every camera counts the same.
    """
    fractions = (counts / counts.sum((1, 2), keepdims=True)).mean(0)[:, 1:-1]
    odds = (LEVELS[1:] + LEVELS[:-1]) / 2 - centre

    def loss(temperature: float) -> float:
        scaled = odds / temperature
        losses = np.logaddexp(0, [-scaled, scaled])
        return float((fractions[0] * losses[0] + fractions[1] * losses[1]).sum())

    return min(np.arange(0.5, 10.1, 0.1), key=loss)


# --- threshold --------------------------------------------------------------------------


def choose_threshold(root: Path, name: str, settings: dict[str, Any]) -> None:
    """Print the threshold with the best mean F over the cameras, and the held-out F."""
    totals: dict[str, RoadCounts] = {}
    for camera, detection, truth in detect_images(root, load_detector(name, **settings)):
        counts = count_levels(detection.likelihood, truth.road, truth.valid)
        totals[camera] = totals[camera] + counts if camera in totals else counts
    levels = np.arange(0.02, 1, 0.01)
    table = np.array(
        [[float(f_measure(confusion_at(c, t))) for t in levels] for c in totals.values()]
    )
    at = int(table.mean(0).argmax())
    held_out = cross_validated_f(table).mean()
    print(
        f"threshold {levels[at]:.2f}: F {table[:, at].mean():.3f}, as others choose {held_out:.3f}"
    )


# --- trust ------------------------------------------------------------------------------


class JudgedImages(NamedTuple):
    """n images: signs (n, k), F of their masks (n,), cameras (n,)."""

    signs: np.ndarray
    f: np.ndarray
    camera: np.ndarray


def choose_trust(root: Path, name: str, settings: dict[str, Any], worlds: Path) -> None:
    """Print the weights of the signs of trust, and their quality on held-out cameras.

    Images with an empty mask are left out.
    """
    rows, detector = [], load_detector(name, **settings)
    images = chain(detect_images(root, detector), detect_worlds(worlds, detector))
    for camera, detection, truth in images:
        f = float(torch.nan_to_num(f_measure(count_mask(detection.mask, truth.road, truth.valid))))
        if detection.mask.any():
            signs = trust_features(detection.likelihood, detection.mask, detection.cues["ego"])
            rows.append((signs, f, camera))
    judged = JudgedImages(*(np.array(column) for column in zip(*rows, strict=True)))
    rendered_rows = np.char.startswith(judged.camera, "world ")
    roadless = np.isin(judged.camera, [f"world {place}" for place in ROADLESS])
    expected = np.empty_like(judged.f)
    for camera in np.unique(judged.camera):
        members = judged.camera == camera
        signs, f_model = judged.signs[members], fit_f_model(judged, ~members & ~roadless)
        road_model = fit_road_model(judged, roadless, ~members)
        road = road_model.predict_proba(signs[:, ROAD_FEATURES])[:, 1]
        f = f_model.predict(signs[:, F_FEATURES]).clip(0, 1)
        expected[members] = f * (road / FULL_TRUST_PROBABILITY).clip(max=1)
    real = ~np.isin(judged.camera, DRIVES) & ~rendered_rows
    held_out, f = torch.from_numpy(expected[real]), torch.from_numpy(judged.f[real])
    within = mean_group_correlation(TrustSamples(held_out, f, judged.camera[real].tolist()))
    error = float((held_out.clamp(0, 1) - f).abs().mean())
    print("on cameras left out, over the images of many:")
    print(f"rank correlation {rank_correlation(held_out, f):.3f}, within cameras {within:.3f},")
    print(f"ROC of F < {FAILURE_F} {failure_auc(held_out, f):.3f}, mean error {error:.3f}")
    print(f"no road: {roadless.sum()} masks, trust below .3 of {(expected[roadless] < 0.3).sum()}")
    print(f"F above .8 and trust below .6: {((judged.f > 0.8) & (expected < 0.6))[real].sum()}")
    model, road_model = (
        fit_f_model(judged, ~roadless),
        fit_road_model(judged, roadless, judged.f > -1),
    )
    print(
        "FEATURE_WEIGHTS", [round(float(weight), 2) for weight in model.coef_], "and 0 of entropy"
    )
    print("INTERCEPT", round(float(model.intercept_), 3))
    print("MEAN_FEATURES", judged.signs[~rendered_rows].mean(0).round(2).tolist())
    print("ROAD_STABILITY, ROAD_ENTROPY", road_model.coef_[0].round(2))
    print("ROAD_INTERCEPT", road_model.intercept_)
    for number, sign in enumerate(TrustFeatures._fields):
        alone = rank_correlation(torch.from_numpy(judged.signs[real, number]), f)
        print(f"{sign} alone {alone:+.2f}")


ROAD_FEATURES, F_FEATURES = [0, 2], [0, 1]
"""Signs that predict whether there is a road, and those that predict F of its mask."""

ROADLESS_WEIGHT = 3.0
"""Weight of a place without road against a camera."""


def fit_road_model(
    judged: JudgedImages, roadless: np.ndarray, chosen: np.ndarray
) -> LogisticRegression:
    """Fit whether there is a road to the signs of the chosen images."""
    weight = camera_weights(judged.camera[chosen]) * np.where(roadless[chosen], ROADLESS_WEIGHT, 1)
    signs = judged.signs[chosen][:, ROAD_FEATURES]
    return LogisticRegression(C=10.0).fit(signs, ~roadless[chosen], sample_weight=weight)


def fit_f_model(judged: JudgedImages, chosen: np.ndarray) -> Ridge:
    """Fit F to the signs of the chosen images."""
    weight = camera_weights(judged.camera[chosen])
    signs = judged.signs[chosen][:, F_FEATURES]
    return Ridge(alpha=0.05).fit(signs, judged.f[chosen], sample_weight=weight)


def camera_weights(cameras: np.ndarray) -> np.ndarray:
    """Return weights such that a camera weighs the square root of its size."""
    return np.array([1 / np.sqrt((cameras == camera).sum()) for camera in cameras])


CHOICES = {"calibration": choose_calibration, "threshold": choose_threshold}


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose what all cameras share.")
    parser.add_argument("part", choices=(*CHOICES, "trust"))
    parser.add_argument("data", type=Path, help="the folder that holds many/ and camvid/")
    parser.add_argument("--detector", default="fusion")
    parser.add_argument("--weights", default="", help="of the detector's network, to be tried")
    parser.add_argument("--worlds", type=Path, help="that no network was trained on")
    options = parser.parse_args()
    torch.set_num_threads(1)
    settings = {"weights": {"file": options.weights}} if options.weights else {}
    if options.part == "trust":
        if options.worlds is None:
            parser.error("trust needs --worlds, some of them without any road")
        choose_trust(options.data, options.detector, settings, options.worlds)
    else:
        CHOICES[options.part](options.data, options.detector, settings)


if __name__ == "__main__":
    main()
