"""What is kept of a pass: sums by group, a few numbers of each picture; in a file, to go on from.

Sums have one size whatever the number of pictures. Of each picture its 8-bit histograms
stay (2 kB), for distributions, intervals and comparisons.
"""

import hashlib
import json
import math
import time
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from roadtorch.data.dataset import Dataset, Item
from roadtorch.errors import ConfigError
from roadtorch.evaluation import curves, metrics
from roadtorch.evaluation.methods import Method
from roadtorch.evaluation.metrics import Decisions, RoadCounts
from roadtorch.io.atomic import atomic
from roadtorch.layout.weights import tensors_hash

WHOLE = "all"  # the one group of a set that knows no groups
COARSE = 256  # levels that are kept of each picture
FIRST_ROWS = 64  # pictures that there is room for before a column grows


@dataclass(frozen=True)
class Score:
    """One detector's counts on one picture."""

    road: RoadCounts
    mask: Decisions
    boundary: Tensor  # int64 (tolerances,4), see boundary.py
    layout: Tensor | None  # confusion (4,4) of the strongest potentials
    labels: Tensor | None  # confusion (4,4) of labels that may abstain
    seconds: float  # for detect alone, as if nothing had been shared
    trust: float = math.nan  # the expected F of the mask; NaN where the detector does not say


@dataclass(frozen=True)
class Scored:
    """What came of one picture: a score for every detector, or why there is none."""

    item: Item
    scores: Mapping[str, Score]
    failure: str = ""


@dataclass(frozen=True)
class Pictures:
    """What is kept of n pictures: a row of every tensor is one of them."""

    names: Sequence[str]
    groups: Sequence[str]
    road: RoadCounts  # int32 (n,COARSE)
    outcomes: Tensor  # int64 (n,4), the fields of Decisions
    boundary: Tensor  # int64 (n,tolerances,4)
    layout: Tensor | None  # int64 (n,4,4)
    auc: Tensor  # float64 (n,), NaN without road or background
    max_f: Tensor  # float64 (n,), NaN without road
    seconds: Tensor  # float64 (n,)
    trust: Tensor  # float64 (n,), NaN where the detector does not say

    @property
    def mask(self) -> Decisions:
        """The outcomes of the masks, int64 (n,) each."""
        return Decisions(*self.outcomes.unbind(1))

    def of_group(self, group: str) -> Tensor:
        """Which of the pictures are of a group, bool (n,)."""
        return torch.tensor([name == group for name in self.groups], dtype=torch.bool)


@dataclass
class Tally:
    """One detector's counts so far: sums by kind and group, and columns with a row a picture.

    Kinds of sums: ``road`` (2,levels), ``mask`` (4,), ``boundary``, ``layout``, ``labels`` as a
    score has them, and ``curve``, the single pictures' ROC. Rows are written into a few large
    tensors that double when they are full: thousands of small ones between the large temporary
    ones of counting would keep their memory in use.
    """

    sums: dict[str, dict[str, Tensor]] = field(default_factory=dict)
    pictures: list[tuple[str, str]] = field(default_factory=list)  # name and group of each row
    columns: dict[str, Tensor] = field(default_factory=dict, repr=False)

    def add(self, item: Item, score: Score) -> None:
        """Count one more picture."""
        group, mask = item.group or WHOLE, score.mask
        outcome = (mask.true_positive, mask.false_positive, mask.false_negative, mask.true_negative)
        counts = {
            "road": torch.stack([score.road.road, score.road.other]),
            "mask": torch.stack(outcome),
            "boundary": score.boundary,
            "layout": score.layout,
            "labels": score.labels,
        }
        known = {kind: part for kind, part in counts.items() if part is not None}
        area, best = float(metrics.auc(score.road)), float(metrics.max_f(score.road)[0])
        curve = {} if math.isnan(area) else {"curve": curves.vertical_sample(score.road)}
        for kind, part in (known | curve).items():
            sums = self.sums.setdefault(kind, {})
            sums[group] = sums[group] + part if group in sums else part
        coarse = metrics.coarsen(score.road, COARSE)
        known["road"] = torch.stack([coarse.road, coarse.other]).to(torch.int32)
        numbers = [area, best, score.seconds, score.trust]
        known["numbers"] = torch.tensor(numbers, dtype=torch.float64)
        known.pop("labels", None)
        self._append(known)
        self.pictures.append((item.name, group))

    def _append(self, values: Mapping[str, Tensor]) -> None:
        row = len(self.pictures)
        for key in values.keys() - self.columns.keys():
            self.columns[key] = values[key].new_zeros((FIRST_ROWS, *values[key].shape))
        for key, column in self.columns.items():  # those as well that this picture has not
            while len(column) <= row:
                column = torch.cat([column, torch.zeros_like(column)])
            if key in values:
                column[row] = values[key]
            self.columns[key] = column

    @property
    def road(self) -> dict[str, RoadCounts]:
        """Pixels by likelihood level, by group."""
        return {group: RoadCounts(*counts) for group, counts in self.sums.get("road", {}).items()}

    def total(self, kind: str, groups: Iterable[str]) -> Tensor | None:
        """The sum of one kind over some groups; None where none of them has any."""
        of_kind = self.sums.get(kind, {})
        parts = [of_kind[group] for group in groups if group in of_kind]
        return sum(parts[1:], start=parts[0]) if parts else None

    def kept(self, groups: Iterable[str] | None = None) -> Pictures:
        """What is kept of some groups' pictures, group by group, or of all in their order."""
        places = range(len(self.pictures))
        if groups is not None:
            places = [i for group in groups for i in places if self.pictures[i][1] == group]
        return self._rows(places)

    def named(self, names: Container[str]) -> Pictures:
        """What is kept of the pictures of these names, in their order."""
        return self._rows([i for i, (name, _) in enumerate(self.pictures) if name in names])

    def _rows(self, places: Sequence[int]) -> Pictures:
        chosen = torch.tensor(list(places), dtype=torch.int64)
        columns = {key: column[chosen] for key, column in self.columns.items()}
        return Pictures(
            [self.pictures[i][0] for i in places],
            [self.pictures[i][1] for i in places],
            RoadCounts(*columns["road"].unbind(1)),
            columns["mask"],
            columns["boundary"],
            columns.get("layout"),
            *columns["numbers"].unbind(1),
        )

    def sort(self, names: Sequence[str]) -> None:
        """Bring the pictures into the order of ``names``."""
        place = {name: index for index, name in enumerate(names)}
        order = sorted(range(len(self.pictures)), key=lambda i: place[self.pictures[i][0]])
        self.pictures = [self.pictures[index] for index in order]
        self.columns = {key: column[order] for key, column in self.columns.items()}

    def tensors(self) -> dict[str, Tensor]:
        """All numbers as tensors by name: ``KIND/GROUP``, and ``rows/COLUMN``."""
        sums = {
            f"{kind}/{group}": part
            for kind, by_group in self.sums.items()
            for group, part in by_group.items()
        }
        rows = {f"rows/{key}": part[: len(self.pictures)] for key, part in self.columns.items()}
        return sums | rows

    @classmethod
    def of(cls, tensors: Mapping[str, Tensor], pictures: Sequence[Sequence[str]]) -> "Tally":
        """The tally that ``tensors`` took apart; pictures: name and group of its rows."""
        tally = cls(pictures=[(name, group) for name, group in pictures])
        for key, tensor in tensors.items():
            kind, _, name = key.partition("/")
            by_name = tally.columns if kind == "rows" else tally.sums.setdefault(kind, {})
            by_name[name] = tensor
        return tally


# --- a run that is interrupted goes on where it was: its counts so far, in one file --------

FILE = "progress.safetensors"
SAVE_EVERY = 20.0  # seconds of work that a power cut may cost, at least
SAVING = 0.05  # the share of the time that saving may take: hundreds of detectors are a gigabyte
REMEDY = "run it as before, or give another --out, or remove that file"


def fingerprint(dataset: Dataset, methods: Sequence[Method]) -> str:
    """What makes two runs the same: pictures, labels, detectors with settings, and our code."""
    files = [
        (item.name, item.group, *(_stamp(path) for path in (item.image, item.label)))
        for item in dataset.items
    ]
    code = sorted(Path(__file__).parents[1].rglob("*.py"))
    about = [(one.name, one.settings, one.threshold) for one in methods]
    groups = sorted(dataset.left_out)  # they teach prior:mean nothing
    parts = [dataset.name, dataset.split, files, groups, about, [_stamp(path) for path in code]]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _stamp(path: Path) -> tuple[str, int, int]:
    stat = path.stat() if path.exists() else None
    return str(path), stat.st_size if stat else -1, stat.st_mtime_ns if stat else -1


class SavedTallies:
    """The tallies of a run, saved now and then if there is a folder to save in."""

    def __init__(self, folder: Path | None, run: str) -> None:
        self.path = folder / FILE if folder else None
        self.run = run
        self.tallies: dict[str, Tally] = {}
        self._saved, self._pause = time.monotonic(), SAVE_EVERY
        if self.path and self.path.is_file():
            self.tallies = _load(self.path, run)

    def add(self, result: Scored) -> None:
        """Count one more picture, if it could be scored; save if the last time is a while ago."""
        for name, score in result.scores.items():
            self.tallies.setdefault(name, Tally()).add(result.item, score)
        if time.monotonic() - self._saved > self._pause:
            self.save()

    def sort(self, names: Sequence[str]) -> None:
        """Bring the pictures' rows into the order of the set, however the run came about."""
        for tally in self.tallies.values():
            tally.sort(names)

    @property
    def done(self) -> Collection[str]:
        """The names of the pictures that are counted."""
        first = next(iter(self.tallies.values()), Tally())
        return {name for name, _ in first.pictures}

    def save(self) -> None:
        """Write everything counted so far, whole or not at all."""
        if self.path is None or not self.tallies:
            return
        start = time.monotonic()
        tensors = {
            f"{index}/{key}": tensor.contiguous()
            for index, tally in enumerate(self.tallies.values())
            for key, tensor in tally.tensors().items()
        }
        pictures = next(iter(self.tallies.values())).pictures
        about = {"run": self.run, "detectors": list(self.tallies), "pictures": pictures}
        about["sha256"] = _digest(about, tensors)
        data = save(tensors, {"roadtorch": json.dumps(about)})
        with atomic(self.path) as temporary:
            temporary.write_bytes(data)
        self._saved = time.monotonic()
        self._pause = max(SAVE_EVERY, (self._saved - start) / SAVING)


def forget(folder: Path) -> None:
    """Remove what a run saved in a folder: its results are safe, and a new run starts anew."""
    (folder / FILE).unlink(missing_ok=True)


def _load(path: Path, run: str) -> dict[str, Tally]:
    """The tallies in a file of the same run.

    Raises ConfigError when it is of another one, or not the file that was saved.
    """
    try:
        with safe_open(path, "pt") as file:
            about = json.loads(file.metadata()["roadtorch"])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        if about["run"] != run:
            what = "holds the beginning of another run (other pictures, settings or code)"
            raise ConfigError(path, what, REMEDY)
        if about.pop("sha256") != _digest(about, tensors):
            raise ValueError("damaged")
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RecursionError):
        raise ConfigError(path, "is not the progress of a run, or damaged", REMEDY) from None
    by_detector: list[dict[str, Tensor]] = [{} for _ in about["detectors"]]
    for key, tensor in tensors.items():
        index, _, name = key.partition("/")
        by_detector[int(index)][name] = tensor
    return {
        name: Tally.of(own, about["pictures"])
        for name, own in zip(about["detectors"], by_detector, strict=True)
    }


def _digest(about: Mapping[str, Any], tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of all that a file says and counts."""
    text = json.dumps(about, sort_keys=True) + tensors_hash(tensors)
    return hashlib.sha256(text.encode()).hexdigest()
