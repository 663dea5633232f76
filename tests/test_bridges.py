"""Detections in the forms of other packages, each against the real one where it is installed."""

import sys

import numpy as np
import pytest
import torch

from roadtorch import Detection
from roadtorch.base.errors import ConfigError
from roadtorch.detectors.detection import to_pandas

ROAD = ((0, 0, 0, 0, 0, 0, 0), (0, 1, 1, 1, 1, 0, 0), (0, 1, 0, 0, 1, 0, 1), (0, 1, 1, 1, 1, 0, 1))


def detection(road: object = ROAD, trust: float | None = 0.75) -> Detection:
    mask = torch.as_tensor(road, dtype=torch.bool)
    return Detection(mask.float(), mask, {}, trust, "is dark", name="a", seconds=1.5)


def test_polygons_are_borders_and_behind_them_those_of_their_holes() -> None:
    regions = sorted(detection().polygons(), key=len)

    assert [len(rings) for rings in regions] == [1, 2]
    ((line,), (outside, hole)) = regions
    assert {*map(tuple, line.tolist())} == {(6, 2), (6, 3)}
    assert {*map(tuple, outside.tolist())} == {(1, 1), (1, 3), (4, 3), (4, 1)}
    assert hole.min(0).tolist() == [1, 1]
    assert hole.max(0).tolist() == [4, 3]
    assert detection(torch.zeros(3, 4)).polygons() == []


def test_supervision_has_the_road_as_one_object() -> None:
    supervision = pytest.importorskip("supervision", reason="supervision is not installed")

    road, none = detection().to_supervision(), detection(torch.zeros(3, 4)).to_supervision()

    assert isinstance(road, supervision.Detections)
    assert road.xyxy.tolist() == [[1, 1, 7, 4]]
    assert road.area.tolist() == [12]
    np.testing.assert_array_equal(road.mask[0], np.array(ROAD, bool))
    assert road.confidence.tolist() == [0.75]
    assert road["class_name"].tolist() == ["road"]
    assert len(none) == 0
    assert detection(trust=None).to_supervision().confidence is None


def test_pandas_has_a_row_for_each() -> None:
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")

    table = to_pandas([detection(), detection(trust=None)])

    assert isinstance(table, pandas.DataFrame)
    assert [*table] == ["name", "seconds", "width", "height", "road_share", "trust", "doubt"]
    assert table.iloc[0].tolist() == ["a", 1.5, 7, 4, 12 / 28, 0.75, "is dark"]
    assert table.trust.isna().tolist() == [False, True]


@pytest.mark.parametrize("name", ["supervision", "pandas"])
def test_a_missing_package_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)

    with pytest.raises(ConfigError, match=rf"{name}: is not installed \(pip install {name}\)"):
        to_pandas([detection()]) if name == "pandas" else detection().to_supervision()
