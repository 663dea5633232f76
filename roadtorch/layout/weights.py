"""Weight files: a network with its settings and origin in one safetensors file."""

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

from roadtorch.base.atomic import atomic_write
from roadtorch.base.bounded import reason
from roadtorch.base.errors import ConfigError, WeightsError, truncate_middle
from roadtorch.base.settings import Settings, build_settings, list_shipped, resolve_name
from roadtorch.layout.backbone_network import BackboneNetwork, BackboneNetworkSettings
from roadtorch.layout.network_cues import compute_cues
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings

FORMAT_VERSION = 1
"""Version of the metadata; raised when older code cannot read it."""

HEADER_KEY = "roadtorch"
"""The only key of the metadata: safetensors writes several keys in no fixed order."""

MAX_MISMATCH_LENGTH = 200  # characters quoted of torch's message about a mismatch

SHIPPED = Path(__file__).parents[1] / "weights"
"""Folder of the weights that come with roadtorch."""

WEIGHTS_SUFFIX = ".safetensors"

TERMS_ROW = re.compile(r"^\|\s*terms\s*\|\s*(.+?)\s*\|$", re.MULTILINE)
"""Row of a card, the NAME.md beside the weights, that states their terms of use."""

NETWORKS = {
    PatchNetwork.kind: (PatchNetwork, PatchNetworkSettings),
    BackboneNetwork.kind: (BackboneNetwork, BackboneNetworkSettings),
}

LayoutNetwork = PatchNetwork | BackboneNetwork


def build_network(settings: Settings) -> LayoutNetwork:
    """Return a new network with these settings, from torch's global generator."""
    kinds: dict[type, Any] = {
        settings_class: network for network, settings_class in NETWORKS.values()
    }
    return kinds[type(settings)](settings)


def save_network(
    path: str | os.PathLike[str], network: LayoutNetwork, origin: Mapping[str, object]
) -> None:
    """Write a network with its settings and origin (as JSON); equal input gives equal bytes.

    Raises InputError if the file cannot be written.
    """
    tensors = {
        name: value.to(_storage_dtype(network, value)).contiguous()
        for name, value in network.state_dict().items()
    }
    header = {
        "format": FORMAT_VERSION,
        "kind": network.kind,
        "settings": network.settings.model_dump(),
        "origin": dict(origin),
        "sha256": hash_tensors(tensors),
    }
    data = save(tensors, {HEADER_KEY: json.dumps(header, sort_keys=True)})
    with atomic_write(path) as temporary:
        temporary.write_bytes(data)


def _storage_dtype(network: nn.Module, values: Tensor) -> torch.dtype:
    """Return the type in which values are written: half precision for large networks."""
    half = isinstance(network, BackboneNetwork) and values.is_floating_point()
    return torch.float16 if half else values.dtype


def load_network(path: str | os.PathLike[str]) -> LayoutNetwork:
    """Load the network of a weight file, in evaluation mode.

    Raises WeightsError for a file that is missing, damaged, foreign or of a newer format, or whose
    tensors do not fit its settings or are not finite.
    """
    header, tensors = _read(Path(path))
    network_class, settings_class = NETWORKS[header.kind]
    try:
        network = network_class(build_settings(settings_class, header.settings))
    except ConfigError as error:
        message = f"has settings that this version cannot use: {error.where} {error.problem}"
        raise WeightsError(path, message, "use the version of roadtorch that wrote it") from None
    load_tensors(network, tensors, path)
    return network.eval()


def resize_network(network: BackboneNetwork, height: int, width: int) -> BackboneNetwork:
    """Return a copy of a convolutional network for images of another size."""
    resized = copy.deepcopy(network)
    settings = network.settings.model_copy(update={"height": height, "width": width})
    resized.settings = settings
    return resized


def shipped_weights(name: str) -> Path:
    """Return the path of the shipped weights of that name, such as ``cnn-7``."""
    return SHIPPED / f"{name}{WEIGHTS_SUFFIX}"


def list_shipped_weights() -> list[str]:
    """Return the names of all shipped weights, sorted."""
    return list_shipped(SHIPPED, WEIGHTS_SUFFIX)


def weights_path(text: str) -> Path:
    """Return the file that a setting names; raises as ``resolve_name``."""
    return resolve_name(text, "weights", SHIPPED, WEIGHTS_SUFFIX)


def read_terms(path: Path) -> str:
    """Return the terms of use on the card beside weights, or an empty string."""
    row = TERMS_ROW.search(read_card(path))
    return row[1] if row else ""


def read_origin(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the origin in a weight file; raises WeightsError as ``load_network`` does."""
    return _read(Path(path))[0].origin


def read_correction_runs(path: str | os.PathLike[str]) -> list[Mapping[str, Any]]:
    """Return the runs with human corrections that weights were trained in; none: label-free.

    Each counts ``images`` and ``pixels``. Raises WeightsError as ``load_network`` does.
    """
    runs = read_origin(path).get("corrections")
    return [run for run in runs if isinstance(run, dict)] if isinstance(runs, list) else []


def count_corrected_images(settings: Mapping[str, object]) -> int:
    """Sum the human-corrected images of all runs behind a detector's weights; 0 if label-free."""
    group = settings.get("weights")
    file = group.get("file") if isinstance(group, Mapping) else None
    runs = read_correction_runs(weights_path(file)) if file else []
    return sum(int(run.get("images", 0)) for run in runs)


def load_tensors(
    network: nn.Module, tensors: Mapping[str, Tensor], path: str | os.PathLike[str]
) -> None:
    """Load tensors into a network; raise WeightsError where they do not fit or are not finite."""
    try:
        network.load_state_dict(dict(tensors))
    except RuntimeError as error:
        _, first, *_ = str(error).splitlines()
        message = f"holds another network: {truncate_middle(first.strip(), MAX_MISMATCH_LENGTH)}"
        raise WeightsError(path, message, "use weights of this network") from None
    for name, values in network.state_dict().items():
        if not values.isfinite().all():
            message = f"holds weights in {name} that are not finite"
            raise WeightsError(path, message, "download or train it again")


def hash_tensors(tensors: Mapping[str, Tensor]) -> str:
    """Return the SHA-256 of named tensors: sorted names, types, shapes and bytes."""
    digest = sha256()
    for name, value in sorted(tensors.items()):
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}\n".encode())
        digest.update(value.detach().cpu().reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


class _Header(BaseModel):
    """Header of a weight file; files of earlier versions have no hash."""

    format: int
    kind: Literal["patches", "images, backbone"]
    settings: dict[str, Any]
    origin: dict[str, Any]
    sha256: str | None = None


def _read(path: Path) -> tuple[_Header, dict[str, Tensor]]:
    """Read the header and the tensors of a weight file."""
    if not path.is_file():
        raise WeightsError(path, "is not a file", "pass a .safetensors file")
    try:
        with safe_open(path, "pt") as file:
            header = _Header.model_validate_json((file.metadata() or {}).get(HEADER_KEY, ""))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except ValidationError:
        raise WeightsError(
            path, "has no header of this version", "use weights of roadtorch"
        ) from None
    except (SafetensorError, OSError, RuntimeError) as error:  # the last by torch, which maps it
        message = f"is damaged or not a weight file: {reason(error)}"
        raise WeightsError(path, message, "download or train it again") from None
    if header.format > FORMAT_VERSION:
        message = f"has format {header.format}; this roadtorch reads up to {FORMAT_VERSION}"
        raise WeightsError(path, message, "install a newer roadtorch")
    if header.sha256 is not None and header.sha256 != hash_tensors(tensors):
        message = "is damaged: its weights do not match the hash in its header"
        raise WeightsError(path, message, "download or train it again")
    return header, tensors


def read_card(path: Path) -> str:
    """Return the text of the card beside a weight file, or an empty string."""
    card = path.with_suffix(".md")
    return card.read_text(encoding="utf-8", errors="replace") if card.is_file() else ""


# --- networks of detectors -------------------------------------------------------------


NetworkT = TypeVar("NetworkT", bound=LayoutNetwork)

DEFAULT_WEIGHTS = "backbone-free"
"""Default weights of `fusion`."""


class WeightsFile(Settings):
    """Choice of a network's weights."""

    file: str = Field(
        default="",
        description="path of weights written by roadtorch train, or name of shipped weights, of "
        "this detector's kind of network; empty: the usual ones of that kind",
    )


def load_configured_network(weights: WeightsFile, shipped: str, kind: type[NetworkT]) -> NetworkT:
    """Load the network of the configured weight file, or of the shipped weights of that name.

    Raises WeightsError for a file that cannot be used, or that holds no network of this kind.
    """
    path = weights_path(weights.file or shipped)
    network = load_network(path)
    if not isinstance(network, kind):
        message = f"holds {network.title}; this detector needs {kind.title}"
        detector = "layout:cnn-7" if network.kind == PatchNetwork.kind else "fusion"
        hint = f"use weights of such a network, or --detector {detector}"
        raise WeightsError(path, message, hint)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # stubs lack it
    return network


def load_image_network(weights: WeightsFile, shipped: str) -> BackboneNetwork:
    """Load a whole-image network as ``load_configured_network``; run it once, as that is slower."""
    network = load_configured_network(weights, shipped, BackboneNetwork)
    compute_cues(network, torch.zeros(3, network.settings.height, network.settings.width))
    return network
