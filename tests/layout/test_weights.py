"""Weight files: there and back, and everything that is not one."""

import json
import math
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from roadtorch.errors import WeightsError
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.layout.weights import (
    LayoutNetwork,
    list_shipped_weights,
    load_network,
    read_origin,
    save_network,
    shipped_weights,
    terms_of,
    weights_path,
)

NETWORKS = [
    PatchNetwork(PatchNetworkSettings(topology=Topology(k1=6, potentials="softmax"))),
    PictureNetwork(PictureNetworkSettings(height=40, width=48, narrow=8, wide=8)),
]
IMAGE = torch.rand(3, 50, 60, generator=torch.Generator().manual_seed(3))


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "weights.safetensors"
    save_network(path, NETWORKS[0], {"config_sha256": "abc"})
    return path


def header(path: Path) -> dict[str, object]:
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + size])["__metadata__"]


@pytest.mark.parametrize("network", NETWORKS, ids=lambda network: network.kind)
def test_a_network_comes_back_with_its_settings_and_origin(
    network: LayoutNetwork, tmp_path: Path
) -> None:
    path = tmp_path / "weights.safetensors"

    save_network(path, network, {"config": {"seed": 3}})
    loaded = load_network(path)

    assert loaded.settings == network.settings
    assert not loaded.training
    assert read_origin(path) == {"config": {"seed": 3}}
    torch.testing.assert_close(
        loaded.cues(IMAGE)["layout"], network.eval().cues(IMAGE)["layout"], rtol=0, atol=0
    )


def test_the_same_network_gives_the_same_bytes(weights: Path, tmp_path: Path) -> None:
    save_network(tmp_path / "again", NETWORKS[0], {"config_sha256": "abc"})

    assert (tmp_path / "again").read_bytes() == weights.read_bytes()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"<!DOCTYPE html><html><body>Not found</body></html>", "damaged or no weight file"),
        (b"", "damaged or no weight file"),
        (b"\x08\x00\x00\x00\x00\x00\x00\x00{}      ", "not roadtorch's"),
    ],
)
def test_a_page_or_nothing_at_all_is_no_weight_file(data: bytes, what: str, tmp_path: Path) -> None:
    path = tmp_path / "page.safetensors"
    path.write_bytes(data)

    with pytest.raises(WeightsError, match=what) as caught:
        load_network(path)

    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["nothing.safetensors", "."])
def test_a_missing_file_is_told(name: str, tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="is not a file"):
        load_network(tmp_path / name)


def test_weights_of_others_are_told(tmp_path: Path) -> None:
    path = tmp_path / "other.safetensors"
    save_file({"layer": torch.zeros(3)}, path, {"format": "pt"})

    with pytest.raises(WeightsError, match="not roadtorch's"):
        load_network(path)


def change_header(path: Path, tensors: dict[str, torch.Tensor], **changes: object) -> None:
    values = {**json.loads(str(header(path)["roadtorch"])), **changes}
    save_file(tensors, path, {"roadtorch": json.dumps(values)})


Change = Callable[[torch.Tensor], torch.Tensor]

MAD: dict[str, tuple[Change, str]] = {
    "nan": (lambda values: values * math.nan, "not finite, or beyond 1e\\+06"),
    "inf": (lambda values: values + math.inf, "not finite, or beyond"),
    "1e30": (lambda values: values * 1e30, "not finite, or beyond"),
    "int32": (lambda values: values.to(torch.int32), "holds int32 in .*, not float32"),
    "float64": (lambda values: values.double(), "holds float64 in .*, not float32"),
}


@pytest.mark.parametrize("mad", MAD)
@pytest.mark.parametrize("all_of_them", [True, False])
def test_weights_that_make_no_sense_are_told(weights: Path, mad: str, all_of_them: bool) -> None:
    change, what = MAD[mad]
    tensors = NETWORKS[0].state_dict()
    first = next(iter(tensors))
    changed = {k: change(v) if all_of_them or k == first else v for k, v in tensors.items()}
    change_header(weights, changed, sha256=None)  # as files of earlier versions

    with pytest.raises(WeightsError, match=what) as caught:
        load_network(weights)

    assert str(weights) in str(caught.value)


def test_a_cut_or_a_flipped_bit_is_told_wherever_it_is(weights: Path) -> None:
    data = weights.read_bytes()
    for share in (0.001, 0.3, 0.99):
        weights.write_bytes(data[: int(len(data) * share)])
        with pytest.raises(WeightsError, match="damaged"):
            load_network(weights)
    start = 8 + int.from_bytes(data[:8], "little")
    for place in range(start, len(data), (len(data) - start) // 20):
        flipped = bytearray(data)
        flipped[place] ^= 1
        weights.write_bytes(flipped)
        with pytest.raises(WeightsError, match="not those that its header states"):
            load_network(weights)


def test_a_file_that_is_not_what_its_card_states_is_told(weights: Path) -> None:
    card = weights.with_suffix(".md")
    own = sha256(weights.read_bytes()).hexdigest()
    card.write_text(f"| | |\n|---|---|\n| sha256 | `{own}` |\n")
    load_network(weights)

    card.write_text(f"| | |\n|---|---|\n| sha256 | `{own[::-1]}` |\n")
    with pytest.raises(WeightsError, match=r"is not the file whose SHA-256 weights\.md states"):
        load_network(weights)


def test_a_card_that_cannot_be_read_is_told(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights.with_suffix(".md").write_text("# A card\n")
    monkeypatch.setattr("roadtorch.layout.weights.MAX_CARD_BYTES", 5)

    with pytest.raises(
        WeightsError, match=r"weights\.md: cannot be read: it has more than 5 bytes"
    ):
        load_network(weights)


@pytest.mark.parametrize("name", list_shipped_weights())
def test_shipped_weights_are_what_their_cards_state(name: str, tmp_path: Path) -> None:
    path = shipped_weights(name)
    load_network(path)

    for each in (path, path.with_suffix(".md")):
        (tmp_path / each.name).write_bytes(each.read_bytes())
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    (tmp_path / path.name).write_bytes(data)
    with pytest.raises(WeightsError, match="states"):
        load_network(tmp_path / path.name)


def test_the_cards_of_shipped_weights_say_what_they_may_be_used_for() -> None:
    terms = {name: terms_of(shipped_weights(name)) for name in list_shipped_weights()}

    research = {name for name, words in terms.items() if "non-commercial" in words}
    free = {name for name, words in terms.items() if words.startswith("anything: Apache-2.0")}
    assert research == {"cnn-7-paper", "layout"}
    assert free == {"backbone-free", "cnn-7", "layout-free"}


def test_the_free_weights_may_be_used_for_anything_and_began_with_nothing_else() -> None:
    path = shipped_weights("layout-free")
    config = read_origin(path)["config"]

    assert terms_of(path).startswith("anything: Apache-2.0")
    assert config["start"] == config["teacher"]["weights"] == "runs/free-3/weights.safetensors"
    assert read_origin(path)["pictures"] == 640 + 390 + 49


def test_weights_without_a_card_state_no_terms(weights: Path) -> None:
    assert terms_of(weights) == ""
    weights.with_suffix(".md").write_text("# Mine\n\n| terms | anything |\n| sha256 | later |\n")
    assert terms_of(weights) == "anything"


def test_weights_are_named_by_their_file_or_by_the_name_of_shipped_ones(tmp_path: Path) -> None:
    assert weights_path("layout") == shipped_weights("layout")
    assert weights_path("./layout") == Path("layout")
    assert weights_path("no-such-weights") == Path("no-such-weights")
    assert weights_path(str(tmp_path / "mine.safetensors")) == tmp_path / "mine.safetensors"


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"format": 2}, "has the format 2; this roadtorch reads up to 1"),
        ({"format": "x"}, "a header that makes no sense"),
        ({"kind": "transformer"}, "a header that makes no sense"),
        ({"settings": {"topology": {"k9": 1}}}, "made for other settings"),
        ({"settings": {"topology": {"k1": 4}}}, "holds another network: first.bias is 6, not 4"),
        ({"kind": "pictures", "settings": {}}, "holds another network"),
    ],
)
def test_headers_that_do_not_fit_are_told(
    changes: dict[str, object], what: str, weights: Path
) -> None:
    change_header(weights, NETWORKS[0].state_dict(), **changes)

    with pytest.raises(WeightsError, match=what):
        load_network(weights)
    for text in ('{"format": 1e999, "kind": "patches"}', "[" * 100_000):  # trips the parser
        save_file(NETWORKS[0].state_dict(), weights, {"roadtorch": text})
        with pytest.raises(WeightsError, match="a header that makes no sense"):
            load_network(weights)
