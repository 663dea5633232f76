"""Networks inside detectors: which weights, and how they travel with the detector."""

from collections.abc import Callable, Mapping
from typing import TypeVar

from pydantic import Field
from torch import Tensor, nn

from roadtorch.errors import WeightsError
from roadtorch.layout.network import PatchNetwork
from roadtorch.layout.picture_network import PictureNetwork
from roadtorch.layout.weights import load_network, shipped_weights
from roadtorch.settings import Settings

Network = TypeVar("Network", PatchNetwork, PictureNetwork)


class Weights(Settings):
    """Which weights a network has."""

    file: str = Field(
        default="", description="weights of roadtorch train; empty: those that are shipped"
    )


def network_of(weights: Weights, shipped: str, kind: type[Network]) -> Network:
    """The network with the weights of a file, or with those shipped under a name.

    Raises WeightsError for a file that cannot be used, or holds another kind of network.
    """
    path = weights.file or shipped_weights(shipped)
    network = load_network(path)
    if not isinstance(network, kind):
        what = f"holds a network for {network.kind}, not for {kind.kind}"
        raise WeightsError(path, what, "use weights of that kind of training")
    return network


class WithNetwork(nn.Module):
    """An analysis that asks a network, whose weights become part of the detector."""

    def __init__(
        self, network: nn.Module, analyse: Callable[[Tensor], Mapping[str, Tensor]]
    ) -> None:
        super().__init__()
        self.network = network
        self._analyse = analyse

    def forward(self, image: Tensor) -> Mapping[str, Tensor]:
        """The cues of an image (3,H,W) in [0,1]."""
        return self._analyse(image)
