"""The seed area, its segments, and the regions that touch it."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.imaging.slic import square_grid
from roadtorch.road.seed_area import (
    SeedArea,
    find_seed_segments,
    remove_isolated,
    seed_area,
    seed_rectangle,
    segments_inside,
    shortest_paths,
)

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


def mask_of(rows: str) -> torch.Tensor:
    return torch.tensor([[pixel == "#" for pixel in row] for row in rows.split()])


@pytest.mark.parametrize(
    ("mask", "seed", "expected"),
    [
        (
            "##.... ....## ..#..# ..##..",
            "...... ...... ...... ..##..",
            "...... ...... ..#... ..##..",
        ),
        # Regions that meet at a corner only are two.
        ("...... .#.... ..#...", "...... ...... ..##..", "...... ...... ..#..."),
        ("...... ..#.##", "...... ######", "...... ..#.##"),
        # Without a region at the seed area the mask stays as it is.
        ("## .. #.", ".. .. .#", "## .. #."),
        (".. .. ..", ".. .. .#", ".. .. .."),
    ],
)
def test_only_regions_that_touch_the_seed_area_stay(mask, seed, expected):
    regions = mask_of(mask)

    assert torch.equal(remove_isolated(regions, mask_of(seed)), mask_of(expected))
    assert torch.equal(regions, mask_of(mask))  # what is handed in is not changed


@pytest.mark.parametrize(
    ("labels", "segments"),
    [
        # The seed area is rows 210…239 and columns 120…199: the squares at columns 120 and 150 lie
        # inside, and of that at 180, 20 of 30 columns do.
        (square_grid(240, 320, 30), [7 * 11 + 4, 7 * 11 + 5, 7 * 11 + 6]),
        # None is half inside: the one that fills most of it, 50 columns of 80.
        ((torch.arange(320) >= 170).long().expand(240, 320), [0]),
    ],
)
def test_segments_with_half_of_their_pixels_in_the_seed_area_are_road(labels, segments):
    result = segments_inside(labels, seed_rectangle(labels.shape))

    assert result.tolist() == segments
    assert result.dtype == torch.int64


SMALL = st.integers(16, 60)


@given(SMALL, SMALL, st.integers(1, 70), st.integers(1, 240), st.integers(1, 320))
def test_there_is_a_seed_segment_and_each_is_in_the_seed_area(height, width, size, tall, wide):
    labels, seed = square_grid(height, width, size), SeedArea(height=tall, width=wide)

    result = segments_inside(labels, seed_rectangle((height, width), seed))

    assert len(result) >= 1
    assert set(result.tolist()) <= set(labels[seed_area(height, width, seed)].flatten().tolist())


@pytest.mark.parametrize(
    ("evidence", "row", "share", "seed"),
    [
        # Where road is likeliest, as large as asked for; the first is in the upper half.
        ([9.0, 1.0, 3.0, 2.0, -5.0], [0.2, 0.8, 0.8, 0.8, 0.8], 0.2, [2]),
        ([9.0, 1.0, 3.0, 2.0, -5.0], [0.2, 0.8, 0.8, 0.8, 0.8], 0.3, [2, 3]),
        ([0.0, 0.0], [0.6, 0.9], 0.05, [1]),  # of two as likely the nearer one
        ([0.0, 1.0], [0.1, 0.1], 0.05, [1]),  # where all is in the upper half the best all the same
    ],
)
def test_a_likely_seed_is_where_road_is_likeliest(evidence, row, share, seed):
    size = torch.full((len(row),), 0.2)

    result = find_seed_segments(torch.tensor(evidence), torch.tensor(row), size, share)

    assert result.nonzero()[:, 0].tolist() == seed


# --- how far a segment is from it -----------------------------------------------------


@st.composite
def graphs(draw):
    """Pairs (2,E), each once, steps (E,), some of them 0, sources (k,), and how many nodes."""
    count = draw(st.integers(1, 9))
    every = [(i, j) for i in range(count) for j in range(i + 1, count)]
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

    result = shortest_paths(pairs, steps, sources, count)

    expected = [0.0 if node in sources.tolist() else float("inf") for node in range(count)]
    for _ in range(count):
        for (i, j), step in zip(pairs.T.tolist(), steps.tolist(), strict=True):
            expected[j] = min(expected[j], expected[i] + step)
            expected[i] = min(expected[i], expected[j] + step)
    np.testing.assert_allclose(result, torch.tensor(expected), atol=1e-6, rtol=1e-6)
