import pytest

from roadtorch.installation import packages

REQUIRES = [
    "numpy>=1.26",
    "torch>=999",
    "not-there>=1",
    "only-windows>=1; sys_platform == 'none'",
    'not-there-either>=2; extra == "video"',
    'click>=8; extra == "grid"',
    'pytest>=8; extra == "test"',
]


@pytest.fixture(autouse=True)
def _requirements(monkeypatch: pytest.MonkeyPatch) -> None:
    class Metadata:
        def get_all(self, _: str) -> list[str]:
            return ["video", "grid", "test"]

    monkeypatch.setattr(packages, "requires", lambda _: REQUIRES)
    monkeypatch.setattr(packages, "metadata", lambda _: Metadata())


def test_what_is_missing_or_too_old_is_broken_with_the_line_that_mends_it() -> None:
    numpy, absent, torch = sorted(packages.check_packages(), key=lambda one: one.name != "numpy")

    assert (numpy.name, numpy.state, numpy.remedy) == ("numpy", "ok", "")
    assert (absent.name, absent.state, absent.what) == ("not-there", "broken", "is not installed")
    assert absent.remedy == "pip install 'not-there>=1'"
    assert torch.state == "broken"
    assert torch.what.endswith("is there, and >=999 is needed")


def test_an_extra_without_its_packages_is_missing_with_its_line() -> None:
    grid, video = packages.check_extras()

    assert (grid.name, grid.state) == ("grid", "ok")
    assert grid.what.startswith("click 8")
    assert (video.name, video.state) == ("video", "missing")
    assert video.what == "not-there-either is not installed"
    assert video.remedy == "pip install 'roadtorch[video]'"
