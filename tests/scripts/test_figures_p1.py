"""The figures of P1 on rendered streets: what they measure, and that each is drawn."""

import csv
from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch.data.dataset import Truth
from roadtorch.io.image import write_colours, write_labels
from roadtorch.scenes.street import render_scene
from roadtorch.ufl.hierarchy import build_tree, threshold_regions, thresholds
from scripts import figures_p1, figures_p1_pictures
from scripts.figures_p1_overlay import agreement
from scripts.figures_p1_pictures import learned, small
from scripts.figures_p1_regions import kept_regions, tree_places
from scripts.figures_p1_stages import encoded, road_patches, unevenness, zero_share


def street(height: int = 120, width: int = 160) -> tuple[Tensor, Truth]:
    scene = render_scene(3, height, width)
    return scene.image, Truth(scene.road, torch.ones_like(scene.road))


# --- size and counts --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("height", "width", "size"), [(360, 480, (120, 160)), (375, 1242, (120, 397))]
)
def test_pictures_and_labels_come_to_the_papers_size(
    height: int, width: int, size: tuple[int, int]
) -> None:
    road = torch.zeros(height, width, dtype=torch.bool)

    image, truth = small(torch.rand(3, height, width), Truth(road, ~road))

    assert image.shape == (3, *size)
    assert truth.road.shape == truth.valid.shape == size


def test_labels_are_those_of_the_nearest_pixel() -> None:
    road = torch.rand(360, 480, generator=torch.Generator().manual_seed(0)) > 0.5
    truth = Truth(road, torch.ones_like(road))

    assert torch.equal(small(torch.zeros(3, 360, 480), truth)[1].road, truth.road[1::3, 1::3])


def test_counts_are_pooled_over_pictures() -> None:
    empty = Truth(torch.zeros(120, 160, dtype=torch.bool), torch.ones(120, 160, dtype=torch.bool))
    half = Truth(empty.road.clone(), empty.valid)
    half.road[:, :80] = True
    image = street()[0]

    counts = figures_p1.pooled([(image, empty), (image, half)], ["prior:uniform"])["prior:uniform"]

    assert int(counts.true_positive) == 120 * 80
    assert int(counts.false_positive) == 120 * 160 + 120 * 80


# --- overlay ----------------------------------------------------------------------------


def test_right_is_yellow_too_much_red_missed_green_and_void_dark() -> None:
    road = torch.tensor([[True, False, True, False, True]])
    mask = torch.tensor([[True, True, False, False, True]])
    valid = torch.tensor([[True, True, True, True, False]])

    found = agreement(torch.full((3, 1, 5), 0.6), mask, Truth(road, valid))[:, 0].T

    strong, weak = 0.8, 0.3
    expected = [[strong, strong, weak], [strong, weak, weak], [weak, strong, weak]]
    torch.testing.assert_close(found[:3], torch.tensor(expected))
    torch.testing.assert_close(found[3:], torch.tensor([[0.6] * 3, [0.2] * 3]))


# --- stages -----------------------------------------------------------------------------


def test_patches_of_road_lie_in_the_road_from_far_to_near() -> None:
    _, truth = street()

    corners = road_patches(truth, 4)

    assert all(truth.road[r : r + 12, c : c + 12].all() for r, c in corners)
    assert [row for row, _ in corners] == sorted({row for row, _ in corners})


def test_without_road_there_are_no_patches() -> None:
    nothing = torch.zeros(30, 30, dtype=torch.bool)

    with pytest.raises(ValueError, match="no road of 12x12 pixels"):
        road_patches(Truth(nothing, ~nothing), 4)


def test_preprocessing_evens_out_brightness() -> None:
    image, truth = street()
    image = image * torch.linspace(0.5, 1, 120)[:, None]  # the far road is darker
    corners = road_patches(truth, 4)

    before, after = (unevenness(one, corners)[0] for one in (image, learned(image)[0].even))

    assert after < before / 5


def test_equation_4_leaves_whole_areas_at_0_where_equation_3_leaves_bases() -> None:
    image, _ = street(48, 64)

    by_patch, by_base = (encoded(image, kind)[0] for kind in ("patch", "base"))

    # Eq. 3 compares bases at a pixel: about half of them are 0 at every pixel, and at none all.
    assert ((by_patch == 0).float().mean(0) < 1).all()
    assert 0.2 < zero_share(by_patch) < 0.8
    # Eq. 4 compares pixels of a base: no map is 0 throughout, none is positive throughout.
    shares = (by_base == 0).float().mean((1, 2))
    assert ((shares > 0) & (shares < 1)).all()


# --- the tree ---------------------------------------------------------------------------


def test_every_node_stands_over_the_middle_of_its_children() -> None:
    hills = torch.zeros(20, 30)
    hills[2:18, 2:28] = 0.3
    hills[4:16, 4:12], hills[4:16, 16:26] = 0.6, 0.6
    hills[6:10, 17:20], hills[6:10, 22:25] = 0.9, 0.9
    tree = build_tree(threshold_regions(hills, thresholds(10, "included")), 4)

    places = tree_places(tree)

    children = {parent: [] for parent in range(len(places))}
    for node, parent in enumerate(tree.parent.tolist()[1:], 1):
        children[parent].append(places[node].across)
        assert places[node].first == places[parent].last + 1
    leaves = sorted(place.across for node, place in enumerate(places) if not children[node])
    assert leaves == list(range(3))
    for node, own in children.items():
        assert not own or places[node].across == sum(own) / len(own)


def test_regions_of_a_level_have_the_numbers_of_their_nodes() -> None:
    hills = torch.zeros(8, 12)
    hills[2:6, 1:5], hills[2:6, 7:11] = 0.5, 0.5
    tree = build_tree(threshold_regions(hills, thresholds(4, "included")), 4)

    found = kept_regions(tree, 1)

    assert found.unique().tolist() == [0, 2, 3]
    assert found[3, 2] == 2
    assert found[3, 8] == 3


# --- drawn ------------------------------------------------------------------------------


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder like that of the development data, with one rendered street."""
    root = tmp_path / "data"
    scene = render_scene(3, 120, 160)
    for part in ("train", "val"):
        for folder in (part, f"{part}annot"):
            (root / "camvid" / folder).mkdir(parents=True)
        write_colours(root / "camvid" / part / "0016E5_00001.png", scene.image)
        write_labels(
            root / "camvid" / f"{part}annot" / "0016E5_00001.png", torch.where(scene.road, 3, 1)
        )
    monkeypatch.setattr(figures_p1_pictures, "EXAMPLE", "0016E5_00001")
    monkeypatch.setattr(figures_p1_pictures, "SETS", {"camvid": ("camvid", 1)})
    return root


@pytest.mark.parametrize("name", [name for name in figures_p1.FIGURES if "table" not in name])
def test_every_figure_is_drawn(name: str, data: Path, tmp_path: Path) -> None:
    figures_p1.FIGURES[name](data, tmp_path)

    written = [path for path in tmp_path.glob("p1-*") if path.stem == name]
    assert len(written) == 1
    assert written[0].stat().st_size > 100


def test_table_1_has_a_row_for_each_method(data: Path, tmp_path: Path) -> None:
    figures_p1.table1(data, tmp_path)

    rows = list(csv.DictReader((tmp_path / "p1-table1.csv").read_text().splitlines()))
    assert [row["method"] for row in rows] == list(figures_p1.TABLE)
    for row in rows:
        p, r, f = (float(row[key]) for key in "PRF")
        assert f == pytest.approx(2 * p * r / (p + r), abs=0.02)
