"""Weights, arrays and checkpoints for ``scripts/fuzz.py``."""

import io
import json
import random
from pathlib import Path
from typing import Any

import torch

from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.layout.weights import LARGEST, load_network, save_network, shipped_weights
from roadtorch.train.folder import CHECKPOINT, FORMAT, RunFolder
from roadtorch.train.prepared import read_arrays, write_arrays
from scripts.fuzz_bytes import BYTES, as_json, mutated, mutated_json, mutated_values

NETWORKS = (
    PatchNetwork(PatchNetworkSettings(topology=Topology(k1=6, potentials="softmax"))),
    PictureNetwork(PictureNetworkSettings(height=40, width=48, narrow=8, wide=8)),
)
TYPES = ("F64", "F16", "BF16", "I32", "I64", "U8", "BOOL", "F8_E4M3", "C64", "X9")

# --- networks ---------------------------------------------------------------------------


def make_network(folder: Path, draw: random.Random) -> Path:
    """A weight file of ours, small or shipped, with or without a card, that was tampered with."""
    path = folder / "net.safetensors"
    shipped = draw.choice(["", "", "", "cnn-7", "layout"])
    if shipped:
        source = shipped_weights(shipped)
        path.write_bytes(source.read_bytes())
        card = source.with_suffix(".md").read_bytes()
        if draw.random() < 0.5:
            path.with_suffix(".md").write_bytes(mutated(card, draw, BYTES))
    else:
        save_network(path, draw.choice(NETWORKS), {"config": {"seed": 3}})
    path.write_bytes(tampered_safetensors(path.read_bytes(), draw))
    return path


def tampered_safetensors(data: bytes, draw: random.Random) -> bytes:
    """The file with another header, other values or other bytes."""
    size = int.from_bytes(data[:8], "little")
    header, rest = json.loads(data[8 : 8 + size]), data[8 + size :]
    match draw.randrange(6):
        case 0:
            return mutated(data, draw, BYTES)
        case 1:
            return _with_header(mutated_json(header, draw), rest)
        case 2:
            name = draw.choice([key for key in header if key != "__metadata__"])
            header[name] = {**header[name], "dtype": draw.choice(TYPES)}
        case 3:
            about = header.get("__metadata__", {})
            changed = {key: _tampered_text(value, draw) for key, value in about.items()}
            header["__metadata__"] = changed
        case 4:
            value = draw.choice([float("nan"), float("inf"), -1e30, 2e6, 0.0])
            piece = torch.tensor(value).numpy().tobytes()
            at = 4 * draw.randrange(max(1, len(rest) // 4))
            rest = rest[:at] + piece + rest[at + 4 :]
        case _:
            header = mutated_values(header, draw)
    return _with_header(as_json(header), rest)


def _with_header(text: bytes, rest: bytes) -> bytes:
    return len(text).to_bytes(8, "little") + text + rest


def _tampered_text(text: str, draw: random.Random) -> str:
    """JSON inside metadata, its values tampered with."""
    try:
        values: Any = json.loads(text)
    except ValueError:
        return text
    return mutated_json(values, draw).decode(errors="replace")


def read_network(path: Path) -> bool:
    """Load it; whether every weight is one that can be believed."""
    return all(
        bool((value.abs() <= LARGEST).all()) for value in load_network(path).state_dict().values()
    )


# --- arrays and checkpoints -------------------------------------------------------------


def make_arrays(folder: Path, draw: random.Random) -> Path:
    """A prepared picture of ``train`` that was tampered with."""
    path = folder / "prepared.npz"
    write_arrays(path, {"image": torch.zeros(3, 9, 9, dtype=torch.uint8), "source": torch.ones(1)})
    path.write_bytes(mutated(path.read_bytes(), draw, BYTES))
    return path


def read_prepared(path: Path) -> bool:
    """Read all arrays."""
    return bool(read_arrays(path)) or True


def make_checkpoint(folder: Path, draw: random.Random) -> Path:
    """A checkpoint of ``train`` that was tampered with."""
    data = io.BytesIO()  # in a file its name would be part of the bytes
    torch.save({"format": FORMAT, "progress": {"epoch": 1}, "w": torch.ones(50)}, data)
    path = folder / CHECKPOINT
    path.write_bytes(mutated(data.getvalue(), draw, BYTES))
    return path


def read_checkpoint(path: Path) -> bool:
    """Read it as ``train --resume`` does first."""
    return isinstance(RunFolder(path.parent).read_checkpoint(), dict)
