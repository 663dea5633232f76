"""Exported files: parity with Python, metadata, and what is refused."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import roadtorch.export.export as export_module
from roadtorch.base.atomic import file_digest
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.image import read_image, to_pixels
from roadtorch.detectors.catalogue import load_detector
from roadtorch.export.export import (
    ExportResult,
    describe_export,
    export_detector,
    exportable_part,
    measure_parity,
    write_onnx,
)
from roadtorch.layout import runtimes
from roadtorch.layout.runtimes import MAX_DIFFERENCE, open_onnxruntime
from roadtorch.layout.weights import shipped_weights
from roadtorch.testing import street
from tests.export.conftest import NAME
from tests.networks import write_random_network

onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
for package in ("onnxscript", "onnxruntime"):
    pytest.importorskip(package, reason="the extra onnx is not installed")

ROOT = Path(__file__).parents[2]
SIZES = ((16, 16), (33, 200), (131, 77), (240, 320))


def images(height: int, width: int, count: int = 1) -> np.ndarray:
    return np.stack([to_pixels(street(height, width, seed)) for seed in range(count)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("exported")


@pytest.fixture(scope="module")
def cnn7(folder: Path) -> ExportResult:
    return export_detector(load_detector("layout:cnn-7"), folder / "cnn7.onnx")


# --- what files say ---------------------------------------------------------------------


def test_a_file_agrees_with_python_at_any_size_and_batch(fusion: ExportResult) -> None:
    steps = exportable_part(load_detector(NAME)).compute
    batches = [images(*size, count=2) for size in SIZES]

    apart = measure_parity(open_onnxruntime(fusion.files[0], 1), steps, batches)

    assert apart.max_difference < MAX_DIFFERENCE
    assert apart.mean_difference < apart.max_difference
    assert apart.images == 2 * len(SIZES)


def test_a_mask_is_that_of_the_maps_in_a_quarter_of_the_bytes(
    cnn7: ExportResult, folder: Path
) -> None:
    exported = export_detector(load_detector("layout:cnn-7"), folder / "mask.onnx", "mask")
    pixels, threshold = images(131, 77, count=2), load_detector("layout:cnn-7").settings.threshold

    (mask,) = open_onnxruntime(exported.files[0], 1)(pixels).values()

    likelihood = open_onnxruntime(cnn7.files[0], 1)(pixels)["likelihood"]
    assert (mask.dtype, mask.shape) == (np.uint8, (2, 131, 77))
    assert np.array_equal(mask, likelihood >= threshold)
    assert exported.metadata["output.mask"] == "uint8 (N, H, W): 1 road, 0 not"
    assert exported.parity.max_difference <= MAX_DIFFERENCE


def test_a_file_of_cnn7_agrees_with_the_detector(cnn7: ExportResult) -> None:
    detector = load_detector("layout:cnn-7")
    run = open_onnxruntime(cnn7.files[0], 1)

    for height, width in (*SIZES, (300, 400)):  # the last above the size at which it thinks
        maps = run(images(height, width))
        detection = detector.detect(images(height, width)[0], order="rgb")
        expected = {"likelihood": detection.likelihood, "layout": detection.cues["layout"]}
        for name, values in expected.items():
            assert np.abs(maps[name][0] - values.numpy()).max() < MAX_DIFFERENCE


def test_a_file_names_custom_weights(tmp_path: Path) -> None:
    path = write_random_network(tmp_path / "mine.safetensors", 0)
    detector = load_detector("fusion", weights={"file": str(path)}, threshold=0.9)

    notes = describe_export(detector, exportable_part(detector))

    assert notes["weights"] == "mine.safetensors"
    assert notes["weights_sha256"] == file_digest(path)
    assert notes["threshold"] == "0.9"
    assert notes["terms"].startswith("those of the author of the weights")


def test_the_weight_of_the_appearance_reaches_the_exported_maps() -> None:
    image = torch.from_numpy(images(60, 80)).permute(0, 3, 1, 2) / 255
    detectors = [load_detector(NAME, appearance={"weight": weight}) for weight in (1.0, 0.0)]

    first, second = (exportable_part(entry).compute(image)["likelihood"] for entry in detectors)

    assert not torch.equal(first, second)


def test_one_detector_gives_one_file(cnn7: ExportResult, tmp_path: Path) -> None:
    again, detector = tmp_path / "again.onnx", load_detector("layout:cnn-7")

    part = exportable_part(detector)
    write_onnx(detector.analysis, part, cnn7.metadata, again)

    assert again.read_bytes() == cnn7.files[0].read_bytes()


# --- what they say about themselves -------------------------------------------------------


def test_files_state_what_they_take_and_their_origin(
    fusion: ExportResult, cnn7: ExportResult
) -> None:
    for exported, name in ((fusion, "backbone-free"), (cnn7, "cnn-7")):
        model, notes = onnx.load(exported.files[0]), exported.metadata
        onnx.checker.check_model(model, full_check=True)
        assert {entry.key: entry.value for entry in model.metadata_props} == notes
        assert notes["colour_order"] == "RGB"
        assert notes["range"] == "0 to 255"
        assert notes["input"] == "image: uint8 (N, H, W, 3)"
        assert notes["weights_sha256"] == file_digest(shipped_weights(name))
        assert f"{name}.md" in notes["terms"]


def test_shapes_are_named_and_no_path_of_this_machine_is_in_a_file(fusion: ExportResult) -> None:
    graph = onnx.load(fusion.files[0]).graph
    shapes = {
        value.name: [side.dim_param or side.dim_value for side in value.type.tensor_type.shape.dim]
        for value in (*graph.input, *graph.output)
    }

    assert shapes == {
        "image": ["N", "H", "W", 3],
        "likelihood": ["N", "H", "W"],
        "layout": ["N", 3, "H", "W"],
        "ego": ["N", "H", "W"],
        "seed_area": ["N", "H", "W"],
        "trust": ["N"],
    }
    data = fusion.files[0].read_bytes()
    assert b".py" not in data
    assert str(Path.home()).encode() not in data


# --- what is refused --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "settings", "out", "problem"),
    [
        ("lbp", {}, "a.onnx", "lbp: cannot be exported"),
        ("fusion:untrained", {}, "a.onnx", "cannot be exported"),
        ("fusion", {"ego": {"bottom": 0.2}}, "a.onnx", "ego: has no effect"),
        ("fusion", {}, "a.xml", r"a.xml: does not end .* \(name it a.onnx\)"),
    ],
)
def test_what_cannot_be_exported_is_refused_before_any_work(
    tmp_path: Path, name: str, settings: dict[str, Any], out: str, problem: str
) -> None:
    with pytest.raises(ConfigError, match=problem):
        export_detector(load_detector(name, **settings), tmp_path / out)

    assert not any(tmp_path.iterdir())


def test_a_file_that_differs_from_python_is_not_written(
    fusion: ExportResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(module: object, part: object, notes: object, path: Path) -> None:
        shutil.copyfile(fusion.files[0], path)

    monkeypatch.setattr(export_module, "write_onnx", write)

    with pytest.raises(InputError, match=r"would differ by .* in .* \(nothing was written"):
        export_detector(load_detector("fusion"), tmp_path / "a.onnx")

    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(("wrong", "largest"), [(2, 0.0), (3, float("inf"))])
def test_nan_is_infinitely_far_but_a_pixel_of_100000_counts_not(wrong: int, largest: float) -> None:
    actual = np.zeros((1, 400, 500), np.float32)
    actual[0, 0, :wrong] = np.nan
    zeros = {"likelihood": torch.zeros(400, 500)}

    apart = measure_parity(lambda _: {"likelihood": actual}, lambda _: zeros, [images(400, 500)])

    assert (apart.max_difference, apart.location) == (largest, "likelihood at 500×400")


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(runtimes, "find_spec", lambda name: None if "script" in name else 1)

    with pytest.raises(ConfigError, match=r"needs onnxscript: .*pip install 'roadtorch\[onnx\]'"):
        export_detector(load_detector("fusion"), tmp_path / "a.onnx")


# --- the example ------------------------------------------------------------------------


ALONE = """
import runpy, sys
sys.modules.update(dict.fromkeys(["torch", "roadtorch", "cv2"]))  # to import them is an error
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def test_the_example_needs_neither_torch_nor_roadtorch(
    fusion: ExportResult, tmp_path: Path
) -> None:
    source = tmp_path / "images" / "sub"
    source.mkdir(parents=True)
    for name in ("a.jpg", "b.png"):
        Image.fromarray(images(48, 64)[0]).save(source / name)
    script = ROOT / "docs" / "examples" / "infer.py"
    words = [sys.executable, "-c", ALONE, script, fusion.files[0], tmp_path / "images"]

    for pattern in ([], ["*.png"]):
        subprocess.run([*words, tmp_path / "maps", *pattern], check=True, cwd=tmp_path)

    for name in ("a.jpg", "b.png"):
        image = read_image(source / name)
        expected = exportable_part(load_detector(NAME)).compute(image)["likelihood"]
        likelihood = read_image((tmp_path / "maps" / "sub" / name).with_suffix(".png"))[0]
        assert torch.allclose(likelihood, expected, atol=1 / 255)


# --- C++ ----------------------------------------------------------------------------------

HEADERS = [
    folder
    for folder in (os.environ.get("ONNXRUNTIME_INCLUDE", ""), "/usr/include/onnxruntime")
    if (Path(folder) / "onnxruntime_cxx_api.h").is_file()
]
"""Of ONNX Runtime's C++ interface; the library is that of the wheel."""


@pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")
@pytest.mark.skipif(not HEADERS, reason="there are no headers (Debian 13: libonnxruntime-dev)")
def test_the_example_in_cpp_agrees_with_python(tmp_path: Path) -> None:
    runtime = find_spec("onnxruntime")
    assert runtime is not None
    (library,) = Path(str(runtime.origin)).parent.glob("capi/libonnxruntime.so.*")
    program, written = tmp_path / "infer", tmp_path / "road.pgm"
    exported = export_detector(load_detector(NAME), tmp_path / "road.onnx", "mask")
    code = ROOT / "docs" / "examples" / "cpp" / "infer.cpp"
    compiler = ["g++", "-std=c++17", "-Wall", "-Werror", str(code), "-I", HEADERS[0]]
    linked = [str(library), "-o", str(program)]
    (tmp_path / "libonnxruntime.so.1").symlink_to(library)  # the name that it has for programs
    subprocess.run([*compiler, *linked], check=True)
    (image,) = images(120, 160)
    Image.fromarray(image).save(tmp_path / "street.ppm")

    words = [str(program), str(exported.files[0]), str(tmp_path / "street.ppm"), str(written)]
    environment = {**os.environ, "LD_LIBRARY_PATH": str(tmp_path)}
    result = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)

    outputs = open_onnxruntime(exported.files[0], 1)(image[None])
    road, trust = outputs["mask"].mean(), float(outputs["trust"][0])
    assert result.stdout == f"160x120, road {int(100 * road)} %, trust {round(trust, 2):g}\n"
    np.testing.assert_array_equal(np.asarray(Image.open(written)), 255 * outputs["mask"][0])
