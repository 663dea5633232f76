"""Compare detectors on a GPU with the CPU's results.

    python scripts/device_parity.py IMAGES... [--footage VIDEO BAG...] [--device cuda]

Prints, by detector, in how many pixels the masks differ and by how much the likelihoods do at most,
and the median time of an image on either device; then in how many masks that `infer` writes for the
footage, with every other file it has, pixels differ.
"""

import subprocess
import sys
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from roadtorch import Detection, load_detector, read_image

DETECTORS = ("fusion", "fusion:large", "layout:cnn-7", "cpf", "labeller")
SAVE = "likelihood,mask,overlay,cues,npy,polygons,json,overlay-frames,mask-video,likelihood-video"


def detect_all(name: str, device: str, images: Sequence[Path]) -> tuple[list[Detection], float]:
    """Return the detections of images, and the median milliseconds of one."""
    detector, detections, times = load_detector(name, device=device), [], []
    detector.detect(read_image(images[0]))  # the first call compiles and allocates
    for path in images:
        image, start = read_image(path), time.perf_counter()
        detection = detector.detect(image)
        detection.likelihood.sum().item()  # waits for the device
        times.append(1000 * (time.perf_counter() - start))
        detections.append(detection)
    return detections, median(times)


def compare(name: str, device: str, images: Sequence[Path]) -> str:
    """Describe how a detector's results on a device differ from the CPU's."""
    (expected, slow), (actual, fast) = (detect_all(name, d, images) for d in ("cpu", device))
    pairs = list(zip(expected, actual, strict=True))
    pixels = sum(detection.mask.numel() for detection in expected)
    differing = sum(int((cpu.mask != gpu.mask.cpu()).sum()) for cpu, gpu in pairs)
    largest = max(float((c.likelihood - g.likelihood.cpu()).abs().max()) for c, g in pairs)
    masks = f"masks differ in {differing} of {pixels} pixels"
    times = f"cpu {slow:.1f} ms, {device} {fast:.1f} ms"
    return f"{name}: {masks}, likelihoods by {largest:.3g}; {times}"


def infer(source: Path, device: str, out: Path) -> dict[str, np.ndarray]:
    """Run ``infer`` with every kind of file, and return the masks by name."""
    words = ["infer", str(source), "--save", SAVE, "--device", device, "--out", str(out)]
    subprocess.run([sys.executable, "-m", "roadtorch", *words], check=True)
    masks = sorted(out.rglob("*.mask.png"))
    return {str(path.relative_to(out)): np.asarray(Image.open(path)) for path in masks}


def compare_footage(source: Path, device: str) -> str:
    """Describe how the masks of footage on a device differ from the CPU's."""
    with TemporaryDirectory() as folder:
        cpu, gpu = (infer(source, d, Path(folder, d.replace(":", "-"))) for d in ("cpu", device))
    differing = sum(not np.array_equal(mask, gpu[name]) for name, mask in cpu.items())
    return f"{source.name}: {differing} of {len(cpu)} masks differ"


def main() -> None:
    """Compare every detector of ``DETECTORS``, and the footage."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("images", nargs="+", type=Path)
    parser.add_argument("--footage", nargs="+", type=Path, default=[])
    parser.add_argument("--device", default="cuda")
    options = parser.parse_args()
    for name in DETECTORS:
        print(compare(name, options.device, options.images), flush=True)
    for source in options.footage:
        print(compare_footage(source, options.device), flush=True)


if __name__ == "__main__":
    main()
