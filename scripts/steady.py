"""What steadying likelihoods over time is worth: flicker and F with and without, cost, pictures.

    python scripts/steady.py report --data ../shared/data --cache steady
    python scripts/steady.py cost --threads 1
    python scripts/steady.py sheet camvid --data ../shared/data --cache steady --out camvid.jpg

Settings were chosen by train/study_steady.py on other drives. Intervals are of 95 %: rendered
drives are drawn anew, of CamVid stretches of ten frames. ``--set memory=2`` changes a setting.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for the scripts beside

from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.evaluation.uncertainty import (
    Figure,
    Replicated,
    difference,
    group_weights,
    interval,
    replicate,
)
from roadtorch.road.steady import Steady, SteadySettings
from roadtorch.scenes.street import render_scene
from roadtorch.settings import build_settings, parse_assignments
from scripts.steady_footage import (
    CLIPS,
    Figures,
    Footage,
    alone,
    every_footage,
    f_of,
    figures,
    motions,
    steadied,
    true_masks,
)

ALL = (*(f"drive{seed:02d}" for seed in range(4, 10)), "camvid", *CLIPS)
STRETCH = 10  # frames of CamVid that are drawn together
SEED = 11  # of the draws
TINT = {"road": (0, 160, 0), "too much": (0, 0, 200), "missed": (200, 0, 0)}  # blue, green, red


# --- report -----------------------------------------------------------------------------


def report(given: argparse.Namespace, settings: SteadySettings, detector: Detector) -> None:
    """Print the table."""
    together = ""
    print("| | frames | flicker of the truth | flicker | steadied | F | steadied | F gained |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    drives = []
    for seen in every_footage(given.names or ALL, given.data, given.cache, detector):
        pair, line = compared(seen, settings, detector)
        print(line, flush=True)
        if seen.name.startswith("drive"):
            drives.append(pair)
        elif seen.name == "camvid":
            together += f"\nCamVid: {told(stretches(pair))}"
    if drives:
        together += f"\ndrives together: {told(drives)}"
    print(together)


def compared(
    seen: Footage, settings: SteadySettings, detector: Detector
) -> tuple[tuple[Figures, Figures], str]:
    """The figures of a sequence without and with the filter, and their line of the table."""
    moved = motions(seen)
    plain = figures(seen, alone(seen, detector), moved)
    after = figures(seen, steadied(seen, settings, detector), moved)
    truth = true_masks(seen)
    floor = f"{figures(seen, truth, moved).flicker:.4f}" if truth else "–"
    scores = ["–", "–", "–"]
    if truth:
        scores = [f"{plain.f:.4f}", f"{after.f:.4f}", f"{after.f - plain.f:+.4f}"]
    cells = [seen.name, str(len(seen.images)), floor, f"{plain.flicker:.4f}"]
    ratio = f"{after.flicker:.4f} (×{after.flicker / plain.flicker:.2f})"
    return (plain, after), f"| {' | '.join([*cells, ratio, *scores])} |"


def stretches(pair: tuple[Figures, Figures]) -> list[tuple[Figures, Figures]]:
    """A sequence cut into stretches of frames, to be drawn anew one by one."""
    plain, after = pair
    count = len(plain.changes) // STRETCH
    return [(_stretch(plain, at), _stretch(after, at)) for at in range(count)]


def _stretch(one: Figures, at: int) -> Figures:
    rows = slice(at * STRETCH, (at + 1) * STRETCH)
    return Figures(None if one.outcome is None else one.outcome[rows], one.changes[rows])


def told(pairs: Sequence[tuple[Figures, Figures]]) -> str:
    """What F gains and what is left of the flicker, of parts that are drawn anew."""
    generator = torch.Generator().manual_seed(SEED)
    weights = group_weights([len(pairs)], generator)
    f = [replicate(_drawn([pair[which] for pair in pairs], _f), weights) for which in (0, 1)]
    left = [replicate(_drawn([pair[which] for pair in pairs], _rate), weights) for which in (0, 1)]
    gained = difference(f[1], f[0])
    ratio = Replicated(left[1].value / left[0].value, left[1].draws / left[0].draws)
    sizes = [f"{before.value:.4f} → {after.value:.4f}" for before, after in (f, left)]
    return (
        f"F {sizes[0]}, gained {gained.value:+.4f} ({ends(gained, '+.4f')}); "
        f"flicker {sizes[1]}, ×{ratio.value:.2f} ({ends(ratio, '.2f')})"
    )


def ends(figure: Replicated, form: str) -> str:
    """An interval in words."""
    low, high = interval(figure)
    return f"{low:{form}} to {high:{form}}"


def _drawn(parts: Sequence[Figures], of: Callable[[Tensor, Tensor], Tensor]) -> Figure:
    """The figure of parts' summed counts, as often as weights say."""
    outcomes = torch.stack([part.outcome.sum(0) for part in parts if part.outcome is not None])
    changes = torch.stack([part.changes.sum(0) for part in parts])
    return lambda weights: of(weights[0] @ outcomes, weights[0] @ changes)


def _f(outcome: Tensor, changes: Tensor) -> Tensor:
    return f_of(outcome)


def _rate(outcome: Tensor, changes: Tensor) -> Tensor:
    return changes[:, 0].to(torch.float64) / changes[:, 1]


# --- cost -------------------------------------------------------------------------------


def cost(given: argparse.Namespace, settings: SteadySettings, detector: Detector) -> None:
    """Print the milliseconds of one frame of 640×480, filter and detector in turn."""
    wide = render_scene(0, 480, 660, noise=0.01).image
    frames = [wide[..., shift : shift + 640].contiguous() for shift in (0, 4, 8, 12, 16)]
    likelihoods = [detector.detect(frame).likelihood for frame in frames]
    steady = Steady(settings)
    steady(frames[0], likelihoods[0])
    times: dict[str, list[float]] = {"filter": [], "fusion": []}
    for number in range(given.rounds):
        at = number % len(frames)
        for name, call in (
            ("filter", lambda at=at: steady(frames[at], likelihoods[at])),
            ("fusion", lambda at=at: detector.detect(frames[at])),
        ):
            start = time.perf_counter()
            call()
            times[name].append((time.perf_counter() - start) * 1000)
    for name, values in times.items():
        print(f"{name}: median {statistics.median(values):.1f} ms, fastest {min(values):.1f} ms")
    shares = [a / b for a, b in zip(times["filter"], times["fusion"], strict=True)]
    fastest = min(times["filter"]) / min(times["fusion"])
    print(f"share of fusion: median {statistics.median(shares):.1%}, fastest {fastest:.1%}")


# --- pictures ---------------------------------------------------------------------------


def sheet(given: argparse.Namespace, settings: SteadySettings, detector: Detector) -> None:
    """Write masks without (left) and with the filter (right), every 20th frame and the next."""
    seen = next(every_footage(given.names, given.data, given.cache, detector))
    masks = alone(seen, detector), steadied(seen, settings, detector)
    starts = range(given.every, len(seen.images) - 1, given.every)
    rows = [
        np.hstack([overlaid(seen, at, each[at]) for at in (start, start + 1) for each in masks])
        for start in starts
    ]
    cv2.imwrite(str(given.out), np.vstack(rows))


def overlaid(seen: Footage, number: int, mask: Tensor) -> np.ndarray:
    """A frame (h,w,3) BGR: road green, where the truth is known too much red, missed blue."""
    picture = np.ascontiguousarray(seen.images[number].permute(1, 2, 0).numpy()[..., ::-1])
    decided = mask.numpy()
    marks = {"road": decided}
    if seen.truth is not None:
        truth = seen.truth[number].numpy()
        marks |= {"too much": decided & (truth == 0), "missed": ~decided & (truth == 1)}
    for name, where in marks.items():
        picture[where] = (0.55 * picture[where] + 0.45 * np.array(TINT[name])).astype(np.uint8)
    return cv2.resize(picture, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("what", choices=["report", "cost", "sheet"])
    parser.add_argument("names", nargs="*", help="sequences (default: all that are reported)")
    parser.add_argument("--data", type=Path, help="the development data")
    parser.add_argument("--cache", type=Path, default=Path("steady"), help="for detections")
    parser.add_argument("--out", type=Path, default=Path("steady.jpg"))
    parser.add_argument("--every", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    cv2.setNumThreads(given.threads)
    settings = build_settings(SteadySettings, parse_assignments(given.set))
    work = {"report": report, "cost": cost, "sheet": sheet}[given.what]
    work(given, settings, load_detector("fusion"))


if __name__ == "__main__":
    main()
