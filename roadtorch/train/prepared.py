"""Images prepared for training once, on disk: resized, with their machine labels."""

import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.base.compute import single_threaded_process
from roadtorch.base.errors import InputError, RoadtorchError, to_input_error
from roadtorch.base.progress import Progress
from roadtorch.base.signals import StopRequest, until_stopped
from roadtorch.detectors.detector import validate_image
from roadtorch.inputs.item import Item
from roadtorch.run.memo import Arrays, read_cached, write_cached
from roadtorch.run.workers import WORKER_CRASH, make_workers


def to_uint8(values: Tensor) -> Tensor:
    """Convert values in [0, 1] to uint8, rounded."""
    return values.mul(255).round_().to(torch.uint8)


def from_uint8(values: Tensor) -> Tensor:
    """Convert uint8 to float32 in [0, 1]."""
    return values.to(torch.float32).div_(255)


@dataclass(frozen=True)
class PreparedImage:
    """An image's name and the file prepared from it; None, with an error, if that failed."""

    name: str
    file: Path | None
    error: str = ""


@dataclass(frozen=True)
class Preparation:
    """The preparation of an image in a worker process.

    key: returns the cache key of an image. compute: makes named arrays from an image (3, H, W) in
    [0, 1] and its name.
    """

    folder: Path
    key: Callable[[Item], str]
    compute: Callable[[Tensor, str], Arrays]

    def __call__(self, image: Item) -> PreparedImage:
        """Prepare an image unless its file is up to date; a wrong setting's error is raised."""
        name, key = image_file_name(image), self.key(image)
        file = self.folder / f"{name}.npz"
        if read_cached(file, key) is not None:  # reads all arrays: damage would end the training
            return PreparedImage(name, file)
        try:
            arrays = self.compute(validate_image(image.read()), image.name)
        except Exception as error:  # one image on which a detector fails must not end a long run
            if isinstance(error, RoadtorchError) and not isinstance(error, InputError):
                raise  # a wrong setting, not a wrong image
            text = " ".join(str(to_input_error(image.path, error)).split())
            return PreparedImage(name, None, text)
        write_cached(file, key, arrays)
        return PreparedImage(name, file)


def prepare(
    images: Sequence[Item],
    preparation: Preparation,
    stop: StopRequest,
    quiet: bool = False,
    desc: str = "labels",
) -> list[PreparedImage]:
    """Prepare all images that are not up to date, in order; report and skip those that fail.

    If a stop is requested, only those that are ready are returned.
    """
    items, count = list[PreparedImage](), len(images)
    with single_threaded_process():
        workers = make_workers(None, count)
        results = workers.map(preparation, until_stopped(images, stop), _crashed_item)
        bar = Progress(results, total=count, desc=desc, unit="image", quiet=quiet)
        with closing(results):
            for result in bar:
                items.append(result)
                if result.error:
                    Progress.write(f"roadtorch: skipped: {result.error}", file=sys.stderr)
    return items


def _crashed_item(image: Item) -> PreparedImage:
    return PreparedImage(image_file_name(image), None, str(InputError(image.origin, *WORKER_CRASH)))


def image_file_name(image: Item) -> str:
    """Return an image's relative name with its suffix: two images may differ in that alone."""
    return image.name + image.suffix
