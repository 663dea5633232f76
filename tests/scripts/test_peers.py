"""Networks of others beside ours: ONNX files, both kinds of output."""

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
def test_a_network_of_classes_red_green_and_blue_is_scored_on_a_blue_road(
    sides: str, network: tuple[str, str], words: str, f: float, tmp_path: Path,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(peers, "DETECTORS", ("prior:rows",))
    text = "n (float[{}] photo) => ({}) {{ {} }}".format(sides, *network)
    model = onnx.parser.parse_model(f'<ir_version: 8, opset_import: ["": 13]> {text}')
    onnx.save(model, tmp_path / "colours.onnx")
    road = np.arange(48)[None] >= np.full((24, 1), 24)
    colours = np.where(road[..., None], (255, 0, 0), (0, 0, 255))  # OpenCV's order
    for name, pixels in (("images", colours), ("masks", 255 * road)):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "a.png"), pixels.astype(np.uint8))

    peers.main([str(tmp_path), "--onnx", str(tmp_path / "colours.onnx"), *words.split()])

    ours, theirs = capsys.readouterr().out.splitlines()
    assert ours.startswith("prior:rows  ")
    assert theirs.startswith(f"colours{'':22}F {f:.3f} worst {f:.3f} ")
