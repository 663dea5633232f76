"""The figures of steadied sequences: what is counted, cut and drawn anew."""

import pytest
import torch

from roadtorch.detectors.catalogue import load_detector
from roadtorch.road.steady import SteadySettings
from scripts.steady import compared, stretches, told
from scripts.steady_footage import Figures, alone, first, footage, rendered


def counted(right: int, changed: int) -> Figures:
    """Twenty frames of 100 pixels of road, so many of them found, so many changed."""
    outcome = torch.tensor([[right, 0, 100 - right, 0]]).repeat(20, 1)
    return Figures(outcome, torch.tensor([[changed, 100]]).repeat(20, 1))


def test_f_and_flicker_are_those_of_all_frames_together() -> None:
    assert counted(50, 2).f == pytest.approx(2 * 50 / (2 * 50 + 50))
    assert counted(50, 2).flicker == 0.02


def test_sequences_are_cut_into_stretches_that_differ_in_nothing_here() -> None:
    parts = stretches((counted(50, 4), counted(100, 1)))

    assert len(parts) == 2
    assert "F 0.6667 → 1.0000, gained +0.3333 (+0.3333 to +0.3333)" in told(parts)
    assert "×0.25 (0.25 to 0.25)" in told(parts)


def test_a_drive_is_detected_once_and_compared(tmp_path) -> None:
    detector = load_detector("fusion")

    seen = footage("drive", rendered(0, 4), detector, tmp_path)
    again = footage("drive", [], detector, tmp_path)

    assert torch.equal(seen.likelihood, again.likelihood)
    assert len(first(seen, 3).images) == 3
    (plain, after), line = compared(seen, SteadySettings(), detector)
    assert torch.equal(torch.stack(alone(seen, detector)), seen.mask)
    assert plain.f > 0.5
    assert after.f > 0.5
    assert line.startswith("| drive | 4 |")
