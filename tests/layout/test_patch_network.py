"""Patch networks: the family, one patch, every pixel, and sizes that do not fit."""

import numpy as np
import pytest
import torch

from roadtorch.base.errors import ConfigError
from roadtorch.base.settings import build_settings
from roadtorch.imaging.color import Exposure, brighten, color_plane
from roadtorch.layout.patch_network import (
    FIXED_GAIN,
    FIXED_MEAN,
    Normalisation,
    PatchNetwork,
    PatchNetworkSettings,
    Topology,
    connection_table,
    normalise,
    reflect_pad,
)
from tests.draws import seeded_generator
from tests.reference import network as reference
from tests.streets import scene

SHAPES = [
    Topology(),
    Topology(pooling="max", potentials="softmax"),
    Topology(size2=9, size3=5, k1=6, k2=10),
    Topology(patch=48, size1=5, size2=13, size3=5, subsamplings=2),
    Topology(patch=64, size1=13, size2=9, size3=9, subsamplings=2, pooling="max"),
    Topology(k1=6, connections=2),
    Topology(input="grey"),
]


def network_of(topology: Topology, **groups: object) -> PatchNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(7)
        values = {"topology": topology.model_dump(), **groups}
        return PatchNetwork(build_settings(PatchNetworkSettings, values)).eval()


def pixels(*size: int) -> torch.Tensor:
    return torch.randn(*size, generator=seeded_generator(size[-2]))


# --- the family -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "problem", "near"),
    [
        ({"size3": 5}, "ends in 3×3", "size3=7 would end in 1×1"),
        ({"patch": 64}, "ends in 17×17", "smaller patch"),
        ({"size1": 6}, "after size1", "7, 7, 7"),
        ({"size2": 13, "size3": 9}, "after size3", "7, 7, 7"),
        ({"connections": 5}, "is 5, but the first layer has 4 kernels", "give 0 to 4"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(values: dict[str, int], problem: str, near: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build_settings(PatchNetworkSettings, {"topology": values})
    assert problem in caught.value.problem
    assert near in caught.value.hint


def test_a_partial_table_uses_all_maps_equally_often() -> None:
    table = connection_table(6, 60, 3)
    assert table.sum(1).unique().tolist() == [3]
    assert table.sum(0).tolist() == [30] * 6
    assert table[5].nonzero()[:, 0].tolist() == [0, 1, 5]
    assert bool(connection_table(4, 16, 0).all())


def test_unconnected_maps_have_no_effect_and_no_gradient() -> None:
    network = network_of(Topology(k1=6, connections=2))
    patches = pixels(3, 3, 32, 32)
    away = network.get_buffer("table").expand_as(network.second.weight) == 0

    potentials = network(patches)
    potentials.square().sum().backward()
    gradient = network.second.weight.grad
    with torch.no_grad():
        network.second.weight[away] = 100.0

    assert torch.equal(network(patches), potentials)
    assert "table" not in network.state_dict()
    assert gradient is not None
    assert gradient[away].abs().max() == 0
    assert gradient[~away].abs().max() > 0


def test_a_grey_network_depends_on_luma_alone() -> None:
    network = network_of(Topology(input="grey"))
    colourful = pixels(2, 3, 32, 32)
    grey = color_plane(colourful, "grey").unsqueeze(1).expand(-1, 3, -1, -1)
    assert tuple(network.first.weight.shape) == (4, 1, 7, 7)
    torch.testing.assert_close(network(colourful), network(grey), atol=1e-5, rtol=0)


# --- one patch and every pixel ---------------------------------------------------------------


@pytest.mark.parametrize("topology", [SHAPES[0], SHAPES[1], SHAPES[3]], ids=str)
def test_a_patch_gives_the_result_of_its_layers_one_by_one(topology: Topology) -> None:
    network, patch = network_of(topology), pixels(3, topology.patch, topology.patch)
    weights = {name: value.double().numpy() for name, value in network.state_dict().items()}

    potentials = network(patch[None])[0]

    ends = (topology.subsamplings, topology.pooling, topology.potentials)
    expected = reference.potentials(patch.double().numpy(), weights, *ends)
    np.testing.assert_allclose(potentials.detach().numpy(), expected, atol=1e-5)


@pytest.mark.parametrize("topology", SHAPES, ids=str)
def test_dense_equals_the_network_patch_by_patch(topology: Topology) -> None:
    network, image = network_of(topology), pixels(3, 5, 8)
    places = [(0, 0), (4, 7), (2, 6), (3, 6)]
    around = [
        reference.patch_around(image.numpy(), row, column, topology.patch) for row, column in places
    ]

    dense = network.forward_dense(image)

    # Every position, cut by unfolding; and some whose patches are cut pixel by pixel.
    cut = reflect_pad(image, topology.patch).unfold(1, topology.patch, 1)
    cut = cut.unfold(2, topology.patch, 1).permute(1, 2, 0, 3, 4).flatten(0, 1)
    torch.testing.assert_close(dense.flatten(1), network(cut).T, atol=1e-5, rtol=0)
    cut_by_pixel = network(torch.from_numpy(np.stack(around)).float())
    rows, columns = zip(*places, strict=True)
    torch.testing.assert_close(dense[:, rows, columns], cut_by_pixel.T, atol=1e-5, rtol=0)
    # Of several images, and of one pixel.
    torch.testing.assert_close(network.forward_dense(image.expand(2, -1, -1, -1))[1], dense)
    assert network.forward_dense(image[:, :1, :1]).shape == (3, 1, 1)


# --- images --------------------------------------------------------------------------------


def test_images_are_normalised_by_constants_after_their_exposure() -> None:
    image = scene(2).image * 0.1

    fixed, brightened = (
        normalise(image, Normalisation.model_validate({"kind": kind}))
        for kind in ("fixed", "brightened")
    )

    torch.testing.assert_close(fixed / FIXED_GAIN + FIXED_MEAN, image)
    torch.testing.assert_close(brightened / FIXED_GAIN + FIXED_MEAN, brighten(image, Exposure()))
