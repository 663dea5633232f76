"""The floor that data sets teach: the mean road mask of other drives."""

from collections.abc import Collection

import torch
from torch import Tensor
from torch.nn import functional

from roadtorch.data.dataset import Dataset


def road_shares(dataset: Dataset) -> dict[str, Tensor]:
    """How often each pixel is road, by drive: float64 (H,W) in [0,1] ("" without drives).

    The share of a drive's pictures that show road at that place, among those that have
    truth there. All are brought to the size of the set's first label.
    """
    road: dict[str, Tensor] = {}
    valid: dict[str, Tensor] = {}
    size: torch.Size | None = None
    for item in dataset.items:
        truth = dataset.truth(item)
        group, size = item.group or "", size or truth.road.shape
        for sums, mask in ((road, truth.road), (valid, truth.valid)):
            sums[group] = sums.get(group, 0) + resize(mask.to(torch.float64), size)
    return {group: road[group] / valid[group].clamp(min=1e-9) for group in road}


def mean_of(shares: dict[str, Tensor]) -> Tensor:
    """The mean over drives, each with the same weight as in the headline figures."""
    return torch.stack(list(shares.values())).mean(0).clamp(0, 1)


def means_of_others(shares: dict[str, Tensor], left_out: Collection[str] = ()) -> dict[str, Tensor]:
    """For every drive the mean of the other ones; empty when there is no other one.

    left_out: drives that teach nobody.
    """
    teachers = {name: share for name, share in shares.items() if name not in left_out}
    if len(teachers) < 2:
        return {}
    return {
        group: mean_of({name: share for name, share in teachers.items() if name != group})
        for group in shares
    }


def resize(values: Tensor, size: tuple[int, int] | torch.Size) -> Tensor:
    """Bring a map (H,W) to another size, linearly."""
    if values.shape == tuple(size):
        return values
    return functional.interpolate(values[None, None], size=tuple(size), mode="bilinear")[0, 0]
