"""The wheel, the sdist and the editable install that setuptools makes of this checkout."""

import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from roadtorch.base.version import __version__

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ("LICENSE", "README.md", "pyproject.toml")

pytest.importorskip("setuptools")  # torch brings it


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy the sources of the build into a folder with the name of the package."""
    copy = tmp_path_factory.mktemp("above") / "roadtorch"
    ignore = shutil.ignore_patterns("__pycache__")
    for name in ("roadtorch", "configs"):
        shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=ignore)
    for name in SOURCES:
        shutil.copy(ROOT / name, copy)
    return copy


def run(code: str, folder: Path, *words: str, **environment: str) -> list[str]:
    """Run a program in a folder and return the lines that it prints."""
    command = [sys.executable, *words, "-c", code]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def built(checkout: Path) -> dict[str, Path]:
    """Build ``wheel``, ``sdist`` and ``editable`` with setuptools."""
    code = "from setuptools import build_meta as b\n"
    made = {}
    for kind in ("wheel", "sdist", "editable"):
        out = checkout.parent / kind
        out.mkdir()
        code += f"print('built', b.build_{kind}({str(out)!r}))\n"
        made[kind] = out
    lines = run(code, checkout, PATH="/usr/bin:/bin")
    names = [line.split()[1] for line in lines if line.startswith("built ")]
    return {kind: out / name for (kind, out), name in zip(made.items(), names, strict=True)}


def package_files() -> dict[str, bytes]:
    """Return the files of the package in this checkout, links followed."""
    folder = ROOT / "roadtorch"
    paths = [*folder.rglob("*"), *(folder / "configs").rglob("*")]
    files = (path for path in paths if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(ROOT).as_posix(): path.read_bytes() for path in files}


def test_wheel_and_sdist_hold_the_package_and_nothing_else(built: dict[str, Path]) -> None:
    with zipfile.ZipFile(built["wheel"]) as wheel:
        files = {name: wheel.read(name) for name in wheel.namelist()}
    with tarfile.open(built["sdist"]) as sdist:
        members = {entry.name.partition("/")[2]: sdist.extractfile(entry) for entry in sdist}
        sources = {name: file.read() for name, file in members.items() if file}
    for shipped in (files, sources):
        inside = {name: data for name, data in shipped.items() if name.startswith("roadtorch/")}
        assert inside == package_files()
        assert {"roadtorch/py.typed", "roadtorch/configs/adapt.toml"} <= set(inside)
    about = {name.partition("/")[2] for name in files.keys() - package_files().keys()}
    assert {"METADATA", "entry_points.txt", "licenses/LICENSE"} <= about
    assert {name.partition("/")[0] for name in files} == {
        "roadtorch",
        f"roadtorch-{__version__}.dist-info",
    }
    assert set(SOURCES) <= set(sources)


def test_an_editable_install_is_found(built: dict[str, Path], checkout: Path) -> None:
    """Import from beside the clone: its folder ``roadtorch`` is a namespace package to Python."""
    site = checkout.parent / "editable-site"
    with zipfile.ZipFile(built["editable"]) as archive:
        archive.extractall(site)
    code = f"import site; site.addsitedir({str(site)!r})\n"
    code += "import roadtorch; print(roadtorch.__file__)"

    (file,) = run(code, checkout.parent, "-S")

    assert file == str(checkout / "roadtorch" / "__init__.py")
