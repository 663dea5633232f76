"""Weight files: a network with everything needed to run it, in one safetensors file."""

import copy
import json
import os
import re
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, TypeVar

import torch
from pydantic import BaseModel, Field, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from roadtorch.base.atomic import atomic
from roadtorch.base.bounded import reason
from roadtorch.base.errors import ConfigError, WeightsError, shortened
from roadtorch.base.settings import Settings, build_settings
from roadtorch.layout.backbone_network import BackboneNetwork, BackboneNetworkSettings
from roadtorch.layout.image_network import ImageNetwork, ImageNetworkSettings
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings

FORMAT = 1
"""Of the metadata; raised when older code could not read it."""

HEADER = "roadtorch"
"""The one key of the metadata: safetensors writes several keys in no settled order."""

MISFIT = 200  # letters of what torch says where weights do not fit

SHIPPED = Path(__file__).parents[1] / "weights"
"""Where the weights lie that come with roadtorch."""

TERMS = re.compile(r"^\|\s*terms\s*\|\s*(.+?)\s*\|$", re.MULTILINE)
"""The row of a card, NAME.md beside the weights, that says what they may be used for."""

NETWORKS = {
    PatchNetwork.kind: (PatchNetwork, PatchNetworkSettings),
    ImageNetwork.kind: (ImageNetwork, ImageNetworkSettings),
    BackboneNetwork.kind: (BackboneNetwork, BackboneNetworkSettings),
}

WholeImageNetwork = ImageNetwork | BackboneNetwork
"""Say layout, road and ego car of a whole image."""

LayoutNetwork = PatchNetwork | WholeImageNetwork


def save_network(
    path: str | os.PathLike[str], network: LayoutNetwork, origin: Mapping[str, Any]
) -> None:
    """Write a network with its settings and where it comes from (anything JSON can hold).

    The same network and origin give the same bytes. Raises InputError when the folder
    cannot be written.
    """
    tensors = {
        name: value.to(_stored_type(network, value)).contiguous()
        for name, value in network.state_dict().items()
    }
    header = {
        "format": FORMAT,
        "kind": network.kind,
        "settings": network.settings.model_dump(),
        "origin": dict(origin),
        "sha256": tensors_hash(tensors),
    }
    data = save(tensors, {HEADER: json.dumps(header, sort_keys=True)})
    with atomic(path) as temporary:
        temporary.write_bytes(data)


def _stored_type(network: nn.Module, values: Tensor) -> torch.dtype:
    """How values are written: those of large networks in half precision, half the bytes."""
    half = isinstance(network, BackboneNetwork) and values.is_floating_point()
    return torch.float16 if half else values.dtype


def load_network(path: str | os.PathLike[str]) -> LayoutNetwork:
    """The network of a weight file, ready for use.

    Raises WeightsError for a file that is missing, damaged, foreign, of a newer format, or whose
    tensors do not fit its settings or are not finite.
    """
    header, tensors = _read(Path(path))
    network_class, settings_class = NETWORKS[header.kind]
    try:
        network = network_class(build_settings(settings_class, header.settings))
    except ConfigError as error:
        message = f"was made for other settings: {error.where} {error.problem}"
        raise WeightsError(path, message, "use the roadtorch that made it") from None
    fill(network, tensors, path)
    return network.eval()


def network_at(network: WholeImageNetwork, height: int, width: int) -> WholeImageNetwork:
    """The same weights for images of another size: convolutions know none."""
    other = copy.deepcopy(network)
    sized = network.settings.model_copy(update={"height": height, "width": width})
    other.settings = sized  # pyright: ignore[reportAttributeAccessIssue]  # of its own kind
    return other


def shipped_weights(name: str) -> Path:
    """The weight file that comes with roadtorch under that name, such as ``cnn-7``."""
    return SHIPPED / f"{name}.safetensors"


def list_shipped_weights() -> list[str]:
    """The names of all that come with roadtorch, sorted."""
    return sorted(path.stem for path in SHIPPED.glob("*.safetensors"))


def weights_path(text: str) -> Path:
    """The file that a setting names: a file, or else one that is shipped under that name."""
    shipped = shipped_weights(text)
    named = "/" not in text and not Path(text).exists() and shipped.exists()
    return shipped if named else Path(text)


def terms_of(path: Path) -> str:
    """What weights may be used for, as the card beside them says; nothing where none does."""
    row = TERMS.search(card_of(path))
    return row[1] if row else ""


def read_origin(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Where the weights of a file come from; WeightsError as for ``load_network``."""
    return _read(Path(path))[0].origin


def people_behind(path: str | os.PathLike[str]) -> list[Mapping[str, Any]]:
    """The corrections of people that weights were trained with, run by run; none: label-free.

    Each says how many ``images`` and ``pixels``. WeightsError as for ``load_network``.
    """
    runs = read_origin(path).get("corrections")
    return [run for run in runs if isinstance(run, dict)] if isinstance(runs, list) else []


def corrected_images(settings: Mapping[str, Any]) -> int:
    """How many images that people corrected are behind a detector's settings; 0: label-free."""
    groups = [settings.get(name) for name in ("weights", "second")]
    files = [group.get("file") for group in groups if isinstance(group, Mapping)]
    runs = [run for file in files if file for run in people_behind(weights_path(file))]
    return sum(int(run.get("images", 0)) for run in runs)


def fill(network: nn.Module, tensors: Mapping[str, Tensor], path: str | os.PathLike[str]) -> None:
    """Give a network its weights.

    Raises WeightsError when a name or a shape differs, and for values that are not finite.
    """
    try:
        network.load_state_dict(dict(tensors))
    except RuntimeError as error:
        _, first, *_ = str(error).splitlines()
        message = f"holds another network: {shortened(first.strip(), MISFIT)}"
        raise WeightsError(path, message, "use weights of this network") from None
    for name, values in network.state_dict().items():
        if not values.isfinite().all():
            message = f"holds weights in {name} that are not finite"
            raise WeightsError(path, message, "fetch or train it again")


def tensors_hash(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of named tensors: names in their order, types, shapes and bytes."""
    digest = sha256()
    for name, value in sorted(tensors.items()):
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        digest.update(value.detach().cpu().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


class _Header(BaseModel):
    """The header of a weight file; files of earlier versions state no hash."""

    format: int
    kind: Literal["patches", "images", "images, backbone"]
    settings: dict[str, Any]
    origin: dict[str, Any]
    sha256: str | None = None


def _read(path: Path) -> tuple[_Header, dict[str, Tensor]]:
    """Return the header and the tensors of a weight file of ours."""
    if not path.is_file():
        raise WeightsError(path, "is not a file", "give a .safetensors file")
    try:
        with safe_open(path, "pt") as file:
            header = _Header.model_validate_json((file.metadata() or {}).get(HEADER, ""))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except ValidationError:
        raise WeightsError(path, "has no header of roadtorch's", "give weights of ours") from None
    except (SafetensorError, OSError, RuntimeError) as error:  # torch, which maps it, the last
        message = f"is damaged or no weight file: {reason(error)}"
        raise WeightsError(path, message, "fetch or train it again") from None
    if header.format > FORMAT:
        message = f"has the format {header.format}; this roadtorch reads up to {FORMAT}"
        raise WeightsError(path, message, "install a newer roadtorch")
    if header.sha256 is not None and header.sha256 != tensors_hash(tensors):
        message = "is damaged: its weights are not those that its header states"
        raise WeightsError(path, message, "fetch or train it again")
    return header, tensors


def card_of(path: Path) -> str:
    """Return the card beside a weight file; nothing where there is none."""
    card = path.with_suffix(".md")
    return card.read_text(encoding="utf-8", errors="replace") if card.is_file() else ""


# --- the network of a detector ----------------------------------------------------------


Network = TypeVar("Network", bound=LayoutNetwork)

FOR_IMAGES = "backbone-free"
"""The shipped weights that `fusion` takes unless told otherwise."""


class WeightsFile(Settings):
    """Which weights a network has."""

    file: str = Field(
        default="",
        description="weights of roadtorch train, or the name of shipped ones, such as layout-free; "
        "empty: those that the detector comes with",
    )


def network_of(weights: WeightsFile, shipped: str, *kinds: type[Network]) -> Network:
    """The network with the weights of a file, or with those shipped under a name.

    Raises WeightsError for a file that cannot be used, or holds another kind of network.
    """
    path = weights_path(weights.file or shipped)
    network = load_network(path)
    if not isinstance(network, kinds):
        wanted = " or ".join(kind.kind for kind in kinds)
        message = f"holds a network for {network.kind}, not for {wanted}"
        raise WeightsError(path, message, "use weights of that kind of training")
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # stubs lack it
    return network


def image_network_of(weights: WeightsFile, shipped: str) -> WholeImageNetwork:
    """The same for a network that sees whole images.

    It has run once: torch makes the programs of its convolutions in the first run, which takes
    twice as long as a later one.
    """
    network = network_of(weights, shipped, ImageNetwork, BackboneNetwork)
    network.cues(torch.zeros(3, network.settings.height, network.settings.width))
    return network
