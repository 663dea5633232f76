"""Whether a wheel and an sdist hold what they are to hold, and nothing else.

    python scripts/release_contents.py dist

The package's files are compared with those of this checkout, byte by byte: modules, py.typed,
weights with their cards, pages, and configs/ as roadtorch/configs. The licence has to be in both.
"""

import argparse
import sys
import tarfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "roadtorch"
NEEDED = (
    "py.typed",
    *(f"weights/backbone-free.{end}" for end in ("safetensors", "md")),
    *(f"weights/rendered-free.{end}" for end in ("safetensors", "md")),
    "configs/adapt.toml",
)
"""Looked for by name as well: a checkout that lacks them is no source of a release."""

Files = Mapping[str, bytes]


def package_files(root: Path = ROOT) -> dict[str, bytes]:
    """The files of the package in a checkout, links followed, by their names in a wheel."""
    folder = root / PACKAGE
    paths = [*folder.rglob("*"), *(folder / "configs").rglob("*")]
    kept = (path for path in paths if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in kept}


def wheel_files(path: Path) -> dict[str, bytes]:
    """The files of a wheel."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def sdist_files(path: Path) -> dict[str, bytes]:
    """The files of an sdist, without the folder that all are in."""
    with tarfile.open(path) as archive:
        files = ((each.name.partition("/")[2], archive.extractfile(each)) for each in archive)
        return {name: file.read() for name, file in files if file is not None}


def faults(shipped: Files, wanted: Files) -> Iterator[str]:
    """What is wrong with the package's files in a wheel or sdist, a line each."""
    for name in NEEDED:
        if f"{PACKAGE}/{name}" not in wanted:
            yield f"{PACKAGE}/{name}: is not in the checkout"
    inside = {name for name in shipped if name.startswith(f"{PACKAGE}/")}
    yield from (f"{name}: is missing" for name in sorted(wanted.keys() - inside))
    yield from (f"{name}: is foreign" for name in sorted(inside - wanted.keys()))
    both = sorted(inside & wanted.keys())
    yield from (f"{name}: has other bytes" for name in both if shipped[name] != wanted[name])


def wheel_faults(shipped: Files, wanted: Files) -> Iterator[str]:
    """Those of a wheel, which has its own folder beside the package's, and no other."""
    yield from faults(shipped, wanted)
    tops = {name.partition("/")[0] for name in shipped}
    about = next((top for top in tops if top.endswith(".dist-info")), "")
    yield from (f"{top}: is foreign" for top in sorted(tops - {PACKAGE, about}))
    for name in ("METADATA", "entry_points.txt", "licenses/LICENSE"):
        if f"{about}/{name}" not in shipped:
            yield f"{about}/{name}: is missing"


def sdist_faults(shipped: Files, wanted: Files) -> Iterator[str]:
    """Those of an sdist, from which a wheel can be built."""
    yield from faults(shipped, wanted)
    for name in ("LICENSE", "README.md", "pyproject.toml"):
        if name not in shipped:
            yield f"{name}: is missing"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="with one wheel and one sdist")
    folder = parser.parse_args().folder
    wanted = package_files()
    status = 0
    for pattern, read, check in (
        ("*.whl", wheel_files, wheel_faults),
        ("*.tar.gz", sdist_files, sdist_faults),
    ):
        (path,) = folder.glob(pattern)
        shipped = read(path)
        problems = list(check(shipped, wanted))
        status |= bool(problems)
        size = path.stat().st_size / 1e6
        print(f"{path.name}: {len(shipped)} files, {size:.1f} MB, {len(problems)} faults")
        print("".join(f"  {fault}\n" for fault in problems), end="")
    sys.exit(status)


if __name__ == "__main__":
    main()
