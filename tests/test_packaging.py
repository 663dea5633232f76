"""The wheel, the sdist and the editable install that setuptools makes of this checkout."""

import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import lazy_loader
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


def run(code: str, folder: Path, *words: str, **environment: str) -> list[str]:
    """The lines that a program prints that is run in a folder."""
    done = subprocess.run(
        [sys.executable, *words, "-c", code],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def built(checkout: Path) -> dict[str, Path]:
    """What setuptools builds: ``wheel``, ``sdist`` and ``editable``."""
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


def test_wheel_and_sdist_hold_the_package_and_nothing_else(built: dict[str, Path]) -> None:
    wheel, sdist = contents.wheel_files(built["wheel"]), contents.sdist_files(built["sdist"])
    wanted = contents.package_files()

    assert list(contents.wheel_faults(wheel, wanted)) == []
    assert list(contents.sdist_faults(sdist, wanted)) == []


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


def test_an_editable_install_is_found_beside_the_clone(
    built: dict[str, Path], checkout: Path
) -> None:
    """The folder ``roadtorch`` there, the clone itself, is a namespace package to Python."""
    site = checkout.parent / "editable-site"
    with zipfile.ZipFile(built["editable"]) as archive:
        archive.extractall(site)
    shutil.copytree(Path(lazy_loader.__file__).parent, site / "lazy_loader")  # what it needs
    code = f"import site; site.addsitedir({str(site)!r})\n"
    code += "import roadtorch; print(roadtorch.__file__)"

    (file,) = run(code, checkout.parent, "-S")

    assert file == str(checkout / "roadtorch" / "__init__.py")
