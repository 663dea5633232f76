"""Distances over segments."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.road.seed_distance import distances


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
