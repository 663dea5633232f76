"""Small networks with known outputs."""

from collections.abc import Callable
from pathlib import Path

import torch

from roadtorch.layout.backbone_network import (
    Backbone,
    BackboneNetwork,
    BackboneNetworkSettings,
    Conv2dSame,
)
from roadtorch.layout.network_cues import EGO_OUTPUT
from roadtorch.layout.pretrained import WHEEL
from roadtorch.layout.weights import LayoutNetwork, save_network
from tests.draws import seeded_generator

CRISP = 40.0
"""Log odds by which the potential of the ego car rises from row to row where it begins."""


SMALL_BACKBONE = BackboneNetworkSettings(height=32, width=64, narrow=8, wide=8)


def write_random_network(
    path: Path,
    seed: int,
    make: Callable[[], LayoutNetwork] = lambda: BackboneNetwork(SMALL_BACKBONE),
) -> Path:
    """Write the weights of an untrained network."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        save_network(path, make(), {})
    return path


@torch.no_grad()
def write_ego_network(path: Path, bottom: float) -> Path:
    """Write a network for which a fraction ``bottom`` of the height is the ego car.

    ``bottom`` is below 0.45; 0 is no ego car. All classes of the layout are equally likely, and
    road has probability 0.5, whatever the image.
    """
    network = BackboneNetwork(SMALL_BACKBONE.model_copy(update={"height": 192})).eval()
    weights = dict(network.named_parameters())
    for values in weights.values():
        values.zero_()
    weights["head.position.weight"][0, 1] = 1  # the second plane of the place: how far down
    weights["head.narrowed.weight"][0, 0] = 1
    weights["head.scores.weight"][EGO_OUTPUT, 0] = 1
    depth = network(torch.zeros(1, 3, 192, 64))[0, EGO_OUTPUT, :, 0]
    first = round((1 - bottom) * len(depth))
    begins = torch.cat([depth, depth[-1:] + 1])[first - 1 : first + 1].mean()
    weights["head.scores.weight"][EGO_OUTPUT, 0] = CRISP
    weights["head.scores.bias"][EGO_OUTPUT] = -CRISP * begins
    save_network(path, network, {})
    return path


def write_wheel(folder: Path) -> dict[str, torch.Tensor]:
    """Write a package with weights of the right shapes, as the wheel of ImageNet's has them."""
    generator, state = seeded_generator(3), {}
    for layer, part in Backbone().named_modules():
        if isinstance(part, Conv2dSame):
            prefix, kind = layer.rpartition(".")[::2]
            block = prefix.replace("blocks", "_blocks") + "." if prefix else ""
            number = {"stem": 0, "expand": 0, "depthwise": 1, "project": 2}[kind]
            names = {"stem": "_conv_stem", "expand": "_expand_conv", "depthwise": "_depthwise_conv"}
            convolution = f"{block}{names.get(kind, '_project_conv')}.weight"
            state[convolution] = torch.randn(part.weight.shape, generator=generator) * 0.1
            for entry in ("weight", "bias", "running_mean", "running_var"):
                values = torch.rand(part.out_channels, generator=generator) + 0.5
                state[f"{block}_bn{number}.{entry}"] = values
    models = folder / WHEEL.replace("-", "_") / "models"
    models.mkdir(parents=True)
    (models.parent / "__init__.py").touch()
    torch.save(state, models / "weights.pth")
    return state
