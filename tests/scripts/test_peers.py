"""Networks of others beside ours: ONNX files, both kinds of output, and what is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from scripts import peers

onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")

FIXED, ANY = "1,3,16,32", "n,3,h,w"
SCORES = "float[n,3,h,w] out", "out = AveragePool<kernel_shape=[4,4],strides=[4,4]>(photo)"
CLASS_MAP = "int64[n,h,w] out", "out = ArgMax<axis=1,keepdims=0>(photo)"
SQUARE_MAP = "int64[n,k,h,w] out", "out = ArgMax<axis=1,keepdims=1>(photo)"
CLASSES = "float[n,3] out", "out = ReduceMean<axes=[2,3],keepdims=0>(photo)"


def run(folder: Path, sides: str, network: tuple[str, str], words: str) -> None:
    """Score a network, whose classes are red, green and blue, on an image with a blue road."""
    output, body = network
    text = f"n (float[{sides}] photo) => ({output}) {{ {body} }}"
    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["": 13]> {text}')
    onnx.save(model, folder / "colours.onnx")
    road = np.arange(48)[None] >= np.full((24, 1), 24)
    colours = np.where(road[..., None], (255, 0, 0), (0, 0, 255))  # OpenCV's order
    for name, pixels in (("images", colours), ("masks", 255 * road)):
        (folder / name).mkdir()
        cv2.imwrite(str(folder / name / "a.png"), pixels.astype(np.uint8))
    peers.main([str(folder), "--onnx", str(folder / "colours.onnx"), *words.split()])


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "DETECTORS", ("prior:rows",))


@pytest.mark.parametrize(
    ("sides", "network", "words", "f"),
    [
        (FIXED, SCORES, "--road 2", 1),
        (ANY, SCORES, "--road 2 --size 16x32", 1),
        (ANY, SQUARE_MAP, "--road 1 2 --size 8x16", 1),
        (FIXED, CLASS_MAP, "--road 0", 0),
        (FIXED, SCORES, "--road 0 2", 2 / 3),  # everything
        (FIXED, SCORES, "--road 1 --mean 0 -300 0", 2 / 3),
        (FIXED, CLASS_MAP, "--road 2 --mean 0 -300 0 --scale 255 2550 255", 1),
    ],
)
def test_a_network_of_an_onnx_file_is_scored(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    sides: str,
    network: tuple[str, str],
    words: str,
    f: float,
) -> None:
    run(tmp_path, sides, network, words)

    ours, theirs = capsys.readouterr().out.splitlines()
    assert ours.startswith("prior:rows  ")
    assert theirs.startswith(f"colours{'':22}F {f:.3f} worst {f:.3f} ")


@pytest.mark.parametrize(
    ("sides", "network", "words", "problem"),
    [
        (ANY, SCORES, "--road 2", "takes tensor(float) ['n', 3, 'h', 'w']"),
        (FIXED, SCORES, "--road 2 --size 32x16", "takes tensor(float) [1, 3, 16, 32]"),
        (FIXED, SCORES, "--road 3", "gives float32 [1, 3, 4, 8]"),
        (FIXED, CLASSES, "", "gives float32 [1, 3]"),
    ],
)
def test_other_networks_are_refused_in_one_line(
    tmp_path: Path, sides: str, network: tuple[str, str], words: str, problem: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        run(tmp_path, sides, network, words)

    message = f"peers.py: error: {tmp_path}/colours.onnx: {problem} ({peers.ONNX_HINT})"
    assert stop.value.code == message
