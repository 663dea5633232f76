"""Maps of images by an exported network, with ONNX Runtime: neither torch nor roadtorch.

python docs/examples/infer.py road.onnx IMAGES MAPS ['*.png']

It needs onnxruntime and NumPy; Pillow reads and writes the images, as any other reader may.
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
    found = session.run(["likelihood"], {"image": rgb[None]})
    file = Path(maps) / path.relative_to(images).with_suffix(".png")
    file.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((np.asarray(found[0])[0] * 255).round().astype(np.uint8)).save(file)
