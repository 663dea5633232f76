"""Runtimes: the reference's masks, one graph for each network, and refusals in one line."""

import copy
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch

from roadtorch import load_detector
from roadtorch.base.errors import ConfigError
from roadtorch.export.export import exportable_part
from roadtorch.layout import runtimes
from roadtorch.layout.runtimes import MAX_DIFFERENCE, open_onnxruntime
from roadtorch.run.memo import cache_key
from roadtorch.run.workers import Workers
from roadtorch.testing.scenes import render_scene
from tests.networks import write_random_network

SIZES = ((16, 17), (192, 256), (360, 480), (700, 333))
"""Below the size of the network, at it, above it, and upright."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return settings of a small network, whose graph is traced in a second."""
    file = write_random_network(tmp_path_factory.mktemp("weights") / "small.safetensors", 1)
    return {"weights": {"file": str(file)}}


# --- parity -----------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [{}, {"mirrored": True}], ids=["one view", "two views"])
def test_masks_agree_with_torch_but_within_1e_4_of_the_threshold(settings: dict[str, Any]) -> None:
    reference = load_detector("fusion", **settings)
    detector = load_detector("fusion", runtime="onnxruntime", **settings)

    for seed, (height, width) in enumerate(SIZES):
        for dusk in (0.0, 0.9):
            image = render_scene(seed, height, width, dusk=dusk).image
            expected, detection = reference.detect(image), detector.detect(image)
            likelihoods = torch.stack([expected.likelihood, detection.likelihood])
            # Thin holes are filled up to the threshold, where pixels at the threshold enclose them.
            interior = ((likelihoods - 0.5).abs() > MAX_DIFFERENCE).all(0)
            assert (likelihoods[0] - likelihoods[1]).abs()[interior].max() <= MAX_DIFFERENCE
            assert torch.equal(expected.mask & interior, detection.mask & interior)
            for name in ("layout", "learned_road", "appearance"):
                difference = (expected.cues[name] - detection.cues[name]).abs()
                assert difference.max() <= MAX_DIFFERENCE


def test_processes_threads_and_copies_give_the_same_bytes(weights: dict[str, Any]) -> None:
    images = [render_scene(seed, 48, 64).image for seed in range(4)]
    detector = load_detector("fusion", runtime="onnxruntime", **weights)
    expected = [detector.find_evidence(image).likelihood for image in images]

    def crash(_: object) -> Any:
        raise AssertionError("a worker died")

    def likelihood(image: torch.Tensor) -> torch.Tensor:
        return detector.find_evidence(image).likelihood

    copies = [copy.deepcopy(detector), pickle.loads(pickle.dumps(detector))]
    results = [[copied.find_evidence(image).likelihood for image in images] for copied in copies]
    results.append(list(Workers(2).map(likelihood, images, crash)))
    with ThreadPoolExecutor(4) as pool:
        results.append(list(pool.map(likelihood, images)))
    for likelihoods in results:
        for values, others in zip(expected, likelihoods, strict=True):
            assert torch.equal(values, others)


def test_results_are_remembered_for_one_runtime(weights: dict[str, Any]) -> None:
    detectors = [load_detector("fusion", runtime=name, **weights) for name in runtimes.RUNTIMES]

    assert len({cache_key(detector) for detector in detectors}) == 2
    assert "runtime='onnxruntime'" in repr(detectors[-1])
    with pytest.raises(ConfigError, match="runtime: has no effect on the exported file"):
        exportable_part(detectors[-1])


# --- the cache --------------------------------------------------------------------------


def test_a_graph_is_traced_once_and_again_if_damaged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, weights: dict[str, Any]
) -> None:
    trace, traced, programs = runtimes.trace_onnx, list[str](), list[Any]()

    def counted(module: Any, example: torch.Tensor, name: str) -> Any:
        traced.append(name)
        programs[:] = programs or [trace(module, example, name)]  # seconds
        return programs[0]

    monkeypatch.setattr(runtimes, "trace_onnx", counted)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for _ in range(2):
        load_detector("fusion", runtime="onnxruntime", **weights)
    (file,) = (tmp_path / "roadtorch").iterdir()
    data = file.read_bytes()
    assert len(traced) == 1

    file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    load_detector("fusion", runtime="onnxruntime", **weights)

    assert (len(traced), file.read_bytes()) == (2, data)

    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    detector = load_detector("fusion", runtime="onnxruntime", **weights)  # in memory

    assert detector(render_scene(0, 48, 64).image).likelihood.isfinite().all()


# --- refusals ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("fusion", {"runtime": "onnxrutime"}, "onnxrutime: unknown runtime (did you mean onnxr"),
        ("fusion", {"runtime": "tensorrt"}, "unknown runtime (known: onnxruntime, torch)"),
        ("cpf", {"runtime": "onnxruntime"}, "cpf: has no whole-image network for onnxruntime (le"),
        ("layout:cnn-7", {"runtime": "onnxruntime"}, "layout:cnn-7: has no whole-image network"),
    ],
)
def test_names_without_a_runtime_are_refused(
    name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError) as raised:
        load_detector(name, **options)

    assert message in str(raised.value)


def biased(graph: bytes | Path, threads: int) -> Callable[..., Any]:
    run = open_onnxruntime(graph, threads)
    return lambda values: {name: maps + 1e-3 for name, maps in run(values).items()}


def broken(graph: bytes | Path, threads: int) -> Callable[..., Any]:
    raise RuntimeError("no such instruction\nand more")


@pytest.mark.parametrize(
    ("opener", "message"),
    [(biased, "differ from torch by"), (broken, "cannot compile the network: no such instr")],
)
def test_a_runtime_that_fails_or_differs_is_refused(
    opener: Any, message: str, monkeypatch: pytest.MonkeyPatch, weights: dict[str, Any]
) -> None:
    monkeypatch.setattr(runtimes, "open_onnxruntime", opener)

    with pytest.raises(ConfigError, match=message) as raised:
        load_detector("fusion", runtime="onnxruntime", **weights)

    assert str(raised.value).count("\n") == 0
