"""torchvision, beside whichever torch is installed: it is imported here and nowhere else."""

from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import torch

from roadtorch.base.errors import RoadtorchError

OPERATORS = ("nms", "qnms")
SIGNATURE = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"


@cache
def import_torchvision() -> ModuleType:
    """torchvision with its ``transforms.v2``.

    Its wheels beside a CPU-only torch cannot load their compiled operators, and then fail at
    import because they describe the results of operators that nobody declared (pytorch/vision
    issues 9077 and 9085). Declaring these two first is enough: what is plain torch works. Raises
    RoadtorchError where torchvision is missing or made for another torch altogether.
    """
    hint = "pip install the torchvision that belongs to it, see docs/installation.md"
    package = find_spec("torchvision")
    if package is None or package.origin is None:
        raise RoadtorchError("torchvision", "is not installed", hint)
    for library in Path(package.origin).parent.glob("_C.*"):
        with suppress(OSError):  # the very misfit
            torch.ops.load_library(library)
    for name in OPERATORS:
        if not hasattr(torch.ops.torchvision, name):
            torch.library.define(f"torchvision::{name}", SIGNATURE)
    try:
        import torchvision.transforms.v2
    except Exception as error:  # another build fails in many ways
        reason = (str(error).splitlines() or [""])[0]
        problem = f"cannot be imported beside torch {torch.__version__}: {reason}"
        raise RoadtorchError("torchvision", problem, hint) from error
    return torchvision
