"""Fifteen members of P2's family of patch networks, for its Figs. 3 and 4a.

P2 (section 6.1) compares 15 networks, and prints the ranges that they are from, the size of
CNN-7 alone, and times of six. So CNN-7 is exactly P2's; the other fourteen, with their names,
are ours, spread over those ranges: patches of 32, 48 and 64, k1 4 or 6, k2 10 to 130, kernels
of 5 to 13, one or two subsamplings, full and partial connection tables. Only ten combinations
of P2's kernel sizes end in 1×1, two of them at 32, so some members share theirs.
"""

from collections.abc import Mapping

from roadtorch.layout.patch_network import Topology


def _member(patch: int, kernels: tuple[int, int], sizes: tuple[int, ...], **more: int) -> Topology:
    size1, size2, size3 = sizes
    values = {"k1": kernels[0], "k2": kernels[1], "size1": size1, "size2": size2, "size3": size3}
    return Topology.model_validate({"patch": patch, **values, **more})


P2_TOPOLOGIES: Mapping[str, Topology] = {
    "CNN-1": _member(32, (4, 10), (7, 9, 5)),
    "CNN-2": _member(32, (6, 50), (7, 7, 7)),
    "CNN-3": _member(32, (4, 16), (7, 9, 5)),
    "CNN-4": _member(32, (6, 60), (7, 9, 5), connections=3),
    "CNN-5": _member(32, (6, 100), (7, 7, 7), connections=3),
    "CNN-6": _member(32, (6, 16), (7, 7, 7)),
    "CNN-7": Topology(),
    "CNN-8": _member(48, (4, 16), (9, 7, 7), subsamplings=2),
    "CNN-9": _member(48, (6, 60), (7, 13, 9)),
    "CNN-10": _member(48, (6, 50), (5, 9, 7), subsamplings=2),
    "CNN-11": _member(48, (4, 10), (5, 13, 5), subsamplings=2, connections=2),
    "CNN-12": _member(48, (6, 70), (13, 9, 5), subsamplings=2),
    "CNN-13": _member(64, (6, 130), (13, 9, 9), subsamplings=2),
    "CNN-14": _member(64, (4, 10), (5, 13, 9), subsamplings=2),
    "CNN-15": _member(64, (6, 60), (13, 13, 7), subsamplings=2, connections=3),
}
"""By name, from the smallest patch to the largest."""


def on_grey(topology: Topology) -> Topology:
    """The same network on grey pictures, which P2 trained too and left out for their accuracy."""
    return topology.model_copy(update={"input": "grey"})
