"""A pretended device for tests without a GPU: tensors report ``meta`` and are on the CPU.

As on a GPU, an operation on tensors of both devices is refused (but for scalars, and indices that
are on the CPU), and so is NumPy's view of one. Results are those of the CPU, to the bit.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("meta")


class Pretended(Tensor):
    """A tensor of the pretended device; ``plain`` is the tensor on the CPU."""

    plain: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> "Pretended":
        return torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls,
            inner.shape,
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            device=DEVICE,
        )

    def __init__(self, inner: Tensor) -> None:
        self.plain = inner

    def new_tensor(self, data: Any, *_: Any, **options: Any) -> Tensor:
        """Make a tensor without torch's shortcut, which makes one on the real ``meta``."""
        return Pretended(self.plain.new_tensor(data, **options))

    def tolist(self) -> Any:
        return self.plain.tolist()

    def __repr__(self, **_: Any) -> str:
        return f"Pretended({self.plain!r})"

    @classmethod
    def __torch_dispatch__(
        cls, operation: Any, types: Any, values: Sequence[Any] = (), named: Any = None
    ) -> Any:
        return _run(operation, values, named or {})


class PretendedDevice(TorchDispatchMode):
    """Mode in which torch knows the pretended device."""

    def __torch_dispatch__(
        self, operation: Any, types: Any, values: Sequence[Any] = (), named: Any = None
    ) -> Any:
        return _run(operation, values, named or {})


def move_to_pretended(module: nn.Module) -> nn.Module:
    """Move the parameters and buffers of a module to the pretended device."""
    for part in module.modules():
        for name, value in part._parameters.items():
            if value is not None:
                part._parameters[name] = nn.Parameter(Pretended(value.detach()), False)
        for name, value in part._buffers.items():
            if value is not None:
                part._buffers[name] = Pretended(value)
    return module


def _run(operation: Any, values: Sequence[Any], named: Mapping[str, Any]) -> Any:
    requested = named.get("device")
    device = None if requested is None else torch.device(requested).type
    inputs = [value for value in tree_leaves((values, named)) if isinstance(value, Tensor)]
    has_pretended = any(isinstance(value, Pretended) for value in inputs)
    options = {**named, "device": torch.device("cpu")} if device == DEVICE.type else named
    result = operation(*tree_map(_inner, values), **tree_map(_inner, options))
    scalar = not isinstance(result, Tensor | tuple | list)
    if scalar or device == "cpu" or not (has_pretended or device == DEVICE.type):
        return result
    indexing = "index" in operation._schema.name or "copy_" in operation._schema.name
    mixed = any(value.ndim > 0 and not isinstance(value, Pretended) for value in inputs)
    if device is None and mixed and not indexing:
        raise RuntimeError(f"{operation}: tensors on the pretended device and on the CPU")
    if operation._schema.name.endswith("_") and isinstance(values[0], Pretended):
        return values[0]
    return tree_map(lambda value: Pretended(value) if isinstance(value, Tensor) else value, result)


def _inner(value: Any) -> Any:
    return value.plain if isinstance(value, Pretended) else value
