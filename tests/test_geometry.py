"""Seed area, priors, squares, isolated regions and distances over segments."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.errors import ConfigError
from roadtorch.priors import prior_rows, prior_triangle, prior_uniform
from roadtorch.seed_area import SeedArea, remove_isolated, seed_area, seed_segments
from roadtorch.seed_distance import distances
from roadtorch.superpixels import squares

SIDES = st.integers(16, 2000)


def test_the_default_seed_area_is_that_of_the_paper():
    assert seed_area(240, 320) == (slice(210, 240), slice(120, 200))


def test_the_seed_area_scales_with_the_image():
    assert seed_area(720, 960) == (slice(630, 720), slice(360, 600))


@given(SIDES, SIDES, st.integers(1, 240), st.integers(1, 320))
def test_the_seed_area_is_inside_not_empty_central_and_at_the_bottom(height, width, tall, wide):
    rows, columns = seed_area(height, width, SeedArea(height=tall, width=wide))

    assert 0 <= rows.start < rows.stop == height
    assert 0 <= columns.start < columns.stop <= width
    left, right = columns.start, width - columns.stop
    assert 0 <= right - left <= 1


@pytest.mark.parametrize("prior", [prior_uniform, prior_rows, prior_triangle])
@pytest.mark.parametrize("size", [(16, 16), (17, 40), (360, 480), (33, 16)])
def test_priors_are_symmetric_likelihoods(prior, size):
    likelihood = prior(*size)

    assert likelihood.shape == size
    assert likelihood.dtype == torch.float32
    assert likelihood.min() >= 0
    assert likelihood.max() <= 1
    assert torch.equal(likelihood, likelihood.flip(1))


def test_the_uniform_prior_is_one_half():
    assert torch.equal(prior_uniform(2, 3), torch.full((2, 3), 0.5))


def test_the_row_prior_grows_evenly_from_top_to_bottom():
    assert prior_rows(4, 2)[:, 0].tolist() == [0.125, 0.375, 0.625, 0.875]


@given(SIDES.filter(lambda side: side < 400), SIDES.filter(lambda side: side < 400))
@settings(max_examples=30, deadline=None)
def test_the_triangle_covers_the_seed_area_and_no_sky(height, width):
    triangle = prior_triangle(height, width)

    assert triangle[seed_area(height, width)].min() == 1
    assert triangle[: int(0.45 * height)].max() == 0


def test_the_triangle_widens_downwards_until_it_fills_the_bottom():
    widths = prior_triangle(240, 320).sum(1)

    assert (widths.diff() >= 0).all()
    assert widths[-1] == 320


def test_squares_are_numbered_by_rows_and_cut_off_at_the_edges():
    assert squares(3, 5, 2).tolist() == [[0, 0, 1, 1, 2], [0, 0, 1, 1, 2], [3, 3, 4, 4, 5]]


@given(st.integers(1, 60), st.integers(1, 60), st.integers(1, 70))
def test_squares_partition_the_picture(height, width, size):
    labels = squares(height, width, size)

    counts = torch.bincount(labels.flatten())
    assert labels.dtype == torch.int64
    assert counts.min() >= 1
    assert counts.max() <= size * size
    assert len(counts) == -(-height // size) * -(-width // size)


def mask_of(*rows: str) -> torch.Tensor:
    return torch.tensor([[pixel == "#" for pixel in row] for row in rows])


BOTTOM = (slice(3, 4), slice(2, 4))


def test_only_regions_that_touch_the_seed_area_stay():
    mask = mask_of("##....", "....##", "..#..#", "..##..")

    kept = remove_isolated(mask, *BOTTOM)

    assert torch.equal(kept, mask_of("......", "......", "..#...", "..##.."))


def test_regions_that_meet_at_a_corner_only_are_two():
    mask = mask_of("......", "......", ".#....", "..#...")

    assert remove_isolated(mask, *BOTTOM).sum() == 1


def test_several_regions_may_touch_the_seed_area():
    mask = mask_of("......", "......", "......", "..#.##")
    wide = (slice(3, 4), slice(0, 6))

    assert torch.equal(remove_isolated(mask, *wide), mask)


@pytest.mark.parametrize("mask", [mask_of("##", "..", "#."), torch.zeros(3, 2, dtype=torch.bool)])
def test_without_a_region_at_the_seed_area_the_mask_stays_as_it_is(mask):
    assert torch.equal(remove_isolated(mask, slice(2, 3), slice(1, 2)), mask)


def test_the_mask_handed_in_is_not_changed():
    mask = mask_of("##....", "......", "......", "..##..")
    before = mask.clone()

    remove_isolated(mask, *BOTTOM)

    assert torch.equal(mask, before)


# --- segments of the seed area ------------------------------------------------------------


def test_segments_with_half_of_their_pixels_in_the_seed_area_are_road():
    labels = squares(240, 320, 30)  # the seed area is rows 210…239 and columns 120…199

    found = seed_segments(labels)

    # Columns 120, 150 lie inside; of column 180, 20 of 30 pixels do.
    assert found.tolist() == [7 * 11 + 4, 7 * 11 + 5, 7 * 11 + 6]
    assert found.dtype == torch.int64


def test_a_segment_mostly_outside_does_not_belong_to_the_seed_area():
    labels = torch.zeros(240, 320, dtype=torch.int64)
    labels[210:, 120:190] = 1
    labels[100:, 190:] = 2

    assert seed_segments(labels).tolist() == [1]


def test_without_a_segment_half_inside_the_one_that_fills_most_of_the_seed_area_is_taken():
    labels = (torch.arange(320) >= 170).long().expand(240, 320)

    assert seed_segments(labels).tolist() == [0]  # 50 columns of 80


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

    found = seed_segments(labels, seed)

    assert len(found) >= 1
    assert set(found.tolist()) <= set(labels[seed_area(height, width, seed)].flatten().tolist())


# --- distances ----------------------------------------------------------------------------


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


def test_a_way_round_may_be_shorter():
    pairs, steps = torch.tensor([[0, 1, 0], [1, 2, 2]]), torch.tensor([1.0, 1.0, 5.0])

    found = distances(pairs, steps, torch.tensor([0]), 4)

    assert found.tolist() == [0, 1, 2, float("inf")]


def test_a_step_of_zero_is_a_way_not_a_gap():
    found = distances(torch.tensor([[0], [1]]), torch.tensor([0.0]), torch.tensor([0]), 2)

    assert found.tolist() == pytest.approx([0, 0], abs=1e-30)


def test_squares_have_at_least_one_pixel():
    with pytest.raises(ConfigError, match="size: 0 was given"):
        squares(4, 4, 0)
