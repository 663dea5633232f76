"""Steps of the graph on batches, where Python branches on values or uses OpenCV and NumPy."""

from collections.abc import Callable
from functools import partial

import pytest
import torch
from torch import Tensor

from roadtorch.base.twins import use_twins
from roadtorch.export.steps import TWINS
from roadtorch.imaging.color import Exposure, brighten
from roadtorch.imaging.levels import is_above, is_at_least
from roadtorch.imaging.resize import WorkingSize, resize_maps, resize_to_image, resize_to_work
from roadtorch.road.bayes import log_odds
from roadtorch.road.ego import extrapolate_over_ego, find_ego_car
from roadtorch.road.outlines import guided_filter
from roadtorch.road.seed_area import find_seed_area
from roadtorch.road.trust import TrustSettings, estimate_trust, trust_features
from roadtorch.testing import street
from tests.draws import seeded_generator

HEIGHT, WIDTH = 61, 80
IMAGES = torch.stack([street(HEIGHT, WIDTH), street(HEIGHT, WIDTH, 1) * 0.1])
BONNET = torch.zeros(HEIGHT, WIDTH)
BONNET[50:, 20:], BONNET[54:, :20] = 0.95, 0.9
EGO = torch.stack([BONNET, torch.zeros_like(BONNET)])
ROAD = torch.rand(2, HEIGHT, WIDTH, generator=seeded_generator(3))


def trust(road: Tensor) -> Tensor:
    mask, ego = road > 0.5, torch.zeros_like(road, dtype=torch.bool)
    signs = trust_features(road, mask, ego)
    return torch.as_tensor(estimate_trust(signs, mask.flatten(-2).any(-1), TrustSettings()).trust)


STEPS: dict[str, tuple[Callable[..., Tensor], tuple[Tensor, ...]]] = {
    "above": (partial(is_above, level=0.5), (IMAGES,)),
    "at_least": (partial(is_at_least, level=0.5), (IMAGES,)),
    "smaller": (partial(resize_maps, size=(33, 20)), (IMAGES,)),
    "larger": (partial(resize_maps, size=(90, 200)), (IMAGES,)),
    "labels": (partial(resize_to_image, size=(90, 20)), (EGO > 0.5,)),
    "resize_to_work": (partial(resize_to_work, working=WorkingSize(pixels=1000)), (IMAGES,)),
    "brightened": (partial(brighten, exposure=Exposure()), (IMAGES,)),
    "find_ego_car": (find_ego_car, (EGO,)),
    "continued": (extrapolate_over_ego, (IMAGES, EGO > 0.5)),
    "find_seed_area": (partial(find_seed_area, fraction=0.05), (log_odds(ROAD),)),
    "followed": (guided_filter, (ROAD, IMAGES, resize_maps(IMAGES, (122, 160)))),
    "trust": (trust, (ROAD,)),
}


@pytest.mark.parametrize(("step", "parts"), STEPS.values(), ids=STEPS)
def test_a_step_on_a_batch_agrees_with_python_on_each_image(
    step: Callable[..., Tensor], parts: tuple[Tensor, ...]
) -> None:
    expected = torch.stack([step(*values) for values in zip(*parts, strict=True)])

    with use_twins(TWINS):
        actual = step(*parts)

    assert torch.allclose(actual.double(), expected.double(), atol=2e-5)
