"""The wheel, the sdist and the editable install that setuptools makes of this checkout."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from scripts import release_contents as contents

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("LICENSE", "README.md", "pyproject.toml")

pytest.importorskip("setuptools")  # torch brings it


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what is built from, in a folder called as the package is."""
    copy = tmp_path_factory.mktemp("above") / "roadtorch"
    ignore = shutil.ignore_patterns("__pycache__")
    for name in ("roadtorch", "configs"):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignore)
    for name in SOURCES:
        shutil.copy(ROOT / name, copy)
    return copy


def built(checkout: Path, kind: str) -> Path:
    """What setuptools builds: ``wheel``, ``sdist`` or ``editable``."""
    out = checkout.parent / kind
    out.mkdir(exist_ok=True)
    code = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(out)!r}))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=checkout, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return out / done.stdout.split()[-1]


def run(code: str, folder: Path, path: Path) -> str:
    """What a program says that is run in a folder, with the package at ``path`` alone."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={"PYTHONPATH": str(path), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(checkout: Path) -> Path:
    return built(checkout, "wheel")


def test_the_wheel_holds_the_package_and_nothing_else(wheel: Path) -> None:
    assert list(contents.wheel_faults(contents.wheel_files(wheel), contents.package_files())) == []


def test_the_sdist_holds_what_a_wheel_is_built_from(checkout: Path) -> None:
    shipped = contents.sdist_files(built(checkout, "sdist"))

    assert list(contents.sdist_faults(shipped, contents.package_files())) == []


def test_what_is_missing_foreign_or_changed_is_told() -> None:
    wanted = {f"roadtorch/{name}": b"1" for name in contents.NEEDED}
    about = {f"r.dist-info/{name}": b"" for name in ("METADATA", "entry_points.txt")}
    shipped = {**wanted, "roadtorch/py.typed": b"2", "roadtorch/old.py": b"", "tests/a.py": b""}
    del shipped["roadtorch/configs/adapt.toml"]

    assert list(contents.wheel_faults({**shipped, **about}, wanted)) == [
        "roadtorch/configs/adapt.toml: is missing",
        "roadtorch/old.py: is foreign",
        "roadtorch/py.typed: has other bytes",
        "tests: is foreign",
        "r.dist-info/licenses/LICENSE: is missing",
    ]
    assert "roadtorch/py.typed: is not in the checkout" in contents.faults({}, {})
    assert "LICENSE: is missing" in contents.sdist_faults(wanted, wanted)


def test_from_the_wheel_every_config_works_by_name(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    code = """
from pathlib import Path
from roadtorch.runs.options import DetectorOptions
from roadtorch.detectors.catalogue import load_detector
from roadtorch.runtime.shipped_configs import THRESHOLDS, config_file, shipped_configs
from roadtorch.settings import read_settings_file
from roadtorch.train.config import build_training
from roadtorch.layout.weights import weights_path

assert config_file("adapt").is_relative_to(Path.cwd() / "site"), config_file("adapt")
assert weights_path("layout").is_relative_to(Path.cwd() / "site")
for name in shipped_configs():
    if name.startswith(THRESHOLDS):
        detector, values = DetectorOptions(config=config_file(name)).named()
        load_detector(detector, **values)
    else:
        build_training(read_settings_file(config_file(name)))
    print(name)
"""
    names = run(code, tmp_path, tmp_path / "site").split()

    configs = ROOT / "configs"
    files = [path.relative_to(configs).with_suffix("") for path in configs.rglob("*.toml")]
    assert sorted(names) == sorted(path.as_posix() for path in files)


def test_an_editable_install_is_found_beside_the_clone(checkout: Path) -> None:
    """The folder ``roadtorch`` there, the clone itself, is a namespace package to Python."""
    site = checkout.parent / "editable-site"
    with zipfile.ZipFile(built(checkout, "editable")) as archive:
        archive.extractall(site)
    code = (
        f"import site; site.addsitedir({str(site)!r}); import roadtorch; print(roadtorch.__file__)"
    )
    done = subprocess.run(
        [sys.executable, "-S", "-c", code],
        cwd=checkout.parent,
        env={},
        capture_output=True,
        text=True,
        timeout=60,
    )

    assert done.stdout.strip() == str(checkout / "roadtorch" / "__init__.py"), done.stderr
