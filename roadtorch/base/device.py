"""Where tensors are: a device of torch that this machine has."""

from roadtorch.base.errors import ConfigError


def check_device(device: str, where: str) -> None:
    """Raises ConfigError, which names ``where``, for a device that torch or this machine lacks."""
    import torch

    try:
        kind = torch.device(device).type
    except RuntimeError:
        raise ConfigError(where, "is no device of torch", "give cpu, cuda or cuda:1") from None
    try:
        torch.zeros(1, device=device).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as problem:
        what = f"cannot be used: {str(problem).splitlines()[0].rstrip('.')}"
        remedy = "leave it out" if kind == "cuda" else "give cpu, cuda or cuda:1"
        raise ConfigError(where, what, remedy) from None
