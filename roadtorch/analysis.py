"""How the maps of an analysis are made: without bookkeeping that nobody asked for."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from functools import wraps
from typing import Any

import torch
from torch import Tensor


class Deferred(Mapping[str, Tensor]):
    """Maps by name, of which some are made when they are asked for, and made again each time.

    Maps made in torch's inference mode are copied each time, so that whoever gets them may do with
    them what can be done with any tensor.
    """

    def __init__(self, made: Mapping[str, Tensor | Callable[[], Tensor]]) -> None:
        self._made = made

    def __getitem__(self, name: str) -> Tensor:
        """The map of that name; KeyError where there is none."""
        made = self._made[name]
        found = made if isinstance(made, Tensor) else made()
        return found.clone() if found.is_inference() else found

    def __iter__(self) -> Iterator[str]:
        """The names of all maps."""
        return iter(self._made)

    def __len__(self) -> int:
        """How many maps there are."""
        return len(self._made)


Forward = Callable[[Any, Tensor], Mapping[str, Tensor | Callable[[], Tensor]]]
"""The ``forward`` of an analysis: image (3,H,W) in [0,1] → maps by name, or what makes them."""


def lean(forward: Forward) -> Callable[[Any, Tensor], Deferred]:
    """Mark the ``forward`` of an analysis: in inference mode, where no gradients are asked for.

    On the CPU: there what autograd notes of a thousand small kernels takes a fifteenth of the time.
    For analyses of our own: others may want gradients inside.
    """

    @wraps(forward)
    def wrapped(self: Any, image: Tensor) -> Deferred:
        quick = image.device.type == "cpu" and not torch.is_grad_enabled()
        with torch.inference_mode() if quick else nullcontext():
            return Deferred(forward(self, image))

    return wrapped
