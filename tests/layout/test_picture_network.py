"""The networks for whole pictures: ours, and that on a backbone's features with its weights."""

from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from roadtorch.layout.backbone_network import BackboneNetwork, BackboneNetworkSettings, SamePadded
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings, scaled
from roadtorch.layout.weights import load_network, network_at, save_network, shipped_weights
from tests.draws import seeded

SMALL = PictureNetworkSettings(height=48, width=64, narrow=8, wide=16)


@pytest.fixture(scope="module")
def backbone() -> BackboneNetwork:
    torch.manual_seed(3)
    settings = BackboneNetworkSettings(height=64, width=96, wide=8, narrow=8, heads=2)
    return BackboneNetwork(settings).eval()


@pytest.mark.parametrize("size", [(16, 16), (50, 61), (100, 333)])
def test_cues_are_potentials_of_its_size(size: tuple[int, int], backbone: BackboneNetwork) -> None:
    for network in (backbone, PictureNetwork(SMALL)):
        cues = network.cues(torch.rand(3, *size, generator=seeded(0)))
        assert cues["layout"].shape == (3, *size)
        assert cues["road"].shape == cues["ego"].shape == size
        assert all(0 <= float(maps.min()) <= float(maps.max()) <= 1 for maps in cues.values())
        torch.testing.assert_close(cues["layout"].sum(0), torch.ones(size))


# --- ours ----------------------------------------------------------------------------------


def test_the_same_weights_see_pictures_of_another_size() -> None:
    network = PictureNetwork(SMALL).eval()
    pixels = torch.rand(1, 3, 64, 88, generator=seeded(0))

    other = network_at(network, 64, 88)

    assert (other.settings.height, other.settings.width) == (64, 88)
    assert other.settings.wide == SMALL.wide
    assert not other.training
    torch.testing.assert_close(other(pixels), network(pixels))
    assert network.settings == SMALL


# --- on a backbone -------------------------------------------------------------------------


@pytest.mark.parametrize(("kernel", "pads"), [(3, (0, 1)), (5, (1, 2))])
def test_stride_two_is_padded_as_in_tensorflow(kernel: int, pads: tuple[int, int]) -> None:
    layer, maps = SamePadded(1, 1, kernel, 2), torch.rand(1, 1, 8, 8)

    wanted = F.conv2d(F.pad(maps, pads * 2), layer.weight, layer.bias, 2)

    torch.testing.assert_close(layer(maps), wanted)
    assert wanted.shape[-2:] == (4, 4)


def test_it_comes_back_from_half_precision(backbone: BackboneNetwork, tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    save_network(path, backbone, {})
    assert path.stat().st_size < 2.2 * sum(value.numel() for value in backbone.parameters())

    image = torch.rand(3, 64, 96, generator=seeded(0))
    loaded = load_network(path)
    assert isinstance(loaded, BackboneNetwork)
    before, after = (network.cues(image)["road"] for network in (backbone, loaded))
    torch.testing.assert_close(after, before, rtol=0, atol=0.01)


def test_the_shipped_weights_say_what_the_backbone_has_seen() -> None:
    path = shipped_weights("backbone-free")
    assert isinstance(load_network(path), BackboneNetwork)
    assert "ImageNet" in path.with_suffix(".md").read_text()
    assert path.stat().st_size < 6_000_000


@pytest.mark.parametrize(
    ("size", "scale", "seen"),
    [
        ((192, 256), 1.0, (192, 256)),
        ((192, 256), 4 / 3, (256, 352)),  # multiples of 32
        ((120, 160), 1.0, (120, 160)),  # its own, which is none
        ((32, 32), 0.5, (32, 32)),  # never nothing
    ],
)
def test_multiples_of_32_pixels(size: tuple[int, int], scale: float, seen: tuple[int, int]) -> None:
    assert scaled(*size, scale) == seen
