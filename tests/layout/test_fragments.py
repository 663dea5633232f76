"""A patch network fragment by fragment: its pieces against what they stand for."""

import pytest
import torch
from torch.nn import functional as F

from roadtorch.layout import fragments
from roadtorch.layout.fragments import Layer, after, convolved, put_fragments, side_by_side
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.settings import build_settings


def random(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(len(shape)))


def test_side_by_side_says_what_the_layer_says_at_every_place() -> None:
    layer, maps = Layer(random(3, 5, 4, 4), random(3)), random(9, 13, 5)

    found = convolved(maps, side_by_side(layer, 2, 5), (2, 5))

    one_by_one = convolved(maps, layer)
    for row in range(6):
        for column in range(10):
            block = found[row // 2, column // 5].view(2, 5, 3)
            torch.testing.assert_close(
                block[row % 2, column % 5], one_by_one[row, column], atol=1e-5, rtol=0
            )


@pytest.mark.parametrize("channels", [3, 8])
@pytest.mark.parametrize("pooling", ["mean", "max"])
def test_fragments_are_subsampled_from_each_place(
    channels: int, pooling: fragments.Pooling
) -> None:
    maps = random(7, 11, channels)
    found = torch.empty(2, 2, 3, 5, channels)

    put_fragments(maps, pooling, found)

    pool = F.avg_pool2d if pooling == "mean" else F.max_pool2d
    weight = after(Layer(torch.ones(1, 1, 1, 1), torch.zeros(1)), pooling).weight
    for row in range(2):
        for column in range(2):
            part = pool(maps.permute(2, 0, 1)[:, row:, column:], 2)
            torch.testing.assert_close(found[row, column] * weight[0], part.permute(1, 2, 0))


@pytest.mark.parametrize(
    "values", [{}, {"patch": 48, "size1": 5, "size2": 13, "size3": 5, "subsamplings": 2}], ids=str
)
@pytest.mark.parametrize("size", [(1, 1), (16, 30), (61, 45)])
def test_bands_do_not_change_what_is_found(
    values: dict[str, int], size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = Topology.model_validate(values)
    with torch.random.fork_rng():
        torch.manual_seed(7)
        network = PatchNetwork(
            build_settings(PatchNetworkSettings, {"topology": shape.model_dump()})
        ).eval()
    picture = random(3, *size)
    whole = network.dense(picture)

    monkeypatch.setattr(fragments, "BAND", 200)

    assert network.dense(picture).shape == (3, *size)
    torch.testing.assert_close(network.dense(picture), whole, atol=1e-6, rtol=0)
    torch.testing.assert_close(network.everywhere(picture[None])[0], whole, atol=1e-5, rtol=0)
