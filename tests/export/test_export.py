"""Exported files: what they say, what they say about themselves, and what is refused."""

import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import roadtorch.export.export as export_module
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError, InputError
from roadtorch.export.export import BOUND, Exported, export_detector, exportable, parity
from roadtorch.export.files import open_onnx, open_openvino
from roadtorch.io.atomic import digest_of
from roadtorch.io.image import read_image, to_pixels
from roadtorch.layout.weights import shipped_weights
from roadtorch.testing import street
from tests.networks import write_ego_network

onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
openvino = pytest.importorskip("openvino", reason="the extra openvino is not installed")
for package in ("onnxscript", "onnxruntime"):
    pytest.importorskip(package, reason="the extra onnx is not installed")

ROOT = Path(__file__).parents[2]
SIZES = ((16, 16), (33, 200), (131, 77), (240, 320))


def pictures(height: int, width: int, count: int = 1) -> np.ndarray:
    return np.stack([to_pixels(street(height, width, seed)) for seed in range(count)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("exported")


@pytest.fixture(scope="module")
def fusion(folder: Path) -> Exported:
    return export_detector(load_detector("fusion"), folder / "road.onnx", "onnx")


@pytest.fixture(scope="module")
def cnn7(folder: Path) -> Exported:
    return export_detector(load_detector("layout:cnn-7"), folder / "cnn7.xml", "openvino")


# --- what files say ---------------------------------------------------------------------


def test_an_onnx_file_says_what_the_network_says_at_any_size_and_batch(fusion: Exported) -> None:
    run = open_onnx(fusion.files[0], 1)
    reference = exportable(load_detector("fusion")).reference

    found = parity(run, reference, [pictures(*size, count=2) for size in SIZES])

    assert found.most < BOUND
    assert found.mean < found.most
    assert found.pictures == 2 * len(SIZES)


def test_openvino_reads_the_onnx_file_and_says_the_same(fusion: Exported) -> None:
    run = open_openvino(fusion.files[0], 1)
    reference = exportable(load_detector("fusion")).reference

    assert parity(run, reference, [pictures(*size) for size in SIZES]).most < BOUND


def test_an_openvino_file_says_what_the_detector_says(cnn7: Exported) -> None:
    detector = load_detector("layout:cnn-7")
    run = open_openvino(cnn7.files[0], 1)

    for height, width in (*SIZES, (300, 400)):  # the last above the size at which it thinks
        said = run(pictures(height, width))
        wanted = detector.detect(pictures(height, width)[0], order="rgb")
        for name, maps in (("likelihood", wanted.likelihood), ("layout", wanted.cues["layout"])):
            assert np.abs(said[name][0] - maps.numpy()).max() < BOUND


def test_layout_gives_the_ground_and_weights_of_ones_own_are_taken(tmp_path: Path) -> None:
    weights = write_ego_network(tmp_path / "own.safetensors", bottom=0.25)
    detector = load_detector("layout", weights={"file": str(weights)}, threshold=0.3)

    exported = export_detector(detector, tmp_path / "ground.onnx", "onnx")

    said = open_onnx(exported.files[0], 1)(pictures(96, 128))
    assert np.allclose(said["likelihood"], 1 / 3)
    assert (said["ego"][0, 80:] > 0.9).all()
    assert (said["ego"][0, :64] < 0.1).all()
    assert exported.notes["weights"] == "own.safetensors"
    assert exported.notes["weights_sha256"] == digest_of(weights)
    assert exported.notes["threshold"] == "0.3"
    assert "non-commercial" not in exported.notes["terms"]


# --- what they say about themselves -------------------------------------------------------


def test_files_say_what_they_take_and_where_they_come_from(
    fusion: Exported, cnn7: Exported
) -> None:
    model = onnx.load(fusion.files[0])
    onnx.checker.check_model(model, full_check=True)
    told = {entry.key: entry.value for entry in model.metadata_props}
    xml = openvino.Core().read_model(cnn7.files[0])
    other = {key: xml.get_rt_info(["roadtorch", key]).value for key in cnn7.notes}

    assert told == fusion.notes
    assert other == cnn7.notes
    for notes, weights in ((told, "backbone-free"), (other, "cnn-7")):
        check_notes(notes, weights)


def check_notes(notes: Mapping[str, str], weights: str) -> None:
    assert notes["colour_order"] == "RGB"
    assert notes["range"] == "0 to 255"
    assert notes["input"] == "image: uint8 (N, H, W, 3)"
    assert notes["weights_sha256"] == digest_of(shipped_weights(weights))
    assert f"{weights}.md" in notes["terms"]


def test_shapes_are_named_and_no_path_of_this_machine_is_in_a_file(fusion: Exported) -> None:
    graph = onnx.load(fusion.files[0]).graph
    shapes = {
        one.name: [side.dim_param or side.dim_value for side in one.type.tensor_type.shape.dim]
        for one in (*graph.input, *graph.output)
    }

    assert shapes == {
        "image": ["N", "H", "W", 3],
        "likelihood": ["N", "H", "W"],
        "layout": ["N", 3, "H", "W"],
        "ego": ["N", "H", "W"],
    }
    data = fusion.files[0].read_bytes()
    assert b".py" not in data
    assert str(Path.home()).encode() not in data


def test_the_same_detector_gives_the_same_bytes(fusion: Exported, tmp_path: Path) -> None:
    again = export_detector(load_detector("fusion"), tmp_path / "again.onnx", "onnx")

    assert again.files[0].read_bytes() == fusion.files[0].read_bytes()


# --- what is refused --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "settings", "out", "kind", "what"),
    [
        ("lbp", {}, "a.onnx", "onnx", "lbp: cannot be exported"),
        ("fusion:untrained", {}, "a.onnx", "onnx", "cannot be exported"),
        ("fusion", {"ego": {"bottom": 0.2}}, "a.onnx", "onnx", "ego: has no part"),
        ("layout", {"share": 0.5}, "a.onnx", "onnx", "share: has no part"),
        ("fusion", {}, "a.xml", "onnx", r"a.xml: does not end .* \(name it a.onnx\)"),
        ("fusion", {}, "a.onnx", "openvino", r"\(name it a.xml\)"),
        ("fusion", {}, "a.onnx", "tflite", "tflite: unknown format"),
    ],
)
def test_what_cannot_be_exported_is_told_before_any_work(
    tmp_path: Path, name: str, settings: dict[str, Any], out: str, kind: str, what: str
) -> None:
    with pytest.raises(ConfigError, match=what):
        export_detector(load_detector(name, **settings), tmp_path / out, kind)

    assert not any(tmp_path.iterdir())


def test_a_file_that_says_something_else_is_not_written(
    fusion: Exported, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(module: object, notes: object, path: Path) -> None:
        shutil.copyfile(fusion.files[0], path)

    made = replace(export_module.FORMATS["onnx"], write=write)
    monkeypatch.setattr(export_module, "FORMATS", {"onnx": made})
    weights = write_ego_network(tmp_path / "own.safetensors", bottom=0.25)
    detector = load_detector("layout", weights={"file": str(weights)})

    with pytest.raises(InputError, match=r"would be .* off in its .* \(nothing was written"):
        export_detector(detector, tmp_path / "out" / "a.onnx", "onnx")

    assert not any((tmp_path / "out").iterdir())


def test_parity_counts_what_is_no_number_as_endlessly_far() -> None:
    def run(_: np.ndarray) -> dict[str, np.ndarray]:
        return {"likelihood": np.full((1, 16, 20), np.nan, np.float32)}

    found = parity(run, lambda _: {"likelihood": torch.zeros(16, 20)}, [pictures(16, 20)])

    assert found.most == float("inf")
    assert found.where == "likelihood at 20×16"


@pytest.mark.parametrize(
    ("kind", "package", "extra"),
    [
        ("onnx", "onnxscript", "onnx"),
        ("onnx", "onnxruntime", "onnx"),
        ("openvino", "openvino", "openvino"),
    ],
)
def test_a_missing_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, package: str, extra: str
) -> None:
    monkeypatch.setattr(export_module, "find_spec", lambda name: None if name == package else 1)
    out = tmp_path / ("a.onnx" if kind == "onnx" else "a.xml")

    with pytest.raises(ConfigError, match=rf"pip install 'roadtorch\[{extra}\]'"):
        export_detector(load_detector("layout:cnn-7"), out, kind)


# --- the example ------------------------------------------------------------------------


ALONE = """
import runpy, sys
sys.modules.update(dict.fromkeys(["torch", "roadtorch", "cv2"]))  # to import them is an error
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_the_example_makes_maps_with_neither_torch_nor_roadtorch(
    fusion: Exported, tmp_path: Path
) -> None:
    source = tmp_path / "pictures" / "sub"
    source.mkdir(parents=True)
    for name in ("a.jpg", "b.png"):
        Image.fromarray(pictures(48, 64)[0]).save(source / name)
    script = ROOT / "docs" / "examples" / "infer.py"
    words = [sys.executable, "-c", ALONE, script, fusion.files[0], tmp_path / "pictures"]

    for pattern in ([], ["*.png"]):
        subprocess.run([*words, tmp_path / "maps", *pattern], check=True, cwd=tmp_path)

    for name in ("a.jpg", "b.png"):
        image = read_image(source / name)
        wanted = exportable(load_detector("fusion")).reference(image)["likelihood"]
        made = read_image((tmp_path / "maps" / "sub" / name).with_suffix(".png"))[0]
        assert torch.allclose(made, wanted, atol=1 / 255)
