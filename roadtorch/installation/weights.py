"""The weights that come with roadtorch: whether they are the bytes that their cards state."""

from pathlib import Path

from roadtorch.errors import WeightsError
from roadtorch.installation.check import Check
from roadtorch.io.atomic import digest_of
from roadtorch.layout.weights import (
    STATED,
    list_shipped_weights,
    load_network,
    shipped_weights,
)


def check_weights() -> list[Check]:
    """Every weight file: read, its hashes compared, its values looked at."""
    found = [_file(shipped_weights(name)) for name in list_shipped_weights()]
    none = Check("weights", "broken", "none are there", "install roadtorch again")
    return found or [none]


def _file(path: Path) -> Check:
    try:
        network = load_network(path)
    except WeightsError as problem:
        return Check(path.name, "broken", problem.what, "install roadtorch again")
    count = sum(weight.numel() for weight in network.parameters())
    card = path.with_suffix(".md")
    stated = card.is_file() and STATED.search(card.read_text(encoding="utf-8"))
    told = f"as {card.name} states" if stated else "no card states it"
    what = f"{count:,} weights, SHA-256 {digest_of(path)[:12]}…, {told}"
    return Check(path.name, "ok", what, figures={"weights": count})
