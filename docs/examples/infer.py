"""Run an exported network on images with ONNX Runtime, without torch and roadtorch.

python docs/examples/infer.py road.onnx IMAGES MAPS ['*.png']

It needs onnxruntime, NumPy and Pillow.
"""

import sys
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image

model, images, maps, *pattern = sys.argv[1:]
session = onnxruntime.InferenceSession(model)
for path in sorted(Path(images).rglob(*pattern or ["*.jpg"])):
    rgb = np.asarray(Image.open(path).convert("RGB"))
    outputs = session.run(["likelihood"], {"image": rgb[None]})
    file = Path(maps) / path.relative_to(images).with_suffix(".png")
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((np.asarray(outputs[0])[0] * 255).round().astype(np.uint8)).save(file)
