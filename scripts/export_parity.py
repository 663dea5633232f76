"""Exported networks against Python on real pictures, in ONNX Runtime and in OpenVINO.

    python scripts/export_parity.py ../shared/data/many --pictures 20

Of all pictures below the given folders it takes some, evenly over their sorted names. Times are
medians of the processor's, a picture by the file and by Python in turn (the network alone, and
``layout:cnn-7`` whole), on as many threads as torch has: OMP_NUM_THREADS says how many.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
import torch

from roadtorch.detectors.catalogue import load_detector
from roadtorch.export.export import export_detector
from roadtorch.export.exportable import CAN, Reference, exportable
from roadtorch.export.onnx_file import open_onnx
from roadtorch.export.openvino_file import open_openvino
from roadtorch.export.parity import BOUND, Run, parity
from roadtorch.io.image import from_pixels, read_image, to_pixels

HEADER = ("detector", "file", "runtime", "pictures", "most", "mean", "ms", "Python", "where")


def chosen(folders: Sequence[Path], most: int) -> list[Path]:
    """At most so many of the pictures below folders, evenly over their sorted names."""
    found = sorted(path for folder in folders for path in folder.rglob("images/*.jpg"))
    places = np.linspace(0, len(found) - 1, min(most, len(found))).round().astype(int)
    return [found[place] for place in places]


def runs(name: str, folder: Path) -> Iterator[tuple[str, str, Run]]:
    """The detector's files, each with what runs it: the ONNX file by both runtimes."""
    detector, threads = load_detector(name), torch.get_num_threads()
    stem = name.replace(":", "-")
    (onnx,) = export_detector(detector, folder / f"{stem}.onnx", "onnx").files
    xml, _ = export_detector(detector, folder / f"{stem}.xml", "openvino").files
    yield onnx.suffix, "ONNX Runtime", open_onnx(onnx, threads)
    yield onnx.suffix, "OpenVINO", open_openvino(onnx, threads)
    yield xml.suffix, "OpenVINO", open_openvino(xml, threads)


def times(run: Run, reference: Reference, pictures: Sequence[np.ndarray]) -> tuple[float, float]:
    """Milliseconds of processor time for a picture: by the file, and by Python."""
    seen: list[tuple[float, float]] = []
    for pixels in (*pictures[:2], *pictures):
        image = from_pixels(pixels)
        begin = time.process_time()
        run(pixels[None])
        middle = time.process_time()
        reference(image)
        seen.append((middle - begin, time.process_time() - middle))
    file, python = np.median(seen[2:], axis=0) * 1000  # the first two warm up
    return file, python


def main() -> int:
    """Print a line for each detector, file and runtime; 1 where one is off by more than allowed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", help="with pictures in images/*.jpg below")
    parser.add_argument("--pictures", type=int, default=20, help="at most so many")
    parser.add_argument("--detector", action="append", choices=CAN, help="one of them alone")
    arguments = parser.parse_args()
    paths = chosen(arguments.folders, arguments.pictures)
    if not paths:
        parser.error("no pictures images/*.jpg below these folders")
    pictures = [to_pixels(read_image(path)) for path in paths]
    print("sizes:", *sorted({f"{one.shape[1]}×{one.shape[0]}" for one in pictures}))
    print("{:<13} {:<6} {:<13} {:>8} {:>8} {:>8} {:>6} {:>6}  {}".format(*HEADER))
    worst = 0.0
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.detector or CAN:
            reference = exportable(load_detector(name)).reference
            for file, runtime, run in runs(name, Path(folder)):
                found = parity(run, reference, (one[None] for one in pictures))
                worst = max(worst, found.most)
                ms, python = times(run, reference, pictures)
                figures = f"{found.pictures:>8} {found.most:>8.1e} {found.mean:>8.1e}"
                figures += f" {ms:>6.1f} {python:>6.1f}  {found.where}"
                print(f"{name:<13} {file:<6} {runtime:<13} {figures}", flush=True)
    return int(worst > BOUND)


if __name__ == "__main__":
    sys.exit(main())
