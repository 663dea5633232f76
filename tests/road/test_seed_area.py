"""The seed area, its segments, and the regions that touch it."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.road.seed_area import (
    SeedArea,
    distances,
    likely_seed,
    remove_isolated,
    seed_area,
    seed_rectangle,
    seed_segments,
)
from roadtorch.superpixels.slic import squares

SIDES = st.integers(16, 2000)


def test_the_default_seed_area_is_that_of_the_paper_and_scales_with_the_image():
    assert seed_area(240, 320) == (slice(210, 240), slice(120, 200))
    assert seed_area(720, 960) == (slice(630, 720), slice(360, 600))
    as_map = seed_rectangle((240, 320))
    assert as_map[210:, 120:200].all()
    assert as_map.sum() == 30 * 80


@given(SIDES, SIDES, st.integers(1, 240), st.integers(1, 320))
def test_the_seed_area_is_inside_not_empty_central_and_at_the_bottom(height, width, tall, wide):
    rows, columns = seed_area(height, width, SeedArea(height=tall, width=wide))

    assert 0 <= rows.start < rows.stop == height
    assert 0 <= columns.start < columns.stop <= width
    left, right = columns.start, width - columns.stop
    assert 0 <= right - left <= 1


def mask_of(*rows: str) -> torch.Tensor:
    return torch.tensor([[pixel == "#" for pixel in row] for row in rows])


BOTTOM = mask_of("......", "......", "......", "..##..")


def test_only_regions_that_touch_the_seed_area_stay_and_the_mask_handed_in_is_not_changed():
    mask = mask_of("##....", "....##", "..#..#", "..##..")
    before = mask.clone()

    kept = remove_isolated(mask, BOTTOM)

    assert torch.equal(kept, mask_of("......", "......", "..#...", "..##.."))
    assert torch.equal(mask, before)


def test_regions_that_meet_at_a_corner_only_are_two():
    mask = mask_of("......", "......", ".#....", "..#...")

    assert remove_isolated(mask, BOTTOM).sum() == 1


def test_several_regions_may_touch_the_seed_area():
    mask = mask_of("......", "......", "......", "..#.##")
    wide = mask_of("......", "......", "......", "######")

    assert torch.equal(remove_isolated(mask, wide), mask)


@pytest.mark.parametrize("mask", [mask_of("##", "..", "#."), torch.zeros(3, 2, dtype=torch.bool)])
def test_without_a_region_at_the_seed_area_the_mask_stays_as_it_is(mask):
    assert torch.equal(remove_isolated(mask, mask_of("..", "..", ".#")), mask)


def test_segments_with_half_of_their_pixels_in_the_seed_area_are_road():
    labels = squares(240, 320, 30)  # the seed area is rows 210…239 and columns 120…199

    found = seed_segments(labels, seed_rectangle(labels.shape))

    # Columns 120, 150 lie inside; of column 180, 20 of 30 pixels do.
    assert found.tolist() == [7 * 11 + 4, 7 * 11 + 5, 7 * 11 + 6]
    assert found.dtype == torch.int64


def test_without_a_segment_half_inside_the_one_that_fills_most_of_the_seed_area_is_taken():
    labels = (torch.arange(320) >= 170).long().expand(240, 320)

    assert seed_segments(labels, seed_rectangle(labels.shape)).tolist() == [0]  # 50 columns of 80


@given(
    st.integers(16, 60),
    st.integers(16, 60),
    st.integers(1, 70),
    st.integers(1, 240),
    st.integers(1, 320),
)
def test_there_is_always_a_seed_segment_and_each_is_in_the_seed_area(
    height, width, size, tall, wide
):
    labels, seed = squares(height, width, size), SeedArea(height=tall, width=wide)

    found = seed_segments(labels, seed_rectangle((height, width), seed))

    assert len(found) >= 1
    assert set(found.tolist()) <= set(labels[seed_area(height, width, seed)].flatten().tolist())


def test_a_likely_seed_is_where_road_is_likeliest_and_as_large_as_asked_for():
    evidence = torch.tensor([9.0, 1.0, 3.0, 2.0, -5.0])
    row = torch.tensor([0.2, 0.8, 0.8, 0.8, 0.8])  # the first is in the upper half
    size = torch.full((5,), 0.2)

    assert likely_seed(evidence, row, size, 0.2).tolist() == [False, False, True, False, False]
    assert likely_seed(evidence, row, size, 0.3).tolist() == [False, False, True, True, False]


@pytest.mark.parametrize(
    ("evidence", "row"),
    [
        ([0.0, 0.0], [0.6, 0.9]),  # of two as likely the nearer one
        ([0.0, 1.0], [0.1, 0.1]),  # where all is in the upper half the best all the same
    ],
)
def test_there_is_a_likely_seed_where_none_is_plain(evidence, row):
    found = likely_seed(torch.tensor(evidence), torch.tensor(row), torch.full((2,), 0.1), 0.05)

    assert found.tolist() == [False, True]


# --- how far a segment is from it -----------------------------------------------------


@st.composite
def graphs(draw):
    """Pairs (2,E), each once, steps (E,), some of them 0, sources (k,), and how many nodes."""
    count = draw(st.integers(1, 9))
    every = [(one, two) for one in range(count) for two in range(one + 1, count)]
    pairs = draw(st.lists(st.sampled_from(every), unique=True)) if every else []
    step = st.sampled_from([0.0, 1e-6, 0.5, 1.0, 2.5, 40.0])
    steps = draw(st.lists(step, min_size=len(pairs), max_size=len(pairs)))
    nodes = st.integers(0, count - 1)
    sources = draw(st.lists(nodes, min_size=1, max_size=3, unique=True))
    edges = torch.tensor(pairs, dtype=torch.int64).reshape(-1, 2).T
    return edges, torch.tensor(steps), torch.tensor(sources), count


@given(graphs())
def test_distances_are_those_of_bellman_and_ford(graph):
    pairs, steps, sources, count = graph

    found = distances(pairs, steps, sources, count)

    wanted = [0.0 if node in sources.tolist() else float("inf") for node in range(count)]
    for _ in range(count):
        for (one, two), step in zip(pairs.T.tolist(), steps.tolist(), strict=True):
            wanted[two] = min(wanted[two], wanted[one] + step)
            wanted[one] = min(wanted[one], wanted[two] + step)
    torch.testing.assert_close(found, torch.tensor(wanted), atol=1e-6, rtol=1e-6)
