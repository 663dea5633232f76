"""The site and the tutorials, made once for all tests of this folder, whichever worker is first."""

import fcntl
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = sorted(
    path for path in (ROOT / "docs" / "tutorials").glob("*.md") if path.stem != "index"
)


def run_script(*words: object) -> subprocess.CompletedProcess[str]:
    """A script of the repository, in its root."""
    command = [sys.executable, *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all workers."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if own.name.startswith("popen-") else own


@pytest.fixture(scope="session")
def site(shared: Path) -> Path:
    """The folder of the built site; fails with Sphinx's words where it warns."""
    with (shared / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        out = shared / "site"
        if not (out / "searchindex.js").exists():
            done = run_script("scripts/build_site.py", "--out", out)
            assert done.returncode == 0, done.stdout + done.stderr
    return out


@pytest.fixture(scope="session")
def checked(shared: Path) -> str:
    """What ``tutorials.py check`` tells of all pages: a line for each, below it what differs."""
    with (shared / "tutorials.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        told = shared / "tutorials.txt"
        if not told.exists():
            done = run_script("scripts/tutorials.py", "check", *TUTORIALS)
            told.write_text(done.stdout + done.stderr, encoding="utf-8")
    return told.read_text(encoding="utf-8")
