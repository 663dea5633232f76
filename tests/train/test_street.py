"""Learning in minutes: packs, batches, loss, held-out worlds, comparison of weights."""

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.image_network import resize_rows
from roadtorch.layout.weights import load_network, save_network
from roadtorch.train.teachers import TARGET_PLANES, Targets
from train.street.__main__ import find_recipe, learn_network, load_backbone, mean, street_loss
from train.street.batches import Batch, Sampler, make_planes, resize_weights
from train.street.compare import (
    LEFT,
    RIGHT,
    Records,
    draw_weights,
    half_errors,
    mean_f,
    obstacles_taken,
    wrong_halves,
)
from train.street.pack import (
    HELD_GROUP,
    NOT_ROAD,
    SIMULATED,
    SIZE,
    Example,
    Pack,
    decode_label,
    encode_label,
    obstacle_mask,
    read_pack,
    shrink_code,
    world_kind,
    write_pack,
)
from train.street.recipes import CONTROL, RECIPES, THIN
from train.street.scores import score_held_worlds
from train.worlds.truth import VOID

CPU = torch.device("cpu")


def example(group: str, name: str, code: np.ndarray) -> Example:
    """Return a grey image whose label is a code (H, W)."""
    image = np.full((*SIZE, 3), 120, np.uint8)
    files = [cv2.imencode(".png", pixels)[1].tobytes() for pixels in (image, code)]
    return Example(group, name, *files)


def ground_code(value: int) -> np.ndarray:
    """Return the code of sky above and one value below."""
    code = np.zeros(SIZE, np.uint8)
    code[150:] = value
    return code


def small_pack(folder: Path) -> Pack:
    """Return a pack whose held-out worlds alone show road."""
    examples = [example("set", f"3000{k}_town_sun", ground_code(2)) for k in range(3)]
    examples += [example(SIMULATED, f"carla_{k}", ground_code(2)) for k in range(2)]
    examples += [example(HELD_GROUP, "39000_town_night", ground_code(3))]
    write_pack(folder / "pack.npz", examples)
    return read_pack(folder / "pack.npz")


# --- packs ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "plane", "known"),
    [
        (0, 0, (True, True, True)),
        (1, 1, (True, True, True)),
        (2, 2, (True, True, True)),
        (3, 3, (True, True, True)),
        (4, 4, (False, True, True)),
        (NOT_ROAD, None, (False, True, True)),
        (VOID, None, (False, False, False)),
    ],
)
def test_a_code_of_truth_says_what_is_there_and_what_is_known(value, plane, known) -> None:
    maps, where = decode_label(np.full(SIZE, value, np.uint8), is_simulated=False)

    assert [int(row.max()) for row in maps][plane or 0] == (0 if plane is None else 255)
    assert tuple(bool(row.all()) for row in where) == known
    assert bool(maps[2].all()) == (value in {2, 3})  # road is ground
    assert not decode_label(np.full(SIZE, value, np.uint8), is_simulated=True)[1][2].any()


def test_a_machine_label_comes_back_and_an_uncertain_ego_car_is_unknown() -> None:
    sky, road, car = (torch.full((144, 192), value) for value in (0.25, 0.6, 0.5))
    vertical = 1 - sky
    label = cv2.imdecode(
        np.frombuffer(encode_label(torch.stack([sky, vertical, 0 * sky, road, car])), np.uint8),
        cv2.IMREAD_UNCHANGED,
    )

    maps, known = decode_label(np.asarray(label), is_simulated=False)

    for plane, value in zip(maps, (0.25, 0.75, 0, 0.6), strict=False):
        assert (plane / 255 - value).abs().max() < 0.02
    assert [bool(row.all()) for row in known] == [True, True, False]


def test_a_pack_keeps_groups_names_and_pixels(tmp_path: Path) -> None:
    pack = small_pack(tmp_path)

    assert list(pack.groups) == ["set"] * 3 + [SIMULATED] * 2 + [HELD_GROUP]
    assert pack.names[5] == "39000_town_night"
    assert (pack.images == 120).all()
    assert pack.maps[5, 3].float().mean() == pytest.approx(255 * (288 - 150) / 288)


def test_a_thin_vertical_thing_stays_in_a_smaller_truth() -> None:
    code = np.full((576, 768), 3, np.uint8)
    code[:, 400] = 1  # half of a pixel
    code[:, 100:102] = 255

    small = shrink_code(code)

    assert small.shape == SIZE
    assert (small[:, 200] == 1).all()
    assert (small[:, 50] == VOID).all()
    assert (small == 3).mean() > 0.99


def test_kinds_of_worlds_keep_night_and_generation_apart() -> None:
    names = ["39001_town_night", "39008_town_sun", "49001_town_sun"]
    assert [world_kind(name) for name in names] == ["3 town night", "3 town", "4 town"]


# --- batches ----------------------------------------------------------------------------


def test_doubted_pixels_and_those_on_the_ego_car_count_as_they_should() -> None:
    maps = torch.zeros(1, 5, 1, 4)
    maps[0, 2] = 1
    maps[0, 3, 0] = torch.tensor([0.7, 0.95, 0.1, 0.5])
    maps[0, 4, 0] = torch.tensor([0.0, 0.0, 1.0, 1.0])

    planes = make_planes(maps, torch.ones(1, 3, 1, 4, dtype=torch.bool), margin=0.6)

    targets = Targets(*planes.split(TARGET_PLANES, 1))
    assert targets.road_weight.flatten().tolist() == [0, 1, 1, 1]
    assert targets.road.flatten().tolist() == pytest.approx([0.7, 0.95, 0, 0])
    assert targets.layout_weight.flatten().tolist() == [1, 1, 0, 0]


@pytest.mark.parametrize("recipe", RECIPES, ids=lambda recipe: recipe.name)
def test_no_batch_shows_a_held_out_world(recipe, tmp_path: Path) -> None:
    sampler = Sampler(small_pack(tmp_path), recipe, 16)

    for size in ((64, 96), (192, 256)):
        batch = sampler.sample(size)
        targets = Targets(*batch.planes.split(TARGET_PLANES, 1))
        assert batch.images.shape == (16, 3, *size)
        assert 0 <= batch.images.min() <= batch.images.max() <= 1  # NaN would fail as well
        assert not targets.road.any()
        assert targets.layout_weight.any()


@pytest.mark.parametrize("rows", [0, 8])
def test_matrices_resize_as_the_detector_does(rows: int) -> None:
    maps = torch.rand(2, 3, 48, 64, generator=torch.Generator().manual_seed(3))
    cpu = torch.device("cpu")

    resized = resize_weights(48, 32, rows, cpu) @ maps @ resize_weights(64, 30, 0, cpu).T

    torch.testing.assert_close(resized, resize_rows(maps, (32, 30), rows), atol=1e-5, rtol=0)


# --- learning ---------------------------------------------------------------------------


def test_learning_lowers_the_loss_and_writes_weights_that_load(tmp_path: Path) -> None:
    sampler = Sampler(small_pack(tmp_path), CONTROL, 4)
    recipe = replace(CONTROL, sizes=((64, 96),), learning_rate=2e-3, upper=(1 / 6, 0.0), frozen=2)

    network, losses = learn_network(recipe, sampler, seconds=0, steps=12)
    save_network(tmp_path / "new.safetensors", network, {})

    assert network.settings.upper_rows == pytest.approx(1 / 6)
    assert losses[-1].visits == 48
    assert sum(row.loss for row in losses[-4:]) < sum(row.loss for row in losses[:4])
    shipped = load_backbone("backbone-free", CPU).state_dict()
    learned = load_network(tmp_path / "new.safetensors").state_dict()
    changed = {key for key in shipped if not torch.equal(shipped[key], learned[key])}
    assert changed
    assert not any(key.startswith(("backbone.stem", "backbone.blocks.1.")) for key in changed)


def test_a_recipe_is_found_by_name_and_with_another_seed() -> None:
    assert find_recipe("thin") == THIN
    assert find_recipe("thin-3") == replace(THIN, name="thin-3", seed=3)


def test_borders_of_road_and_vertical_weigh_where_truth_is_exact() -> None:
    network = load_backbone("backbone-free", CPU)
    planes = torch.zeros(1, 8, 64, 96)
    planes[:, 3] = planes[:, 5] = 1
    planes[:, 2], planes[:, 4] = 1, 1  # road everywhere
    images, exact = torch.full((1, 3, 64, 96), 0.5), torch.ones(1, 1, 1, 1)

    def losses(exact: torch.Tensor) -> list[float]:
        batch = Batch(images, planes, exact)
        recipes = replace(THIN, border=0.0), THIN
        return [street_loss(network, batch, recipe).item() for recipe in recipes]

    plain, weighted = losses(exact)
    assert plain == weighted
    planes[:, 1, 20:40, 40:50], planes[:, 2, 20:40, 40:50], planes[:, 4, 20:40, 40:50] = 1, 0, 0
    plain, weighted = losses(exact)
    assert plain < weighted
    plain, weighted = losses(0 * exact)
    assert plain > weighted  # machine labels teach nothing there


def test_the_mean_of_weights_lies_between_them(tmp_path: Path) -> None:
    network = load_backbone("backbone-free", CPU)
    state = {key: value * 2 for key, value in network.state_dict().items()}
    network.load_state_dict(state)
    save_network(tmp_path / "double.safetensors", network, {})
    parts = ["1:backbone-free", f"3:{tmp_path / 'double.safetensors'}"]

    out = tmp_path / "mean.safetensors"
    mean(argparse.Namespace(parts=parts, size=(64, 96), upper_rows=0.5, out=out))

    learned = load_network(out)
    average = learned.state_dict()
    assert isinstance(learned, BackboneNetwork)
    settings = learned.settings
    assert (settings.height, settings.width, settings.upper_rows) == (64, 96, 0.5)
    for key, value in state.items():
        if value.is_floating_point():
            torch.testing.assert_close(average[key], value * 0.875, atol=2e-3, rtol=2e-3)


# --- scores -----------------------------------------------------------------------------


def test_an_obstacle_has_road_above_and_below_it() -> None:
    road = torch.tensor([[0, 1, 1], [0, 0, 0], [1, 0, 1]], dtype=torch.bool)
    vertical = torch.tensor([[1, 0, 0], [1, 1, 1], [0, 1, 0]], dtype=torch.bool)
    assert obstacle_mask(road, vertical).nonzero().tolist() == [[1, 2]]


def test_held_out_worlds_are_scored_by_kind(tmp_path: Path) -> None:
    network = load_backbone("backbone-free", CPU)

    (score,) = score_held_worlds(network, small_pack(tmp_path))

    assert (score.kind, score.images, score.obstacles) == ("3 town night", 1, 0)
    assert 0 <= score.f <= 1


def test_errors_of_a_half_are_fractions_of_the_true_road() -> None:
    counts = torch.tensor([[30, 5, 10, 50, 20, 10, 0, 0], [10, 0, 0, 10, 0, 0, 0, 0]])
    counts = torch.cat([counts, torch.tensor([[0, 7, 0, 0, 3, 0, 0, 0]])])
    cameras = np.array(["a", "b", "roadless"])
    records = Records(cameras, [()] * 3, counts, torch.zeros(3, 2, 4))
    weights = draw_weights(cameras)

    def first(score) -> float:
        return float(score(records, weights)[0])

    assert first(half_errors("a", LEFT, 2)) == pytest.approx(10 / 100)
    assert first(half_errors("a", RIGHT, 1)) == pytest.approx(20 / 100)
    assert first(mean_f) == pytest.approx((160 / 205 + 1) / 2)
    assert torch.equal(mean_f(records, weights), mean_f(records, weights[:1]).expand(1001))


def test_wrong_halves_follow_the_side_of_traffic_and_few_pixels_that_stand_are_no_figure() -> None:
    counts = [[60, 5, 10, 20, 4, 10, 30, 300], [60, 5, 10, 20, 4, 10, 400, 500]]
    counts += [[60, 5, 10, 20, 4, 10, 0, 200]]
    cameras = np.array(["cityscapes", "dn_idd", "kitti_semantics"])
    records = Records(cameras, [()] * 3, torch.tensor(counts), torch.zeros(3, 2, 4))
    weights = draw_weights(cameras)[:1]

    assert wrong_halves("cityscapes")(records, weights) == pytest.approx((10 + 4) / 100)
    assert wrong_halves("dn_idd")(records, weights) == pytest.approx((5 + 10) / 100)
    assert obstacles_taken(records, weights) == pytest.approx((0.1 + 0.8) / 2)
    assert obstacles_taken(records, weights, ["dn_idd"]) == pytest.approx(0.8)
    assert obstacles_taken(records, weights, ["kitti_semantics"]).isnan()
