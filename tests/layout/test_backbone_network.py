"""The network on a backbone's features, and the weights that ship for it."""

from pathlib import Path

import pytest
import torch
from torch.nn import functional as F

from roadtorch import load_detector
from roadtorch.detectors.fusion import Fusion
from roadtorch.layout.backbone_network import (
    BLOCKS,
    Backbone,
    BackboneNetwork,
    BackboneNetworkSettings,
    SamePadded,
)
from roadtorch.layout.weights import load_network, save_network, shipped_weights, terms_of

SMALL = BackboneNetworkSettings(height=64, width=96, wide=8, narrow=8, heads=2)


@pytest.fixture(scope="module")
def network() -> BackboneNetwork:
    torch.manual_seed(3)
    return BackboneNetwork(SMALL).eval()


@pytest.mark.parametrize("size", [(16, 16), (50, 61), (240, 320)])
def test_cues_are_potentials_of_the_size_of_the_image(
    network: BackboneNetwork, size: tuple[int, int]
) -> None:
    cues = network.cues(torch.rand(3, *size))

    assert cues["layout"].shape == (3, *size)
    assert cues["road"].shape == cues["ego"].shape == size
    assert all(float(maps.min()) >= 0 and float(maps.max()) <= 1 for maps in cues.values())
    torch.testing.assert_close(cues["layout"].sum(0), torch.ones(size))


def test_the_backbone_gives_a_map_at_each_of_four_scales(network: BackboneNetwork) -> None:
    maps = network.backbone(torch.rand(1, 3, 64, 96))

    assert [tuple(each.shape[1:]) for each in maps] == [
        (24, 16, 24),
        (40, 8, 12),
        (112, 4, 6),
        (192, 2, 3),
    ]


@pytest.mark.parametrize(("kernel", "pads"), [(3, (0, 1)), (5, (1, 2))])
def test_a_convolution_of_stride_two_is_padded_as_in_tensorflow(
    kernel: int, pads: tuple[int, int]
) -> None:
    one = SamePadded(1, 1, kernel, 2)
    maps = torch.rand(1, 1, 8, 8)

    wanted = F.conv2d(F.pad(maps, pads * 2), one.weight, one.bias, 2)

    torch.testing.assert_close(one(maps), wanted)
    assert wanted.shape[-2:] == (4, 4)


def test_maps_are_added_only_where_shapes_allow() -> None:
    added = [block.added for block in Backbone().blocks]  # type: ignore[union-attr]

    assert added == [one.stride == 1 and one.inputs == one.outputs for one in BLOCKS]


def test_it_is_written_in_half_precision_and_comes_back(
    network: BackboneNetwork, tmp_path: Path
) -> None:
    path = tmp_path / "weights.safetensors"
    save_network(path, network, {})
    weights = sum(value.numel() for value in network.parameters())

    loaded = load_network(path)

    assert path.stat().st_size < 2.2 * weights
    image = torch.rand(3, 64, 96)
    torch.testing.assert_close(
        loaded.cues(image)["road"], network.cues(image)["road"], rtol=0, atol=0.01
    )


def test_the_shipped_weights_are_free_and_say_what_the_backbone_has_seen() -> None:
    path = shipped_weights("backbone-free")

    assert isinstance(load_network(path), BackboneNetwork)
    assert terms_of(path).startswith("anything: Apache-2.0")
    assert "ImageNet" in path.with_suffix(".md").read_text()
    assert path.stat().st_size < 6_000_000


def test_fusion_large_sees_at_half_again_the_size() -> None:
    networks = []
    for name in ("fusion", "fusion:large"):
        analysis = load_detector(name).analysis
        assert isinstance(analysis, Fusion)
        networks.append(analysis.network.settings)

    one, other = networks
    assert (other.height, other.width) == (1.5 * one.height, 1.6 * one.width)
    assert {**other.model_dump(), "height": one.height, "width": one.width} == one.model_dump()
