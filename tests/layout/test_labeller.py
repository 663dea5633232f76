"""The layout labeller: position, order, decision, and its labels of rendered streets."""

from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from roadtorch.evaluation.metrics import class_recalls, count_layout
from roadtorch.layout import labeller
from roadtorch.layout.classes import SKY, UNLABELLED
from roadtorch.layout.labeller import (
    LABELLER_RULES,
    UNTUNED_RULES,
    ColumnChain,
    LabellerSettings,
    LayoutLabels,
    SkyAppearance,
    column_samples,
    label_layout,
    smooth_columns,
)
from roadtorch.testing.scenes import RenderedScene
from tests.draws import seeded_generator
from tests.reference import layout as reference
from tests.streets import scene


def test_clouds_below_a_blue_sky_are_sky(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the appearance of sky, whatever differs from the top of the image becomes a wall."""
    street = scene(0, dusk=0.0)
    sky = truth(street) == SKY
    top = (torch.arange(sky.shape[0])[:, None] < 0.2 * sky.shape[0])[None]
    blue = torch.tensor([0.25, 0.45, 0.85])[:, None, None]
    cloudy = torch.where(sky, torch.where(top, blue, torch.tensor(0.85)), street.image)

    def share_of_sky() -> float:
        labels = label_layout(cloudy).potentials.argmax(0)
        return float((labels[sky] == SKY).double().mean())

    share = share_of_sky()
    monkeypatch.setattr(
        labeller,
        "LABELLER_RULES",
        LABELLER_RULES._replace(sky=SkyAppearance(light=0, even=0, blue=0)),
    )
    assert share > max(0.95, share_of_sky() + 0.1)


def test_untuned_constants_follow_from_the_geometry_that_they_name() -> None:
    """A wall 6 m aside, from 1.5 m below to 6 m above a level camera, projects to these lines."""
    position = UNTUNED_RULES.position
    width_to_height = 4 / 3
    for column in (0.6, 0.75, 0.9):
        offset = column - 0.5  # x / f = offset · width / f, and so z = 6 f / x for the wall
        foot, top = (width_to_height * offset * metres / 6 for metres in (1.5, 6.0))
        side = offset - 0.25
        assert position.ground_drop + position.ground_slope * side == pytest.approx(foot)
        assert position.sky_rise + position.sky_slope * side == pytest.approx(top)

    street = scene(0, dusk=0.0)
    labels = label_layout(street.image, LabellerSettings(constants="untuned")).potentials.argmax(0)
    recalls = class_recalls(count_layout(labels, street.layout))
    assert float(recalls.mean()) > 0.7


# --- columns in order ---------------------------------------------------------------------


def assert_like_every_path(scores: Tensor, labels: Tensor, order: ColumnChain) -> None:
    belief = smooth_columns(scores, column_samples(labels, order.step), order)

    move = reference.transitions(order.change, order.breach)
    expected = reference.smooth_columns(
        scores.double().numpy(), labels.numpy(), order.weight, order.step, move
    )
    torch.testing.assert_close(belief.double(), torch.from_numpy(expected), atol=1e-5, rtol=0.0)


@settings(max_examples=40)
@given(
    st.integers(1, 6),
    st.integers(1, 3),
    st.sampled_from([0.5, 2.0]),
    st.sampled_from([0.01, 0.3]),
    st.sampled_from([0.0, 1e-3, 0.1]),
    st.integers(0, 99),
)
def test_columns_of_single_samples_have_the_posteriors_of_all_paths(
    rows: int, columns: int, weight: float, change: float, breach: float, seed: int
) -> None:
    scores = 3 * torch.randn(rows * columns, 3, generator=seeded_generator(seed))
    labels = torch.arange(rows * columns).reshape(rows, columns)
    assert_like_every_path(scores, labels, ColumnChain(weight, change, breach, step=1))


@pytest.mark.parametrize("step", [1, 2, 3, 4])
def test_segments_get_the_mean_of_their_samples_or_their_own_score(step: int) -> None:
    generator = seeded_generator(step)
    labels = torch.randint(0, 9, (7, 9), generator=generator)
    scores = 2 * torch.randn(12, 3, generator=generator)  # 9, 10 and 11 never occur
    assert_like_every_path(scores, labels, ColumnChain(step=step))


def test_long_columns_do_not_underflow() -> None:
    scores = torch.tensor([[50.0, 0, -50], [-50.0, 0, 50]]).repeat(500, 1)

    belief = smooth_columns(scores, np.arange(1000)[:, None], ColumnChain(step=1))

    assert belief.isfinite().all()
    torch.testing.assert_close(belief.sum(1), torch.ones(1000))


# --- images -----------------------------------------------------------------------------


@cache
def labelled(seed: int, dusk: float) -> LayoutLabels:
    return label_layout(scene(seed, dusk=dusk).image)


def truth(street: RenderedScene) -> Tensor:
    """Return layout labels with the unknown object as void."""
    return torch.where(street.void, UNLABELLED, street.layout.long())


@pytest.mark.parametrize(("seed", "dusk"), [(0, 0.0), (1, 0.0), (2, 0.8)])
def test_potentials_sum_to_one_and_labels_respect_the_margin(seed: int, dusk: float) -> None:
    shape, layout = scene(seed, dusk=dusk).road.shape, labelled(seed, dusk)

    assert layout.potentials.shape == (3, *shape)
    assert layout.potentials.min() >= 0
    torch.testing.assert_close(layout.potentials.sum(0), torch.ones(shape))
    second, best = layout.potentials.sort(0).values[1:]
    leads = best - second >= LabellerSettings().margin
    assert torch.equal(leads, layout.labels != UNLABELLED)
    assert torch.equal(layout.labels[leads], layout.potentials.argmax(0)[leads])


def test_learning_the_classes_beats_position_and_order(monkeypatch: pytest.MonkeyPatch) -> None:
    streets = [scene(seed, dusk=0.0) for seed in range(4)]

    def recall(layouts: list[LayoutLabels]) -> float:
        labels = [layout.potentials.argmax(0) for layout in layouts]
        counts = [count_layout(*pair) for pair in zip(labels, map(truth, streets), strict=True)]
        return float(class_recalls(torch.stack(counts).sum(0)).mean())

    learned = [labelled(seed, 0.0) for seed in range(4)]
    monkeypatch.setattr(labeller, "LABELLER_RULES", LABELLER_RULES._replace(sharpness=1e-6))
    without = [label_layout(street.image) for street in streets]
    assert recall(learned) > recall(without) + 0.05
