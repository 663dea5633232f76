"""How the maps of an analysis are made, and what may be done with them."""

from collections.abc import Callable, Mapping

import pytest
import torch
from torch import Tensor, nn

from roadtorch import load_detector
from roadtorch.detector import lean
from roadtorch.imaging.resize import Maps, averaging_bands
from roadtorch.oneclass import base
from roadtorch.oneclass.axes import axes_of
from roadtorch.oneclass.density import floor_of
from roadtorch.superpixels import slic as superpixels
from tests.streets import scene


class Doubling(nn.Module):
    """Twice the first plane, at once and when asked for."""

    @lean
    def forward(self, image: Tensor) -> Mapping[str, Tensor | Callable[[], Tensor]]:
        return {"now": 2 * image[0], "later": lambda: 2 * image[0]}


@pytest.mark.parametrize("name", ["now", "later"])
def test_without_gradients_maps_are_ordinary_tensors_all_the_same(name: str) -> None:
    with torch.no_grad():
        found = Doubling()(torch.ones(3, 4, 4))

    weight = torch.ones((), requires_grad=True)
    (weight * found[name].add_(1)).sum().backward()  # neither is allowed in inference mode

    assert weight.grad == 16 * 3
    assert torch.equal(found[name], torch.full((4, 4), 2.0))  # the change was the caller's own


def test_gradients_that_are_asked_for_flow() -> None:
    image = torch.ones(3, 4, 4, requires_grad=True)

    Doubling()(image)["now"].sum().backward()

    assert image.grad is not None
    assert image.grad.sum() == 2 * 16


def test_deferred_maps_are_made_anew_and_only_when_asked_for() -> None:
    calls = []
    maps = Maps({"made": torch.zeros(2), "waiting": lambda: calls.append(1) or torch.ones(2)})

    assert list(maps) == ["made", "waiting"]
    assert len(maps) == 2
    assert calls == []
    assert torch.equal(maps["waiting"], maps["waiting"])
    assert calls == [1, 1]
    with pytest.raises(KeyError, match="missing"):
        maps["missing"]
    assert dict(maps.without("waiting").but(other=torch.ones(1))).keys() == {"made", "other"}


@pytest.mark.parametrize(
    "name", ["fusion", "fusion:untrained", "layout", "labeller", "cpf", "cpf:v2", "lbp"]
)
def test_detections_hold_ordinary_tensors(name: str) -> None:
    image = scene(1).image[:, ::2, ::2].contiguous()  # below the working size: nothing is resized

    found = load_detector(name).detect(image)

    for maps in (found.likelihood, found.mask, *found.cues.values()):
        assert not maps.is_inference()
    found.likelihood.mul_(0.5)
    assert float(found.likelihood.max()) <= 0.5


def test_what_is_kept_for_later_calls_is_no_tensor_of_inference_mode() -> None:
    grid, axes = superpixels._grid(17, 23, 6), axes_of(("R", "G"))  # nobody has asked for these
    with torch.inference_mode():
        kept = [
            *(band.weights for band in averaging_bands(41, 23, 8)),
            superpixels._places(grid, 1),
            *superpixels._moves(grid, 0.0123, 1),
            base._moves(axes),
            floor_of(axes),
        ]

    assert [tensor.is_inference() for tensor in kept] == [False] * len(kept)
