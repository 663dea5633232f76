"""The network for whole pictures."""

import pytest
import torch

from roadtorch.layout.picture_network import (
    OUTPUTS,
    PictureNetwork,
    PictureNetworkSettings,
    place_planes,
    potentials_of,
)
from roadtorch.layout.weights import network_at
from tests.streets import scene

SMALL = PictureNetworkSettings(height=48, width=64, narrow=8, wide=16)


def test_it_has_at_most_a_few_hundred_thousand_weights() -> None:
    assert sum(weight.numel() for weight in PictureNetwork().parameters()) < 500_000


@pytest.mark.parametrize("size", [(16, 16), (100, 333)])
def test_cues_have_the_size_of_the_picture(size: tuple[int, int]) -> None:
    image = torch.nn.functional.interpolate(scene(1).image[None], size=size)[0]

    cues = PictureNetwork(SMALL).cues(image)

    assert cues["layout"].shape == (3, *size)
    torch.testing.assert_close(cues["layout"].sum(0), torch.ones(size))
    for name in ("road", "ego"):
        assert cues[name].shape == size
        assert 0 <= float(cues[name].min()) <= float(cues[name].max()) <= 1


def test_a_mirrored_picture_has_the_same_place() -> None:
    planes = place_planes(torch.zeros(2, 3, 8, 16))

    torch.testing.assert_close(planes, planes.flip(-1))
    assert planes.shape == (2, 2, 8, 16)
    assert (planes[0, 1].diff(dim=0) > 0).all()
    assert float(planes.min()) >= -1
    assert float(planes.max()) <= 1


def test_pictures_of_a_batch_do_not_touch_each_other() -> None:
    network = PictureNetwork(SMALL)
    pixels = torch.randn(3, 3, 48, 64, generator=torch.Generator().manual_seed(1))

    together = network(pixels)

    assert together.shape == (3, OUTPUTS, 24, 32)
    alone = torch.cat([network(one[None]) for one in pixels])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=1e-4)


def test_every_output_sees_almost_the_whole_picture() -> None:
    torch.manual_seed(0)  # one random network in hundreds is dead at this very place
    network = PictureNetwork(PictureNetworkSettings(narrow=8, wide=16))
    pixels = torch.randn(1, 3, 120, 160, requires_grad=True)

    network(pixels)[0, 0, 30, 40].backward()

    assert pixels.grad is not None
    seen = pixels.grad[0].abs().sum(0) > 0
    assert seen.float().mean() > 0.9


def test_scores_become_shares_a_road_and_an_ego_car() -> None:
    scores = torch.tensor([1.0, 2.0, 3.0, 0.0, 1.0]).reshape(1, 5, 1, 1)

    potentials = potentials_of(scores).flatten()

    torch.testing.assert_close(potentials[:3], torch.tensor([1.0, 2.0, 3.0]).softmax(0))
    assert potentials[3] == 0.5
    assert potentials[4] == torch.tensor(1.0).sigmoid()


def test_the_same_weights_see_pictures_of_another_size() -> None:
    network = PictureNetwork(SMALL).eval()
    pixels = torch.rand(1, 3, 64, 88, generator=torch.Generator().manual_seed(0))

    other = network_at(network, 64, 88)

    assert (other.settings.height, other.settings.width) == (64, 88)
    assert other.settings.wide == SMALL.wide
    assert not other.training
    torch.testing.assert_close(other(pixels), network(pixels))
    assert network.settings == SMALL
