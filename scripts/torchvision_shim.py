"""The only way torchvision is imported: ``from scripts.torchvision_shim import torchvision``.

A torchvision wheel beside a CPU-only torch cannot load its compiled operators, and then
fails at import because it describes the results of operators that nobody declared
(pytorch/vision issues 9077 and 9085). Declaring the two it needs first is enough: we
use its networks, which are plain torch, and never those operators.
"""

from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import torch

OPERATORS = ("nms", "qnms")
SIGNATURE = "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor"


def declare_missing_operators() -> list[str]:
    """Declare the operators that torchvision's import needs and its library lacks.

    Returns their names: an empty list where torchvision fits torch, and on every later
    call. Raises ModuleNotFoundError when torchvision is not installed.
    """
    package = find_spec("torchvision")
    if package is None or package.origin is None:
        raise ModuleNotFoundError("torchvision is not installed", name="torchvision")
    for library in Path(package.origin).parent.glob("_C.*"):
        with suppress(OSError):  # the very misfit that this module is for
            torch.ops.load_library(library)
    missing = [name for name in OPERATORS if not hasattr(torch.ops.torchvision, name)]
    for name in missing:
        torch.library.define(f"torchvision::{name}", SIGNATURE)
    return missing


declare_missing_operators()

import torchvision  # noqa: E402  (only possible from here on)

__all__ = ["declare_missing_operators", "torchvision"]
