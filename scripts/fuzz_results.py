"""Results of earlier runs for ``scripts/fuzz.py``: indexes, settings, maps, figures, progress."""

import random
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from roadtorch.data.dataset import Dataset, Item
from roadtorch.data.folder import FolderLabels
from roadtorch.data.maps import CONFIG, deciding_settings, map_likelihood, map_mask
from roadtorch.errors import ConfigError
from roadtorch.evaluation.contenders import Contender, named_detector
from roadtorch.evaluation.document import earlier_thresholds
from roadtorch.evaluation.saved_tallies import FILE, SavedTallies
from roadtorch.evaluation.scoring import score
from roadtorch.runs.index import Row, read_index, write_index
from roadtorch.runs.results import keep_config
from roadtorch.train.config import PatchTraining, as_values
from roadtorch.train.folder import RUN, RunFolder
from scripts.fuzz_bytes import BYTES, TEXT, mutated, mutated_json
from scripts.fuzz_pictures import resize
from scripts.fuzz_settings import told_of
from scripts.fuzz_weights import tampered_safetensors

SIZE = (4, 6)  # of the maps, in pixels
DETECTOR = "prior:rows"
RECORD: dict[str, Any] = {
    "roadtorch": "0.1.0",
    "config": as_values(PatchTraining()),
    "config_sha256": "0" * 64,
    "count": 0,
    "pictures": "0" * 64,
}

# --- infer ------------------------------------------------------------------------------


def make_index(folder: Path, draw: random.Random) -> Path:
    """An index.csv that was tampered with."""
    path = folder / "index.csv"
    rows = [Row("a.png", "64", "48", "12", "0.5", "0.81", saved="mask", method="ab", sha256="cd")]
    rows.append(Row("sub/b\nc.png", status="failed: sub/b: is empty (replace the file)"))
    write_index(path, rows)
    path.write_bytes(mutated(path.read_bytes(), draw, TEXT))
    return path


def read_rows(path: Path) -> bool:
    """Read it, and write what was read; whether every row has its file."""
    rows = read_index(path)
    write_index(path.with_name("again.csv"), rows.values())
    return all(row.file == file for file, row in rows.items())


def make_results(folder: Path, draw: random.Random) -> Path:
    """A folder of results whose config.toml was tampered with."""
    path = folder / CONFIG
    text = 'detector = "cpf"\nthreshold = 0.7\nisolated = "keep"\n\n[seed_area]\nheight = 0.2\n'
    path.write_bytes(mutated(text.encode(), draw, TEXT))
    write_index(folder / "index.csv", [])
    return path


def read_results(path: Path) -> bool:
    """Read how it decides; whether a run with other settings is kept out of it."""
    threshold = deciding_settings(path.parent).threshold
    try:
        keep_config(path.parent, "threshold = 0.123", overwrite=False)
    except ConfigError:
        return 0 <= threshold <= 1
    return False


def make_map(folder: Path, draw: random.Random) -> Path:
    """A map made elsewhere, as NumPy file or picture, that was tampered with."""
    values = np.linspace(0, 1, SIZE[0] * SIZE[1]).reshape(SIZE)
    path = folder / draw.choice(("a.npy", "a.npy", "a.png"))
    if path.suffix == ".npy":
        kind = draw.choice((np.float64, np.float32, np.float16, np.int32, np.complex64))
        np.save(path, values.astype(kind))
        mutations = (*BYTES, *TEXT)
    else:
        Image.fromarray((values * 255).astype(np.uint8)).save(path)
        mutations = (*BYTES, resize)
    path.write_bytes(mutated(path.read_bytes(), draw, mutations))
    return path


def read_likelihood(path: Path) -> bool:
    """Read and decide; whether the map is of its picture's size and in [0,1]."""
    likelihood = map_likelihood(path.parent, [path.stem], [SIZE])
    mask = map_mask(path.parent, [path.stem], likelihood, deciding_settings(path.parent))
    return mask.shape == likelihood.shape == SIZE and bool(likelihood.isfinite().all())


# --- evaluate ---------------------------------------------------------------------------


def _contenders() -> list[Contender]:
    return [named_detector(DETECTOR, {})]


def make_metrics(folder: Path, draw: random.Random) -> Path:
    """A metrics.json, as far as thresholds are read from it, that was tampered with."""
    settings = dict(_contenders()[0].settings)
    document = {"detectors": {DETECTOR: {"maxf_threshold": 0.61, "settings": settings}}}
    path = folder / "metrics.json"
    path.write_bytes(mutated_json(document, draw))
    return path


def read_thresholds(path: Path) -> bool:
    """Read the thresholds; whether they are in [0,1]."""
    return all(0 <= value <= 1 for value in earlier_thresholds(path, _contenders()).values())


@cache
def _progress(folder: Path) -> bytes:
    for name in ("images/a.png", "masks/a.png"):
        path = folder / "set" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (24, 18)).save(path)
    item = Item("a", folder / "set/images/a.png", folder / "set/masks/a.png")
    dataset = Dataset("folder", folder, "all", (item,), FolderLabels())
    saved = SavedTallies(folder / "set", "run")
    for result in score(dataset, _contenders()):
        told = {name: replace(one, seconds=0.01) for name, one in result.scores.items()}
        saved.add(replace(result, scores=told))
    saved.save()
    return (folder / "set" / FILE).read_bytes()


def make_progress(folder: Path, draw: random.Random) -> Path:
    """What an interrupted ``evaluate`` has counted, tampered with."""
    path = folder / FILE
    path.write_bytes(tampered_safetensors(_progress(folder.parent), draw))
    return path


def read_progress(path: Path) -> bool:
    """Go on with it; whether its pictures are those that were counted."""
    saved = SavedTallies(path.parent, "run")
    saved.sort(["a"])
    return saved.done == {"a"}


# --- train ------------------------------------------------------------------------------


def make_record(folder: Path, draw: random.Random) -> Path:
    """The record of a training that was tampered with."""
    path = folder / RUN
    path.write_bytes(mutated_json(RECORD, draw))
    return path


def read_record(path: Path) -> bool:
    """Begin a run where there is one; it is refused, as this one has other pictures."""
    told_of(path, lambda: RunFolder(path.parent).begin(RECORD["config"], [], None, resume=True))
    return False
