"""The only import of torchvision, made to work with any build of torch."""

from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import torch

from roadtorch.base.errors import RoadtorchError

UNDECLARED_OPERATORS = ("nms", "qnms")
OPERATOR_SIGNATURE = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"


@cache
def import_torchvision() -> ModuleType:
    """Import torchvision with its ``transforms.v2``, and return it.

    With a CPU-only torch, its wheels cannot load their compiled operators, and then fail at
    import because they describe the results of undeclared operators (pytorch/vision issues 9077
    and 9085). Declaring these two first is enough: what is plain torch works. Raises RoadtorchError
    if torchvision is missing or made for another version of torch.
    """
    hint = "pip install the torchvision that belongs to it, see docs/installation.md"
    package = find_spec("torchvision")
    if package is None or package.origin is None:
        raise RoadtorchError("torchvision", "is not installed", hint)
    for library in Path(package.origin).parent.glob("_C.*"):
        with suppress(OSError):  # built for another torch
            torch.ops.load_library(library)
    for name in UNDECLARED_OPERATORS:
        if not hasattr(torch.ops.torchvision, name):
            torch.library.define(f"torchvision::{name}", OPERATOR_SIGNATURE)
    try:
        import torchvision.transforms.v2
    except Exception as error:  # another build fails in many ways
        cause = (str(error).splitlines() or [""])[0]
        problem = f"cannot be imported beside torch {torch.__version__}: {cause}"
        raise RoadtorchError("torchvision", problem, hint) from error
    return torchvision
