"""Every stage against the authors' program, from the stored input of that stage, in float64."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.ufl import features, hierarchy, maps, preprocess, road

pytestmark = pytest.mark.data
MAP = (115, 155)
STORED = 1e-6  # most stages are stored as float32


def close(found: Tensor, stored: Tensor, atol: float = STORED) -> None:
    torch.testing.assert_close(found.double(), stored.double(), rtol=0, atol=atol)


@cache
def equalised(golden: Any, dtype: torch.dtype = torch.float64) -> Tensor:
    """From the picture: what is stored of this stage is rounded, and normalising magnifies that."""
    return preprocess.equalised(golden.image.to(dtype), preprocess.Smoothing())


@cache
def white(golden: Any, dtype: torch.dtype = torch.float64) -> Tensor:
    even = equalised(golden, dtype)
    return features.white_patches(even, features.DictionarySettings())


@cache
def dictionary(golden: Any, dtype: torch.dtype = torch.float64) -> Tensor:
    """After the ten updates, from the stored start."""
    bases = golden.patches("centroids_init").to(dtype)
    for _ in range(10):
        bases, _ = features.update(white(golden, dtype), bases)
    return bases


@cache
def found_tree(golden: Any) -> hierarchy.Tree:
    steps = hierarchy.thresholds(16, "included")
    return hierarchy.build_tree(hierarchy.threshold_regions(golden["mean_map"], steps), 50)


@cache
def selected(golden: Any) -> maps.FeatureMaps:
    dictionary = golden.patches("centroids_final")
    return maps.select_maps(white(golden), dictionary, MAP, maps.MapSettings())


def intersection_over_union(one: Tensor, other: Tensor) -> float:
    return float((one & other).sum() / (one | other).sum())


def test_the_picture_is_reduced_as_by_matlab(golden: Any) -> None:
    assert torch.equal(preprocess.bicubic(golden.picture, (120, 160)).double(), golden.image)


def test_blur_brightness_and_equalisation(golden: Any) -> None:
    smooth = preprocess.blur(golden.image, 1.5, 3)

    close(smooth.permute(1, 2, 0), golden["blurred"], 1e-7)
    close(preprocess.brightness(smooth, 0.5, 2), golden["brightness"], 1e-7)
    even = preprocess.equalised(golden.image, preprocess.Smoothing())
    close(even.permute(1, 2, 0), golden["equalised"], 1e-7)


def test_patches_and_their_contrast(golden: Any) -> None:
    found = features.extract_patches(equalised(golden), 6)

    stored = golden.patches("patches_raw")
    close(found[golden.rows[: len(stored)]], stored, 1e-7)
    normal = features.normalise_contrast(found, 10 / 255**2)
    close(normal[golden.rows], golden.patches("patches_norm"))


def test_whitening(golden: Any) -> None:
    found = features.extract_patches(equalised(golden), 6)
    normal = features.normalise_contrast(found, 10 / 255**2)

    mean, matrix = features.zca_whitening(normal, 0.1)

    close(mean, golden.patches("white_mean"))
    close(matrix, golden["white_zca"][golden.order][:, golden.order])
    close(white(golden)[golden.rows], golden.patches("patches_white"), 2e-6)


def test_the_first_assignment(golden: Any) -> None:
    found = features.assign(white(golden), golden.patches("centroids_init"))

    assert torch.equal(found.view(MAP), golden["assign_iter1"].view(155, 115).T)


def test_each_of_the_ten_updates_from_the_stored_one_before(golden: Any) -> None:
    patches, stored = white(golden), golden.patches("centroids_iter")
    before = [golden.patches("centroids_init"), *stored]

    for number in range(10):
        bases, counts = features.update(patches, before[number])

        close(bases, stored[number])
        assert torch.equal(counts, golden["cluster_counts_iter"][number])


def test_scores_order_and_selected_maps(golden: Any) -> None:
    found = selected(golden)

    # A score is a sum of 17,825 terms up to 57.
    close(found.scores, golden["scores_program"], 0.1)
    assert torch.equal(found.order, golden["order0"])
    assert torch.equal(found.order[: len(found.maps)], golden["selected0"])
    close(found.maps.flatten(1).T[golden.rows], golden["selected_maps_rows"])
    close(found.maps[0], golden["top_map"])


def test_scores_of_the_text(golden: Any) -> None:
    patches, dictionary = white(golden), golden.patches("centroids_final")
    weights = maps.row_weights(115, "from_one").repeat_interleave(155)

    found = maps.score_maps(maps.make_encoder(patches, dictionary)(dictionary), weights)

    close(found, golden["scores_text"], 2e-3)


def test_the_mean_map(golden: Any) -> None:
    close(maps.mean_map(selected(golden).maps, "maximum"), golden["mean_map"])


def test_the_regions_of_every_level(golden: Any) -> None:
    found = found_tree(golden).regions

    assert torch.equal(found.labels.long(), golden["labels_level"])
    counts = torch.bincount(found.level[1:])
    assert torch.equal(counts, golden["regions_per_level"])
    assert torch.equal(found.level[1:] + 1, golden["region_level"])
    assert torch.equal(found.parent[1:], golden["region_parent"])
    assert torch.equal(found.area[1:], golden["region_area"])


def test_the_node_table(golden: Any) -> None:
    tree = found_tree(golden)

    order = golden["node_id"].argsort()  # stored as they were made, which is not always rising
    assert torch.equal(tree.node, golden["node_id"][order])
    assert torch.equal(tree.node[tree.parent[1:]], golden["node_parent"][order][1:])
    owner = torch.where(tree.node_of >= 0, tree.node[tree.node_of], 0)
    assert torch.equal(owner[1:], golden["region_node"])


def test_the_weights_of_places_and_their_sums(golden: Any) -> None:
    place = road.place_weights(*MAP, "symmetric")

    close(place, golden["position_weight"], 2e-7)
    sums = hierarchy.region_sums(found_tree(golden).regions, place)
    close(sums[2:], golden["region_position_sum"][1:], 1e-9)


def test_the_reconstruction_error(golden: Any) -> None:
    found = road.reconstruction_error(
        selected(golden).maps, golden["road_region_after_it1"], "road", 0.95
    )

    close(found, golden["error_raw"])
    close(road.normalised_error(found, golden["mean_map"] != 0), golden["error_normalised"])


def test_the_basis_of_the_road(golden: Any) -> None:
    samples = selected(golden).maps[:, golden["road_region_after_it1"]].T

    mean, basis = road.road_basis(samples, "road", 0.95)

    close(mean, golden["pca_mean"])
    assert basis.shape[1] == int(golden["pca_k"])
    close(basis @ basis.T, golden["pca_projector"], 2e-5)


def test_both_rounds_from_the_stored_mean_map(golden: Any) -> None:
    tree = found_tree(golden)
    order = golden["node_id"].argsort()

    rounds = road.find_road(
        selected(golden).maps, golden["mean_map"], tree, road.StabilitySettings()
    )

    assert tree.node[rounds[0].model] == int(golden["road_node_after_it1"])
    for number, found in enumerate(rounds, 1):
        close(found.choice.stability, golden[f"node_stability_it{number}"][order])
        close(found.choice.best[1:], golden[f"node_stability_best_it{number}"][order][1:])
        chosen = tree.node[found.choice.selected]
        assert torch.equal(chosen, golden[f"selected_nodes_it{number}"])
        assert torch.equal(found.road, golden[f"mask_map_it{number}"])
        wide = road.widened(found.road, 3)
        assert torch.equal(wide, golden[f"mask_map_dilated_it{number}"])
        assert torch.equal(road.mask_to_image(wide, 6), golden[f"mask_full_it{number}"])


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_from_the_picture_and_the_stored_start_to_the_mask(golden: Any, dtype: torch.dtype) -> None:
    found = maps.select_maps(
        white(golden, dtype), dictionary(golden, dtype), MAP, maps.MapSettings()
    )
    mean = maps.mean_map(found.maps, "maximum")
    regions = hierarchy.threshold_regions(mean, hierarchy.thresholds(16, "included"))
    rounds = road.find_road(
        found.maps, mean, hierarchy.build_tree(regions, 50), road.StabilitySettings()
    )
    mask = road.mask_to_image(road.widened(rounds[-1].road, 3), 6)

    # In float32 one near tie among 17,825 patches sends K-means another way.
    least = 1.0 if dtype == torch.float64 else 0.96
    assert intersection_over_union(mask, golden["mask_full_it2"]) >= least


@pytest.mark.parametrize("case", range(8))
def test_the_eight_small_trees(golden_root: Path, case: int) -> None:
    stored = np.load(golden_root / "tree_small.npz")

    def value(key: str) -> np.ndarray:
        return stored[f"case{case}_{key}"]

    steps = hierarchy.thresholds(int(stored["levels_L"]), "included")
    regions = hierarchy.threshold_regions(torch.from_numpy(value("mean_map")), steps)
    tree = hierarchy.build_tree(regions, int(stored["min_pts"]))
    pixels = stored["position_weight"] - float(stored["lambda"]) * value("error")
    found = hierarchy.node_stability(tree, torch.from_numpy(pixels))
    choice = hierarchy.select_nodes(tree, found)

    assert np.array_equal(regions.labels.numpy(), value("labels_level"))
    order = value("node_id").argsort()
    assert np.array_equal(tree.node.numpy(), value("node_id")[order])
    np.testing.assert_allclose(found.numpy(), value("node_stability")[order], atol=1e-12)
    assert np.array_equal(tree.node[choice.selected].numpy(), value("selected_nodes"))
    mask = hierarchy.selected_area(tree, choice.selected)
    assert np.array_equal(mask.numpy(), value("segments") > 0)
