"""The fifteen networks that stand for P2's: how many, of which ranges, and CNN-7 among them."""

import pytest
import torch

from roadtorch.layout.patch_network import PatchNetwork, PatchNetworkSettings, Topology
from train.topologies import P2_TOPOLOGIES, on_grey

FAMILY = tuple(P2_TOPOLOGIES.values())


def test_there_are_fifteen_and_no_two_are_the_same() -> None:
    assert [*P2_TOPOLOGIES] == [f"CNN-{number}" for number in range(1, 16)]
    assert len({str(topology) for topology in FAMILY}) == 15
    assert P2_TOPOLOGIES["CNN-7"] == Topology()


def test_they_spread_over_the_ranges_of_the_paper_and_stay_inside() -> None:
    def values(key: str) -> set[int]:
        return {getattr(topology, key) for topology in FAMILY}

    assert values("patch") == {32, 48, 64}
    assert values("k1") == {4, 6}
    assert values("k2") == {10, 16, 50, 60, 70, 100, 130}
    assert values("size1") == {5, 7, 9, 13}
    assert values("size2") == {7, 9, 13}
    assert values("size3") == {5, 7, 9}
    assert values("subsamplings") == {1, 2}
    assert len(values("connections")) > 1


@pytest.mark.parametrize("name", P2_TOPOLOGIES)
def test_in_colour_and_in_grey_a_patch_gives_three_potentials(name: str) -> None:
    topology = P2_TOPOLOGIES[name]
    patches = torch.zeros(2, 3, topology.patch, topology.patch)

    for each in (topology, on_grey(topology)):
        network = PatchNetwork(PatchNetworkSettings(topology=each))
        assert network(patches).shape == (2, 3)
