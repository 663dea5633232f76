import pytest
import torch

from roadtorch.detector import Detector
from roadtorch.installation import self_test


def test_fusion_finds_the_rendered_street() -> None:
    (check,) = self_test.check_self_test()

    assert check.state == "ok"
    assert check.figures["f"] > 0.9
    assert 0 < check.figures["rounds"] <= self_test.ROUNDS
    assert check.figures["peak_mib"] > 100
    assert check.what.startswith(f"F {check.figures['f']:.3f}, ")


def test_a_detector_that_is_wrong_or_wavers_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    detect = Detector.detect
    monkeypatch.setattr(self_test, "SECONDS", 0.0)  # one round
    monkeypatch.setattr(self_test, "LEAST_F", 0.999)

    (wrong,) = self_test.check_self_test()

    monkeypatch.setattr(self_test, "LEAST_F", 0.5)

    def wavering(self: Detector, *given: object, **named: object) -> object:
        detection = detect(self, *given, **named)  # pyright: ignore[reportArgumentType]
        detection.likelihood[0, 0] = torch.rand(())
        return detection

    monkeypatch.setattr(Detector, "detect", wavering)
    (unsteady,) = self_test.check_self_test()

    assert (wrong.state, unsteady.state) == ("broken", "broken")
    assert wrong.what.endswith("; F is to be 0.999")
    assert unsteady.what.endswith("; two runs differ")
