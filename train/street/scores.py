"""Scores of a network alone on the worlds that no run learns from, by kind."""

from typing import NamedTuple

import torch

from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import VERTICAL
from roadtorch.layout.image_network import ROAD_OUTPUT, count_upper_rows, restore_rows
from train.street.batches import ROAD_MAP, resize
from train.street.pack import HELD_GROUP, SIZE, Pack, obstacle_mask, world_kind


class KindScores(NamedTuple):
    """F of a network's mask on a kind of worlds, and how much of what stands on road is road."""

    kind: str
    images: int
    f: float
    obstacles: float


@torch.no_grad()
def score_held_worlds(network: BackboneNetwork, pack: Pack) -> list[KindScores]:
    """Score a network at its own size on the worlds kept out, pooled within a kind."""
    counts: dict[str, torch.Tensor] = {}
    size = (network.settings.height, network.settings.width)
    rows = count_upper_rows(network.settings.upper_rows, size[0])
    for member in (pack.groups == HELD_GROUP).nonzero()[0].tolist():
        maps, known = pack.maps[member], pack.known[member]
        scores = network(resize(pack.images[member][None] / 255, size, rows).clamp(0, 1))
        odds = scores[0, ROAD_OUTPUT : ROAD_OUTPUT + 1]
        mask = restore_rows(odds, SIZE, rows * odds.shape[-2] // size[0])[0] >= 0
        road = maps[ROAD_MAP] == 255
        obstacle = obstacle_mask(road, (maps[VERTICAL] == 255) & known[0])
        parts = [mask & road, mask & ~road & known[1], ~mask & road, mask & obstacle, obstacle]
        row = torch.stack([torch.ones_like(mask[0, 0], dtype=torch.int64), *map(torch.sum, parts)])
        kind = world_kind(str(pack.names[member]))
        counts[kind] = counts[kind] + row if kind in counts else row
    scores = []
    for kind, row in sorted(counts.items()):
        images, hits, false, missed, taken, obstacles = row.tolist()
        f = 2 * hits / max(1, 2 * hits + false + missed)
        scores.append(KindScores(kind, images, round(f, 4), round(taken / max(1, obstacles), 4)))
    return scores
