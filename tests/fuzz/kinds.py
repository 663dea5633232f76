"""Every kind of file that users give to the package: a mutated file, and its reader."""

import io
import json
import tempfile
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from hypothesis import strategies as st
from PIL import Image

from roadtorch.base.atomic import RESULTS_FILE
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.settings import INFER_CONFIG, build_settings, to_toml
from roadtorch.camera.birds_eye import warp_to_birds_eye
from roadtorch.camera.calibration import read_calibration, read_camera_info
from roadtorch.camera.camera import Camera, EgoTemplate
from roadtorch.cli.options import DetectorOptions
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.correction_formats import CORRECTION_FORMATS as IMPORTED
from roadtorch.data.corrections import Correction, read_log
from roadtorch.data.label_folders import add_conditions
from roadtorch.data.likelihood_maps import open_maps, read_decision_settings, read_map
from roadtorch.data.masks import read_masks
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.evaluation.methods import Contender, apply_thresholds, contender_from_name
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.layout.weights import load_network, save_network
from roadtorch.road.ego import Ego, ego_car, read_ego_mask
from roadtorch.run.ledger import IndexRow, open_ledger, read_index, write_index
from roadtorch.train.config import build_training
from tests.data.conftest import write
from tests.fuzz.mutations import (
    BYTE_MUTATIONS,
    IMAGE_MUTATIONS,
    TEXT_MUTATIONS,
    Draw,
    choose,
    encode_scene,
    mutate,
    mutate_json,
    mutate_safetensors,
    reads_image,
    write_file,
)

Make = Callable[[Draw, Path], bytes]

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
HEIGHT, WIDTH = 12, 16
SIZE = (4, 6)  # of maps, in pixels
DETECTOR = "prior:rows"


class Kind(NamedTuple):
    """A kind of file. make: returns the bytes, and writes companion files into the folder.

    read: reads the file, and returns whether the result is plausible.
    """

    name: str
    make: Make
    read: Callable[[Path], bool]

    def write(self, draw: Draw, folder: Path) -> Path:
        return write_file(folder / self.name, self.make(draw, folder))


def text_file(text: str) -> Make:
    return lambda draw, _: mutate(draw, text.encode(), TEXT_MUTATIONS)


def mutated_file(write: Callable[[Path], object], kinds: tuple[str, ...] = BYTE_MUTATIONS) -> Make:
    """Return a maker of mutated copies of a file that ``write`` writes."""
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder, "file"))
        data = Path(folder, "file").read_bytes()
    return lambda draw, _: mutate(draw, data, kinds)


def build_from(path: Path, build: Callable[[], object]) -> bool:
    """Build settings; add the name of the file to an error that names only their key."""
    try:
        build()
    except ConfigError as error:
        raise ConfigError(f"{path} {error.where}", error.problem, error.hint) from None
    return True


# --- weights --------------------------------------------------------------------------------

NETWORK = PatchNetwork(PatchNetworkSettings(topology=Topology(k1=6, potentials="softmax")))


def make_network(draw: Draw, folder: Path) -> bytes:
    path = folder / "whole.safetensors"
    save_network(path, NETWORK, {"config": {"seed": 3}})
    return mutate_safetensors(draw, path.read_bytes())


def read_network(path: Path) -> bool:
    values = load_network(path).state_dict().values()
    return all(bool(value.isfinite().all()) for value in values)


# --- settings -----------------------------------------------------------------------------


def make_config(draw: Draw, _: Path) -> bytes:
    """Make a config of a detector or of a training."""
    if draw(st.booleans()):
        data = choose(draw, *sorted(CONFIGS.glob("*.toml"))).read_bytes()
    else:
        entry = detector_entry(choose(draw, *list_detectors("*")))
        data = to_toml(entry.name, build_settings(entry.settings, {})).encode()
    return mutate(draw, data, TEXT_MUTATIONS)


def read_config(path: Path) -> bool:
    def build() -> object:
        name, values = DetectorOptions(config=path).name_and_values()
        if "kind" in values:
            return build_training(values)
        return build_settings(detector_entry(name).settings, values)

    return build_from(path, build)


ROWS = (0.9, 0.92, 0.95)
TEMPLATE = EgoTemplate(
    rows=ROWS, columns=ROWS, gradient_x=(0.1, -0.2, 0.3), gradient_y=(0.5, 0.1, 0.0)
)
OUTLINE = Ego(outline=(0.9, 0.8, 0.9))
CAMERA = Camera(
    width=64, height=48, frames=9, horizon=0.4, seed_row=0.9, ego=OUTLINE, template=TEMPLATE
)


def read_camera(path: Path) -> bool:
    camera, image = Camera.read(path), torch.rand(3, 48, 64)
    try:
        camera.check(image)
    except InputError:  # the image is not of that camera
        return True
    return not bool(ego_car(image, camera.ego).all())


# --- labels -------------------------------------------------------------------------------


def make_labels(draw: Draw, _: Path) -> bytes:
    """Make a label image of a user's data set, or an image of the ego car."""
    values, data = np.array([0, 255, 127], np.uint8)[np.arange(HEIGHT * WIDTH) % 3], io.BytesIO()
    mode = choose(draw, "L", "P", "RGB", "I;16", "1")
    Image.fromarray(values.reshape(HEIGHT, WIDTH)).convert(mode).save(data, "PNG")
    return mutate(draw, data.getvalue(), IMAGE_MUTATIONS)


def read_labels(path: Path) -> bool:
    write(path.parent / "images/label.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    images = {"label.png": path.parent / "images/label.png"}
    masks, _ = read_masks(path.parent, images, requires_road=False)
    truth = masks[0].truth
    return truth.road.shape == truth.valid.shape and truth.road.dtype == torch.bool


NUMBERS = (np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH) % 97 % 8).astype(np.uint8)
ROW = IndexRow("a.png", str(WIDTH), str(HEIGHT), status="done", saved="polygons")
CORRECTION = Correction(Path("a.png"), "a.png", NUMBERS, False, 0, 0, Path("log"))


def import_kind(name: str, file: str) -> Kind:
    """Return the kind of a label file of another program, as we export it."""

    def make(draw: Draw, folder: Path) -> bytes:
        IMPORTED[name].write([CORRECTION], folder)
        data = (folder / file).read_bytes()
        if file.endswith(".json") and choose(draw, 0, 1, 2):
            return mutate_json(draw, json.loads(data))
        return mutate(draw, data, TEXT_MUTATIONS)

    def read(path: Path) -> bool:
        labels = IMPORTED[name].read(path.parent, {"a.png": (HEIGHT, WIDTH)})
        return all(array.shape == (HEIGHT, WIDTH) and array.max() < 8 for array in labels.values())

    return Kind(file, make, read)


EVENTS = (
    {"image": "../a.png", "height": HEIGHT, "width": WIDTH},
    {
        "id": "a",
        "kind": "superpixel",
        "label": "road",
        "segments": [1],
        "counts": [0, 9, 40, HEIGHT * WIDTH - 49],
    },
    {"id": "b", "kind": "polygon", "label": "sky", "points": [[1, 1], [9, 1], [9, 8]]},
    {"id": "c", "kind": "brush", "label": "void", "points": [[3, 4]], "radius": 2.5},
    {"id": "d", "kind": "import", "labels": {"road": [5, 5, HEIGHT * WIDTH - 10]}},
    {"id": "e", "kind": "undo", "of": "b"},
    {"id": "f", "kind": "confirm", "counts": [7, HEIGHT * WIDTH - 7]},
)


def make_journal(draw: Draw, _: Path) -> bytes:
    """Make a log of corrections with one mutated event, perhaps truncated."""
    at = draw(st.integers(0, len(EVENTS) - 1))
    lines = [json.dumps(event).encode() for event in EVENTS]
    lines[at] = mutate_json(draw, EVENTS[at]).replace(b"\n", b" ")
    data = b"".join(line + b"\n" for line in lines)
    return data[: draw(st.integers(0, 2 * len(data)))]


def read_journal(path: Path) -> bool:
    log = read_log(path)
    return log is None or log.labels.max() < 8


CONDITIONS = 'file,place,condition\na.png,"a town, by the sea",day rain\nb.png,,night\n'


def read_conditions(path: Path) -> bool:
    for name in ("images/a", "masks/a", "images/b", "masks/b"):
        write(path.parent / "set" / f"{name}.png", np.zeros((18, 24), np.uint8))
    dataset = open_dataset("folder", path.parent / "set")
    return len(add_conditions(dataset, path).items) == len(dataset.items)


CALIBRATION = """P0: 1 2 3
P2: 7.2e+02 0 6.1e+02 4.5e+01 0 7.2e+02 1.7e+02 2.2e-01 0 0 1 2.7e-03
R0_rect: 1 0 0 0 1 0 0 0 1
Tr_cam_to_road: 1 0 0 0 0 1 0.02 -1.6 0 -0.02 1 0"""


def make_calibration(draw: Draw, _: Path) -> bytes:
    """Make a calibration in KITTI's format."""
    words = CALIBRATION.split(" ")
    if draw(st.booleans()):
        value = choose(draw, "1e308", "-1e308", "1e-320", "0", "1e40")
        words[draw(st.integers(0, len(words) - 1))] = value
    return mutate(draw, " ".join(words).encode(), TEXT_MUTATIONS)


def read_birds_eye(path: Path) -> bool:
    return warp_to_birds_eye(torch.rand(HEIGHT, WIDTH), read_calibration(path)).shape == (800, 400)


CAMERA_INFO = """image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320.5, 0, 510, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.3, 0.1, 0.001, -0.001, 0]}
"""


# --- results of earlier runs ----------------------------------------------------------------

INDEX = (
    IndexRow("a.png", "64", "48", "12", "0.5", "0.81", saved="mask", method="ab", sha256="cd"),
    IndexRow("sub/b\nc.png", status="failed: sub/b: is empty (replace the file)"),
)
RESULTS = 'detector = "cpf"\nthreshold = 0.7\nisolated = "keep"\n\n[seed_area]\nheight = 0.2\n'
MAP = np.linspace(0, 1, SIZE[0] * SIZE[1]).reshape(SIZE)


def read_rows(path: Path) -> bool:
    rows = read_index(path)
    write_index(path.with_name("again.csv"), rows.values())
    return all(row.file == file for file, row in rows.items())


def read_results(path: Path) -> bool:
    """Read the deciding settings of results; a run with other settings must be refused."""
    write_index(path.with_name("index.csv"), [ROW])
    claims = dict.fromkeys(("index.csv", path.name), "")
    path.with_name(RESULTS_FILE).write_text(json.dumps(claims))
    threshold = read_decision_settings(path.parent).threshold
    try:
        with open_ledger(path.parent, "threshold = 0.123"):
            return False
    except ConfigError:
        return 0 <= threshold <= 1


def make_map(draw: Draw, _: Path) -> bytes:
    """Make a map of another program, as NumPy file."""
    data = io.BytesIO()
    types = (np.float64, np.float32, np.float16, np.int32, np.complex64)
    np.save(data, MAP.astype(choose(draw, *types)))
    return mutate(draw, data.getvalue(), TEXT_MUTATIONS)


def read_maps(path: Path) -> bool:
    with warnings.catch_warnings(action="ignore"):  # it has few values
        maps = open_maps(path.parent, read_decision_settings(path.parent), [path])
    assert read_map(path, maps.white).ndim == 2
    likelihood = maps.read_likelihood([path.stem], [SIZE])
    mask = maps.read_mask([path.stem], likelihood)
    return mask.shape == likelihood.shape == SIZE and bool(likelihood.isfinite().all())


def prior_contenders() -> list[Contender]:
    return [contender_from_name(DETECTOR, {})]


def make_metrics(draw: Draw, _: Path) -> bytes:
    settings = dict(prior_contenders()[0].settings)
    document = {"detectors": {DETECTOR: {"maxf_threshold": 0.61, "settings": settings}}}
    return mutate_json(draw, document)


def read_thresholds(path: Path) -> bool:
    return all(
        0 <= (entry.earlier_threshold or 0) <= 1
        for entry in apply_thresholds(prior_contenders(), path)
    )


KINDS: Mapping[str, Kind] = {
    "images": Kind(
        "image.bin", lambda draw, _: mutate(draw, encode_scene(draw), IMAGE_MUTATIONS), reads_image
    ),
    "weights": Kind("net.safetensors", make_network, read_network),
    "configs": Kind("config.toml", make_config, read_config),
    "camera": Kind("camera.toml", mutated_file(CAMERA.write, TEXT_MUTATIONS), read_camera),
    "labels": Kind("label.png", make_labels, read_labels),
    "ego": Kind("ego.png", make_labels, lambda path: read_ego_mask(str(path)).dtype == torch.bool),
    "imported coco": import_kind("coco", "coco.json"),
    "journals": Kind("a.png.strokes.jsonl", make_journal, read_journal),
    "conditions": Kind("conditions.csv", text_file(CONDITIONS), read_conditions),
    "calibration": Kind("calib.txt", make_calibration, read_birds_eye),
    "camera info": Kind(
        "info.yaml", text_file(CAMERA_INFO), lambda path: read_camera_info(path).focal_x > 0
    ),
    "index": Kind(
        "index.csv", mutated_file(lambda path: write_index(path, INDEX), TEXT_MUTATIONS), read_rows
    ),
    "results": Kind(INFER_CONFIG, text_file(RESULTS), read_results),
    "maps": Kind("a.npy", make_map, read_maps),
    "map images": Kind(
        "a.png",
        mutated_file(
            lambda path: Image.fromarray((MAP * 255).astype(np.uint8)).save(path, "PNG"),
            IMAGE_MUTATIONS,
        ),
        read_maps,
    ),
    "metrics": Kind("metrics.json", make_metrics, read_thresholds),
}
