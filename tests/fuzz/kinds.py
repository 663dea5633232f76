"""Every kind of file that the package reads: one of ours that was tampered with, and its reader."""

import base64
import io
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from hypothesis import strategies as st
from PIL import Image

from roadtorch.camera.birds_eye import to_birds_eye
from roadtorch.camera.calibration import read_calibration
from roadtorch.camera.camera import Camera, EgoLook
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.conditions import with_conditions
from roadtorch.data.correction_formats import FORMATS as IMPORTED
from roadtorch.data.corrections import Correction
from roadtorch.data.dataset import Dataset, Item
from roadtorch.data.event_log import read_log
from roadtorch.data.folder import FolderLabels
from roadtorch.data.labelme import PolygonLabels
from roadtorch.data.maps import CONFIG, deciding_settings, map_likelihood, map_mask
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.errors import ConfigError, DatasetError, InputError
from roadtorch.evaluation import evaluate
from roadtorch.evaluation.document import earlier_thresholds
from roadtorch.evaluation.methods import Method, named_detector
from roadtorch.evaluation.scoring import score
from roadtorch.evaluation.tally import Tally
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.layout.weights import MAX_WEIGHT, load_network, save_network, shipped_weights
from roadtorch.road.ego import Ego, ego_car
from roadtorch.runs.folder import result_folder
from roadtorch.runs.index import Row, read_index, write_index
from roadtorch.runs.options import DetectorOptions, as_toml
from roadtorch.settings import build_settings, parse_assignments
from roadtorch.train.config import PatchTraining, as_values, build_training
from roadtorch.train.folder import CHECKPOINT, FORMAT, RUN, RunFolder
from roadtorch.train.prepared import read_arrays, write_arrays
from tests.data.conftest import write_png
from tests.fuzz.pictures import OF_PICTURES, make_picture, read_picture
from tests.fuzz.tampered import (
    OF_TEXT,
    PIECES,
    Draw,
    one_of,
    tampered,
    tampered_json,
    tampered_safetensors,
    written,
)

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
HEIGHT, WIDTH = 12, 16
SIZE = (4, 6)  # of maps, in pixels
DETECTOR = "prior:rows"


class Kind(NamedTuple):
    """make: writes a file and what belongs to it into a folder; read: whether it makes sense."""

    make: Callable[[Draw, Path], Path]
    read: Callable[[Path], bool]


def told_of(path: Path, build: Callable[[], object]) -> None:
    """Build settings; a refusal that names their key names their file too, as a user knows it."""
    try:
        build()
    except ConfigError as problem:
        raise ConfigError(f"{path} {problem.where}", problem.what, problem.remedy) from None


# --- weights, arrays, checkpoints -----------------------------------------------------------

NETWORKS = (
    PatchNetwork(PatchNetworkSettings(topology=Topology(k1=6, potentials="softmax"))),
    PictureNetwork(PictureNetworkSettings(height=40, width=48, narrow=8, wide=8)),
)


def make_network(draw: Draw, folder: Path) -> Path:
    """Small or shipped, with or without a card."""
    path = folder / "net.safetensors"
    shipped = one_of(draw, "", "", "", "cnn-7", "layout")
    if shipped:
        source = shipped_weights(shipped)
        path.write_bytes(source.read_bytes())
        if draw(st.booleans()):
            card = source.with_suffix(".md").read_bytes()
            path.with_suffix(".md").write_bytes(tampered(draw, card))
    else:
        save_network(path, one_of(draw, *NETWORKS), {"config": {"seed": 3}})
    return written(path, tampered_safetensors(draw, path.read_bytes()))


def read_network(path: Path) -> bool:
    values = load_network(path).state_dict().values()
    return all(bool((value.abs() <= MAX_WEIGHT).all()) for value in values)


def make_arrays(draw: Draw, folder: Path) -> Path:
    path = folder / "prepared.npz"
    write_arrays(path, {"image": torch.zeros(3, 9, 9, dtype=torch.uint8), "source": torch.ones(1)})
    return written(path, tampered(draw, path.read_bytes()))


def make_checkpoint(draw: Draw, folder: Path) -> Path:
    data = io.BytesIO()  # in a file its name would be part of the bytes
    torch.save({"format": FORMAT, "progress": {"epoch": 1}, "w": torch.ones(50)}, data)
    return written(folder / CHECKPOINT, tampered(draw, data.getvalue()))


def read_checkpoint(path: Path) -> bool:
    return isinstance(RunFolder(path.parent).read_checkpoint(), dict)


RECORD: dict[str, Any] = {
    "roadtorch": "0.1.0",
    "config": as_values(PatchTraining()),
    "config_sha256": "0" * 64,
    "count": 0,
    "pictures": "0" * 64,
}


def make_record(draw: Draw, folder: Path) -> Path:
    return written(folder / RUN, tampered_json(draw, RECORD))


def read_record(path: Path) -> bool:
    """Begin a run where there is one; it is refused, as this one has other pictures."""
    other = {**RECORD, "pictures": "1" * 64, "corrections": None}
    told_of(path, lambda: RunFolder(path.parent).check(other, resume=True))
    return False


# --- settings -----------------------------------------------------------------------------


def make_config(draw: Draw, folder: Path) -> Path:
    """Of a detector or of a training."""
    if draw(st.booleans()):
        data = one_of(draw, *sorted(CONFIGS.glob("*.toml"))).read_bytes()
    else:
        entry = detector_entry(one_of(draw, *list_detectors("*")))
        data = as_toml(entry.name, build_settings(entry.settings, {})).encode()
    return written(folder / "config.toml", tampered(draw, data, OF_TEXT))


def read_config(path: Path) -> bool:
    def build() -> object:
        name, values = DetectorOptions(config=path).named()
        if "kind" in values:
            return build_training(values)
        return build_settings(detector_entry(name).settings, values)

    told_of(path, build)
    return True


def make_assignments(draw: Draw, folder: Path) -> Path:
    """Texts of ``--set``, one a line."""
    keys = ("threshold", "texture.bins", "ego.bottom", "ego.outline", "seed_area.height", "x.y")
    texts = [one_of(draw, *keys).encode() + b"=" + draw(PIECES) for _ in range(3)]
    data = b"\n".join([*texts, b"threshold=0.5", b"ego.outline=[0.9, 1]"])
    return written(folder / "sets.txt", tampered(draw, data, OF_TEXT))


def read_assignments(path: Path) -> bool:
    texts = path.read_bytes().decode("utf-8", "surrogateescape").split("\n")
    told_of(path, lambda: build_settings(detector_entry("cpf").settings, parse_assignments(texts)))
    return True


def make_camera(draw: Draw, folder: Path) -> Path:
    path, rows = folder / "camera.toml", (0.9, 0.92, 0.95)
    look = EgoLook(rows=rows, columns=rows, across=(0.1, -0.2, 0.3), down=(0.5, 0.1, 0.0))
    ego = Ego(outline=(0.9, 0.8, 0.9))
    camera = Camera(width=64, height=48, frames=9, horizon=0.4, seed_row=0.9, ego=ego, look=look)
    camera.write(path)
    return written(path, tampered(draw, path.read_bytes(), OF_TEXT))


def read_camera(path: Path) -> bool:
    camera, image = Camera.read(path), torch.rand(3, 48, 64)
    try:
        camera.check(image)
    except InputError:  # of the picture: it is not of that camera
        return True
    return not bool(ego_car(image, camera.ego).all())


# --- labels -------------------------------------------------------------------------------


def make_labelme(draw: Draw, folder: Path) -> Path:
    """JSON beside its picture, with a mask inside."""
    Image.new("RGB", (WIDTH, HEIGHT)).save(folder / "a.png")
    data = io.BytesIO()
    kind = one_of(draw, "PNG", "PNG", "JPEG", "GIF", "TIFF", "EPS")
    Image.new("L", (4, 3), 255).save(data, kind)
    mask = data.getvalue()
    mask = tampered(draw, mask, OF_PICTURES) if one_of(draw, 0, 1, 2) else mask
    shapes = [
        ([[1, 1], [9, 1], [9, 8]], "polygon", {}),
        ([[2, 3], [9, 8]], "rectangle", {}),
        ([[5, 5], [7, 7]], "circle", {}),
        ([[3, 3], [6, 5]], "mask", {"mask": base64.b64encode(mask).decode()}),
        ([[1, 1]], "point", {}),
    ]
    drawn = [
        {"label": "road", "points": points, "shape_type": name, "group_id": None, **more}
        for points, name, more in draw(st.lists(st.sampled_from(shapes), min_size=1, max_size=5))
    ]
    document = {"version": "5.5.0", "shapes": drawn, "imageHeight": HEIGHT, "imageWidth": WIDTH}
    return written(folder / "a.json", tampered_json(draw, document))


def make_xml(draw: Draw, folder: Path) -> Path:
    """LabelMe's XML beside its picture."""
    Image.new("RGB", (WIDTH, HEIGHT)).save(folder / "a.png")
    corners = "\n".join(f"<pt><x>{x}</x><y>{y}</y></pt>" for x, y in ((2, 3), (9, 3), (9, 8)))
    polygon = f"<polygon>\n<username>anna</username>\n{corners}\n</polygon>"
    parts = f"<object>\n<name>road</name>\n<deleted>0</deleted>\n{polygon}\n</object>"
    size = f"<imagesize><nrows>{HEIGHT}</nrows><ncols>{WIDTH}</ncols></imagesize>"
    text = f"<?xml version='1.0' encoding='utf-8'?>\n<annotation>\n{size}\n{parts}\n</annotation>"
    return written(folder / "a.xml", tampered(draw, text.encode(), OF_TEXT))


def read_truth(path: Path) -> bool:
    truth = PolygonLabels().truth(Item("a", path.parent / "a.png", path))
    return truth.road.shape == truth.valid.shape == (HEIGHT, WIDTH)


def make_labels(draw: Draw, folder: Path) -> Path:
    """A label picture of a set of one's own."""
    values, data = np.array([0, 255, 127], np.uint8)[np.arange(HEIGHT * WIDTH) % 3], io.BytesIO()
    mode = one_of(draw, "L", "P", "RGB", "I;16", "1")
    Image.fromarray(values.reshape(HEIGHT, WIDTH)).convert(mode).save(data, "PNG")
    return written(folder / "label.png", tampered(draw, data.getvalue(), OF_PICTURES))


def read_labels(path: Path) -> bool:
    truth = FolderLabels().truth(Item("a", path, path))
    return truth.road.shape == truth.valid.shape and truth.road.dtype == torch.bool


NUMBERS = (np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 97 % 8).astype(np.uint8)
SAID = Correction(Path("a.png"), "a.png", NUMBERS, False, (), 0, 0)
IMPORTS = {
    "label-studio": "tasks.json",
    "cvat": "labelmap.txt",
    "xml": "a.xml",
    "labelme": "a.json",
}


def make_import(draw: Draw, folder: Path) -> Path:
    """An export of ours for one of the programs."""
    name = one_of(draw, *IMPORTS)
    IMPORTED[name].write([SAID], folder)
    path = folder / IMPORTS[name]
    if path.suffix == ".json" and one_of(draw, 0, 1, 2):
        return written(path, tampered_json(draw, json.loads(path.read_bytes())))
    return written(path, tampered(draw, path.read_bytes(), OF_TEXT))


def read_import(path: Path) -> bool:
    name = {file: name for name, file in IMPORTS.items()}[path.name]
    try:
        found = IMPORTED[name].read(path.parent, {"a.png": (HEIGHT, WIDTH)})
    except DatasetError as problem:
        if path.name == "labelmap.txt" and "a.png" in str(problem):
            return True  # a class of the picture that the file does not name by now
        raise
    return all(one.shape == (HEIGHT, WIDTH) and one.max() < 8 for one in found.values())


def make_journal(draw: Draw, folder: Path) -> Path:
    """A log of what one person did."""
    lines = [
        {"picture": "../a.png", "user": "ann", "height": HEIGHT, "width": WIDTH},
        {"id": "a", "kind": "superpixel", "saying": "road", "segments": [1], "runs": [0, 9, 40, 3]},
        {"id": "b", "kind": "polygon", "saying": "sky", "points": [[1, 1], [9, 1], [9, 8]]},
        {"id": "c", "kind": "brush", "saying": "void", "points": [[3, 4]], "radius": 2.5},
        {"id": "d", "kind": "brought", "labels": {"road": [5, 5], "untouched": [90, 2]}},
        {"id": "e", "kind": "undo", "of": "b"},
        {"id": "f", "kind": "right", "runs": [7, 70]},
    ]
    at = draw(st.integers(0, len(lines) - 1))
    texts = [json.dumps(line).encode() for line in lines]
    texts[at] = tampered_json(draw, lines[at]).replace(b"\n", b" ")
    data = b"".join(text + b"\n" for text in texts)
    return written(folder / "a.png.ann.strokes.jsonl", data[: draw(st.integers(0, 2 * len(data)))])


def read_journal(path: Path) -> bool:
    log = read_log(path)
    return log is None or log.labels.max() < 8


def make_conditions(draw: Draw, folder: Path) -> Path:
    """A table of the conditions of a set of two pictures."""
    write_set(folder / "set", "a", "b")
    text = 'file,place,condition\na.png,"a town, by the sea",day rain\nb.png,,night\n'
    return written(folder / "conditions.csv", tampered(draw, text.encode(), OF_TEXT))


def write_set(folder: Path, *names: str) -> None:
    for name in names:
        for part in ("images", "masks"):
            write_png(folder / part / f"{name}.png", np.zeros((18, 24), np.uint8))


def read_conditions(path: Path) -> bool:
    dataset = open_dataset("folder", path.parent / "set")
    return len(with_conditions(dataset, path).items) == len(dataset.items)


def make_calibration(draw: Draw, folder: Path) -> Path:
    """In KITTI's form."""
    rows = {
        "P2": "7.2e+02 0 6.1e+02 4.5e+01 0 7.2e+02 1.7e+02 2.2e-01 0 0 1 2.7e-03",
        "R0_rect": "1 0 0 0 1 0 0 0 1",
        "Tr_cam_to_road": "1 0 0 0 0 1 0.02 -1.6 0 -0.02 1 0",
    }
    words = "\n".join(["P0: 1 2 3", *(f"{name}: {row}" for name, row in rows.items())]).split(" ")
    if draw(st.booleans()):
        value = one_of(draw, "1e308", "-1e308", "1e-320", "0", "1e40")
        words[draw(st.integers(0, len(words) - 1))] = value
    return written(folder / "calib.txt", tampered(draw, " ".join(words).encode(), OF_TEXT))


def read_from_above(path: Path) -> bool:
    return to_birds_eye(torch.rand(HEIGHT, WIDTH), read_calibration(path)).shape == (800, 400)


# --- results of earlier runs ----------------------------------------------------------------


def make_index(draw: Draw, folder: Path) -> Path:
    path = folder / "index.csv"
    rows = [Row("a.png", "64", "48", "12", "0.5", "0.81", saved="mask", method="ab", sha256="cd")]
    rows.append(Row("sub/b\nc.png", status="failed: sub/b: is empty (replace the file)"))
    write_index(path, rows)
    return written(path, tampered(draw, path.read_bytes(), OF_TEXT))


def read_rows(path: Path) -> bool:
    rows = read_index(path)
    write_index(path.with_name("again.csv"), rows.values())
    return all(row.file == file for file, row in rows.items())


def make_results(draw: Draw, folder: Path) -> Path:
    """The config.toml of a folder of results."""
    write_index(folder / "index.csv", [])
    text = 'detector = "cpf"\nthreshold = 0.7\nisolated = "keep"\n\n[seed_area]\nheight = 0.2\n'
    return written(folder / CONFIG, tampered(draw, text.encode(), OF_TEXT))


def read_results(path: Path) -> bool:
    """How it decides; and that a run with other settings is kept out of it."""
    threshold = deciding_settings(path.parent).threshold
    try:
        with result_folder(path.parent, "threshold = 0.123", overwrite=False):
            return False
    except ConfigError:
        return 0 <= threshold <= 1


def make_map(draw: Draw, folder: Path) -> Path:
    """A map made elsewhere, as NumPy file or picture."""
    values = np.linspace(0, 1, SIZE[0] * SIZE[1]).reshape(SIZE)
    path, kinds = folder / one_of(draw, "a.npy", "a.npy", "a.png"), OF_PICTURES
    if path.suffix == ".npy":
        types = (np.float64, np.float32, np.float16, np.int32, np.complex64)
        np.save(path, values.astype(one_of(draw, *types)))
        kinds = OF_TEXT
    else:
        Image.fromarray((values * 255).astype(np.uint8)).save(path)
    return written(path, tampered(draw, path.read_bytes(), kinds))


def read_map(path: Path) -> bool:
    likelihood = map_likelihood(path.parent, [path.stem], [SIZE])
    mask = map_mask(path.parent, [path.stem], likelihood, deciding_settings(path.parent))
    return mask.shape == likelihood.shape == SIZE and bool(likelihood.isfinite().all())


def methods() -> list[Method]:
    return [named_detector(DETECTOR, {})]


def make_metrics(draw: Draw, folder: Path) -> Path:
    settings = dict(methods()[0].settings)
    document = {"detectors": {DETECTOR: {"maxf_threshold": 0.61, "settings": settings}}}
    return written(folder / "metrics.json", tampered_json(draw, document))


def read_thresholds(path: Path) -> bool:
    return all(0 <= value <= 1 for value in earlier_thresholds(path, methods()).values())


def make_progress(draw: Draw, folder: Path) -> Path:
    """What an interrupted ``evaluate`` has counted."""
    write_set(folder, "a")
    item = Item("a", folder / "images/a.png", folder / "masks/a.png")
    tally, path = Tally(), folder / evaluate.FILE
    for result in score(Dataset("folder", folder, "all", (item,), FolderLabels()), methods()):
        tally.add(item, replace(result.scores[DETECTOR], seconds=0.01))
    evaluate.write_progress(path, "run", {DETECTOR: tally})
    return written(path, tampered(draw, path.read_bytes()))


def read_progress(path: Path) -> bool:
    tally = evaluate.read_progress(path, "run")[DETECTOR]
    tally.sort(["a"])
    return [name for name, _ in tally.pictures] == ["a"]


KINDS: Mapping[str, Kind] = {
    "pictures": Kind(make_picture, read_picture),
    "weights": Kind(make_network, read_network),
    "arrays": Kind(make_arrays, lambda path: read_arrays(path) is not None),
    "checkpoints": Kind(make_checkpoint, read_checkpoint),
    "records": Kind(make_record, read_record),
    "configs": Kind(make_config, read_config),
    "sets": Kind(make_assignments, read_assignments),
    "camera": Kind(make_camera, read_camera),
    "labelme": Kind(make_labelme, read_truth),
    "xml": Kind(make_xml, read_truth),
    "labels": Kind(make_labels, read_labels),
    "imports": Kind(make_import, read_import),
    "journals": Kind(make_journal, read_journal),
    "conditions": Kind(make_conditions, read_conditions),
    "calibration": Kind(make_calibration, read_from_above),
    "index": Kind(make_index, read_rows),
    "results": Kind(make_results, read_results),
    "maps": Kind(make_map, read_map),
    "metrics": Kind(make_metrics, read_thresholds),
    "progress": Kind(make_progress, read_progress),
}
