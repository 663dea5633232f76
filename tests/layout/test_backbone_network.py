"""The network for whole images, and weight files."""

import json
import math
from pathlib import Path
from unittest.mock import patch

import pytest
import torch
from safetensors.torch import save_file
from torch.nn import functional as F

from roadtorch.base.atomic import file_digest
from roadtorch.base.errors import WeightsError
from roadtorch.layout.backbone_network import (
    BackboneNetwork,
    BackboneNetworkSettings,
    Conv2dSame,
)
from roadtorch.layout.network_cues import (
    compute_cues,
    count_upper_rows,
    resize_rows,
    restore_rows,
    scores_to_potentials,
)
from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from roadtorch.layout.weights import (
    LayoutNetwork,
    WeightsFile,
    list_shipped_weights,
    load_image_network,
    load_network,
    read_card,
    read_origin,
    read_terms,
    resize_network,
    save_network,
    shipped_weights,
    weights_path,
)
from tests.draws import seeded_generator


@pytest.fixture(scope="module")
def backbone() -> BackboneNetwork:
    torch.manual_seed(3)
    settings = BackboneNetworkSettings(height=64, width=96, wide=8, narrow=8)
    return BackboneNetwork(settings).eval()


@pytest.mark.parametrize("size", [(16, 16), (50, 61), (100, 333)])
def test_cues_are_potentials_of_its_size(size: tuple[int, int], backbone: BackboneNetwork) -> None:
    cues = compute_cues(backbone, torch.rand(3, *size, generator=seeded_generator(0)))

    assert cues["layout"].shape == (3, *size)
    assert cues["road"].shape == cues["ego"].shape == size
    assert all(0 <= float(maps.min()) <= float(maps.max()) <= 1 for maps in cues.values())
    torch.testing.assert_close(cues["layout"].sum(0), torch.ones(size))


def test_upper_rows_are_those_of_the_upper_three_tenths() -> None:
    image = torch.linspace(0, 1, 480)[:, None].expand(1, 480, 16)

    rows = resize_rows(image, (192, 16), 32)[0, :, 0]

    centres = torch.cat(
        [(torch.arange(32) + 0.5) / 32 * 0.3, 0.3 + (torch.arange(160) + 0.5) / 160 * 0.7]
    )
    torch.testing.assert_close(rows[1:-1], centres[1:-1], atol=5e-3, rtol=0)
    torch.testing.assert_close(
        restore_rows(rows[None, :, None], (480, 1), 32)[0], image[0, :, :1], atol=6e-3, rtol=0
    )


def test_cues_are_back_in_their_place_for_any_upper_rows(backbone: BackboneNetwork) -> None:
    image = torch.rand(3, 60, 90, generator=torch.Generator().manual_seed(2))
    settings = backbone.settings.model_copy(update={"upper_rows": 0.25})
    warped = resize_rows(image, (64, 96), 16)
    scores = backbone(warped[None])
    expected = restore_rows(scores_to_potentials(scores)[0], (60, 90), 4)

    with patch.object(backbone, "settings", settings):
        cues = compute_cues(backbone, image)

    torch.testing.assert_close(cues["road"], expected[3], atol=1e-5, rtol=0)


@pytest.mark.parametrize("height", [32, 64, 192])
@pytest.mark.parametrize("fraction", [0.0, 0.02, 0.8])
def test_some_rows_are_left_for_the_ground(fraction: float, height: int) -> None:
    rows = count_upper_rows(fraction, height)

    assert resize_rows(torch.rand(1, 16, 16), (height, 24), rows).shape == (1, height, 24)


def test_weights_apply_to_images_of_another_size(backbone: BackboneNetwork) -> None:
    pixels, settings = torch.rand(1, 3, 96, 128, generator=seeded_generator(0)), backbone.settings

    resized = resize_network(backbone, 96, 128)

    assert (resized.settings.height, resized.settings.width) == (96, 128)
    assert resized.settings.wide == settings.wide
    assert not resized.training
    torch.testing.assert_close(resized(pixels), backbone(pixels))
    assert backbone.settings == settings


@pytest.mark.parametrize(("kernel", "pads"), [(3, (0, 1)), (5, (1, 2))])
def test_stride_two_is_padded_as_in_tensorflow(kernel: int, pads: tuple[int, int]) -> None:
    layer, maps = Conv2dSame(1, 1, kernel, 2), torch.rand(1, 1, 8, 8)

    expected = F.conv2d(F.pad(maps, pads * 2), layer.weight, layer.bias, 2)

    torch.testing.assert_close(layer(maps), expected)
    assert expected.shape[-2:] == (4, 4)


def test_the_card_of_the_backbone_names_imagenet() -> None:
    path = shipped_weights("backbone-free")
    assert isinstance(load_network(path), BackboneNetwork)
    assert "ImageNet" in path.with_suffix(".md").read_text()
    assert path.stat().st_size < 6_000_000


# --- weight files -----------------------------------------------------------------------


NETWORKS = [
    PatchNetwork(PatchNetworkSettings(topology=Topology(k1=6, potentials="softmax"))),
    BackboneNetwork(BackboneNetworkSettings(height=32, width=64)),
]


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    path = tmp_path / "weights.safetensors"
    save_network(path, NETWORKS[0], {"config_sha256": "abc"})
    return path


@pytest.mark.parametrize("network", NETWORKS)
def test_a_saved_network_loads_and_equal_networks_have_equal_bytes(
    network: LayoutNetwork, tmp_path: Path
) -> None:
    path, again = tmp_path / "weights.safetensors", tmp_path / "again"
    save_network(path, network, {"config": {"seed": 3}})
    save_network(again, network, {"config": {"seed": 3}})
    loaded = load_network(path)

    assert path.read_bytes() == again.read_bytes()
    assert loaded.settings == network.settings
    assert not loaded.training
    assert read_origin(path) == {"config": {"seed": 3}}
    is_large = isinstance(network, BackboneNetwork)  # then in half precision
    for name, value in network.state_dict().items():
        stored = value.half().float() if is_large and value.is_floating_point() else value
        assert torch.equal(loaded.state_dict()[name], stored)
    count = sum(value.numel() for value in network.parameters())
    assert not is_large or path.stat().st_size < 2.2 * count


# --- other files ---------------------------------------------------------------------------


def assert_refused(path: Path, message: str) -> None:
    with pytest.raises(WeightsError, match=message) as caught:
        load_network(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def change_header(path: Path, tensors: dict[str, torch.Tensor], **changes: object) -> None:
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(json.loads(data[8 : 8 + size])["__metadata__"]["roadtorch"])
    save_file(tensors, path, {"roadtorch": json.dumps({**header, **changes})})


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_weights_that_are_not_finite_are_refused(weights: Path, value: float) -> None:
    tensors = NETWORKS[0].state_dict() | {"last.bias": torch.tensor([0.0, value, 0.0])}
    change_header(weights, tensors, sha256=None)  # as files of earlier versions

    assert_refused(weights, r"holds weights in last\.bias that are not finite")


def test_truncation_and_flipped_bits_are_detected_anywhere(weights: Path) -> None:
    data = weights.read_bytes()
    for share in (0.001, 0.3, 0.99):
        weights.write_bytes(data[: int(len(data) * share)])
        assert_refused(weights, "damaged")
    start = 8 + int.from_bytes(data[:8], "little")
    for place in range(start, len(data), (len(data) - start) // 20):
        weights.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        assert_refused(weights, "do not match the hash in its header")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 2}, "has format 2; this roadtorch reads up to 1"),
        ({"kind": "transformer"}, "has no header of this version"),
        ({"settings": {"topology": {"k9": 1}}}, "has settings that this version cannot use"),
        ({"settings": {"topology": {"k1": 4}}}, "holds another network: size mismatch for first"),
    ],
)
def test_other_headers_are_refused(changes: dict[str, object], message: str, weights: Path) -> None:
    change_header(weights, NETWORKS[0].state_dict(), **changes)
    assert_refused(weights, message)


def test_a_network_of_another_kind_is_refused(weights: Path) -> None:
    message = r"holds a patch network \(CNN-7\); this detector needs a whole-image network"
    with pytest.raises(WeightsError, match=message):
        load_image_network(WeightsFile(file=str(weights)), "backbone-free")


# --- cards ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list_shipped_weights())
def test_hashes_of_shipped_weights_are_on_their_cards(name: str) -> None:
    path = shipped_weights(name)

    load_network(path)

    assert f"| sha256 | `{file_digest(path)}` |" in read_card(path)


def test_cards_of_shipped_weights_state_terms_of_use() -> None:
    terms = {name: read_terms(shipped_weights(name)) for name in list_shipped_weights()}
    assert [name for name in terms if not terms[name].startswith("anything: Apache-2.0")] == []
    assert terms.keys() == {*("backbone-free", "cnn-7", "cnn-7-paper", "scratch-free")}


def test_the_network_of_fusion_scratch_began_with_random_weights() -> None:
    config = read_origin(shipped_weights("scratch-free"))["config"]

    assert config["initial_weights"] == ""


def test_weights_without_a_card_state_no_terms(weights: Path) -> None:
    assert read_terms(weights) == ""
    weights.with_suffix(".md").write_text("# Mine\n\n| terms | anything |\n| sha256 | later |\n")
    assert read_terms(weights) == "anything"


def test_weights_are_named_by_their_file_or_by_the_name_of_shipped_ones(tmp_path: Path) -> None:
    assert weights_path("cnn-7") == shipped_weights("cnn-7")
    for name in ("./layout.pt", str(tmp_path / "mine.safetensors")):
        assert weights_path(name) == Path(name)
