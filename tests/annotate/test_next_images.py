"""The next batch of images: it does not repeat a scene, and its memory is linear."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from torch.utils._python_dispatch import TorchDispatchMode

from roadtorch.annotate.next_images import SCENE_DISTANCE, Candidates, select_batch, view_features
from roadtorch.annotate.session import Session, compute_views
from roadtorch.annotate.views import ImageView
from roadtorch.data.events import Confirm


def candidates(count: int, seed: int = 0) -> Candidates:
    at = torch.Generator().manual_seed(seed)
    trust = torch.rand(count, generator=at)
    trust[::4] = torch.nan
    return Candidates(trust, torch.rand(count, 6, generator=at))


@settings(max_examples=40)
@given(st.integers(0, 30), st.integers(0, 40), st.data())
def test_a_batch_has_no_image_twice_and_none_that_is_corrected(
    images: int, count: int, data: st.DataObject
) -> None:
    corrected = data.draw(st.sets(st.integers(0, images - 1))) if images else set()
    batch = select_batch(candidates(images), corrected, count)
    assert len(batch) == min(count, images - len(corrected)) == len(set(batch))
    assert not set(batch) & corrected
    assert batch == select_batch(candidates(images), corrected, count)


def from_all_distances(scored: Candidates, corrected: list[int], count: int) -> list[int]:
    """Compute the same order from a table of all distances."""
    distance = torch.cdist(scored.features, scored.features)
    first, second = torch.triu_indices(len(distance), len(distance), 1)
    apart = SCENE_DISTANCE * distance[first, second].median()
    order = scored.trust.nan_to_num(torch.inf).argsort(stable=True).tolist()
    order = [place for place in order if place not in corrected]
    chosen: list[int] = []
    for place in order:
        scenes = [*corrected, *chosen]
        if not scenes or distance[place, scenes].min() >= apart:
            chosen.append(place)
    return [*chosen, *(place for place in order if place not in chosen)][:count]


@pytest.mark.parametrize("corrected", [[], [3], [*range(0, 300, 2)]])
def test_the_order_is_that_of_all_distances(corrected: list[int]) -> None:
    scored = candidates(300)
    for count in (20, 300):
        expected = from_all_distances(scored, corrected, count)
        assert select_batch(scored, corrected, count) == expected


class Largest(TorchDispatchMode):
    """A counter of the elements of the largest tensor created in the block."""

    elements = 0

    def __torch_dispatch__(
        self, func: Any, types: Any, args: Any = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        result = func(*args, **(kwargs or {}))
        if isinstance(result, torch.Tensor):
            self.elements = max(self.elements, result.numel())
        return result


@pytest.mark.parametrize("corrected", [[], [*range(0, 6000, 2)]])
def test_memory_grows_with_images_not_with_their_pairs(corrected: list[int]) -> None:
    with Largest() as largest:
        assert len(select_batch(candidates(6000), corrected, 20)) == 20
    assert largest.elements < 6000**2 / 20


def test_features_tell_what_stands_where() -> None:
    image, labels = torch.zeros(3, 40, 50), torch.arange(80).reshape(8, 10)
    image[:, 20:] = 1
    layout = torch.zeros(80, 3)
    view = ImageView(
        (40, 50), torch.zeros(8, 10), labels, labels[0], csr_matrix((80, 80)), layout, None
    )
    features, flipped = (view_features(image, view) for image in (image, image.flip(-2)))
    assert features.shape == (7 * 20,)  # colours, road, layout in 4 by 5 cells
    assert float((features - flipped).norm()) > 1


def test_the_list_begins_with_the_batch_and_ends_with_confirmed_images(session: Session) -> None:
    def names() -> list[str]:
        return [entry["name"] for entry in session.listing()]

    assert names() == ["street_0.png", "street_1.png", "street_2.png"]

    stop: Any = SimpleNamespace(is_set=lambda: len(session.features) == 3, wait=lambda _: None)
    compute_views(session, stop)

    session.trusts |= {"street_0.png": 0.9, "street_1.png": 0.2, "street_2.png": 0.1}
    session.features |= {"street_2.png": session.features["street_1.png"]}  # the same scene
    session.features |= {"street_0.png": session.features["street_1.png"] + 9}
    assert names() == ["street_2.png", "street_0.png", "street_1.png"]
    session.add("street_1.png", Confirm(kind="confirm", id="a"))
    assert names() == ["street_0.png", "street_2.png", "street_1.png"]
