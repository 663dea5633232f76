"""Maps of pictures by an exported network, with ONNX Runtime: neither torch nor roadtorch.

python docs/examples/infer.py road.onnx PICTURES MAPS
"""

import sys
from pathlib import Path

import cv2
import onnxruntime

model, pictures, maps = sys.argv[1:]
session = onnxruntime.InferenceSession(model)
for path in sorted(Path(pictures).rglob("*.jpg")):
    rgb = cv2.imread(str(path))[..., ::-1].copy()
    (likelihood,) = session.run(["likelihood"], {"image": rgb[None]})
    file = Path(maps) / path.relative_to(pictures).with_suffix(".png")
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), (likelihood[0] * 255).round().astype("uint8"))
