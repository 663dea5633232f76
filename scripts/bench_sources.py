"""Pictures per processor second from a folder, archives and bags; the size of bags of results.

    python scripts/bench_sources.py --images FOLDER
    python scripts/bench_sources.py --images FOLDER --pictures 100 --rounds 5
    python scripts/bench_sources.py --images FOLDER --keep bags --detector fusion --pictures 20

The same pictures, read and decoded one after the other in one thread. Seconds are those of the
processor, so that others who use the machine count little. Rounds are interleaved; figures are
medians of the rounds. Archives keep the files as they are; bags hold the pixels (rgb8)
or the files (CompressedImage). Results: masks and confidences of a detector, with and without the
overlay, as ``BagSink`` writes them; ``--keep`` leaves the bags there.
"""

import argparse
import statistics
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np
import torch

from roadtorch import load_detector
from roadtorch.errors import RoadtorchError
from roadtorch.io.image import read_image, tint_mask, to_pixels
from roadtorch.sinks.bags import BagSink
from roadtorch.sinks.messages import image_of_pixels, message_types
from roadtorch.sources.archives import archive_source
from roadtorch.sources.bags import bag_source
from roadtorch.sources.frame import Frame, Source
from roadtorch.sources.pictures import Picture, find_images

STEP = 10**8  # nanoseconds between frames


def write_sources(pictures: list[Picture], folder: Path) -> Mapping[str, Source]:
    """The pictures as archives and bags in a folder."""
    zipped, tarred, packed = (folder / f"a.{kind}" for kind in ("zip", "tar", "tar.gz"))
    with zipfile.ZipFile(zipped, "w") as archive:
        for picture in pictures:
            archive.write(picture.path, picture.name + picture.path.suffix)
    for path, mode in ((tarred, "w"), (packed, "w:gz")):
        with tarfile.open(path, mode) as archive:  # pyright: ignore
            for picture in pictures:
                archive.add(picture.path, picture.name + picture.path.suffix)
    sources = {path.name: archive_source(str(path)) for path in (zipped, tarred, packed)}
    for name in ("pixels", "files"):
        sources[f"bag of {name}"] = bag_source(str(write_bag(pictures, folder / name, name)))
    return sources


def write_bag(pictures: list[Picture], path: Path, content: str) -> Path:
    """An MCAP bag of the pictures' pixels or files."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    types = message_types(2)
    kind = f"sensor_msgs/msg/{'Image' if content == 'pixels' else 'CompressedImage'}"
    with Writer(path, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        link = bag.add_connection("/camera/image", kind, typestore=types)
        for number, picture in enumerate(pictures):
            pixels = to_pixels(read_image(picture.path))
            message = image_of_pixels(types, pixels, number * STEP, "camera")
            if content == "files":
                data = np.fromfile(picture.path, np.uint8)
                form = picture.path.suffix[1:]
                message = types.types[kind](message.header, form, data)
            bag.write(link, number * STEP, types.serialize_cdr(message, kind))
    return path


def write_results(pictures: list[Picture], name: str, folder: Path) -> Iterable[str]:
    """Lines that tell the size of bags with results, and the time a frame takes to write."""
    detector = load_detector(name)
    found = [(image, detector.detect(image)) for image in (read_image(p.path) for p in pictures)]
    for content in ("masks", "masks and overlays"):
        path = folder / content.replace(" ", "-")
        spent = 0.0
        with closing(BagSink(path, "camera", detector.settings.threshold)) as bag:
            for number, (image, detection) in enumerate(found):
                has_overlay = content != "masks"
                shown = tint_mask(to_pixels(image), detection.mask.numpy())
                begin = time.process_time()
                bag.write(detection, number * STEP, shown if has_overlay else None)
                spent += time.process_time() - begin
        size = sum(file.stat().st_size for file in path.rglob("*")) / len(found)
        raw = detection.mask.numel() * (2 + 3 * has_overlay)
        yield (
            f"{content:20} {size / 1000:8.1f} kB a frame ({raw / 1000:.1f} unpacked), "
            f"{1000 * spent / len(found):6.2f} ms a frame"
        )


def seconds_for(frames: Iterable[Frame]) -> float:
    begin = time.process_time()
    for frame in frames:
        frame.read()
    return time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--pictures", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--detector", default="fusion")
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    try:
        pictures = find_images([given.images])[: given.pictures]
        with tempfile.TemporaryDirectory() as folder:
            report(pictures, given.rounds, Path(folder))
            for line in write_results(pictures, given.detector, given.keep or Path(folder)):
                print(line)
    except RoadtorchError as problem:
        sys.exit(f"bench_sources: {problem}")


def report(pictures: list[Picture], rounds: int, folder: Path) -> None:
    sources = write_sources(pictures, folder)
    files = [Frame(0, "", "", None, lambda path=one.path: read_image(path)) for one in pictures]
    times: dict[str, list[float]] = {}
    for _ in range(rounds):
        times.setdefault("folder", []).append(seconds_for(files))
        for name, source in sources.items():
            times.setdefault(name, []).append(seconds_for(source.frames()))
    for name, each in times.items():
        ratio = statistics.median(a / b for a, b in zip(times["folder"], each, strict=True))
        rate = len(pictures) / statistics.median(each)
        print(f"{name:20} {rate:8.0f} pictures/s {100 * ratio:6.0f} % of the folder")


if __name__ == "__main__":
    main()
