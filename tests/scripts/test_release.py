"""scripts/release.sh: what it refuses before it builds anything."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not there")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A repository with what the script looks at first, in which version 1.2.3 can be released."""
    files = {
        "roadtorch/base/version.py": '__version__ = "1.2.3"\n',
        "CITATION.cff": "version: 1.2.3\n",
        "CHANGELOG.md": "# Changelog\n\n## Unreleased\n\n## 1.2.3 (2026-01-01)\n\n- All of it.\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "scripts").mkdir()
    for name in ("release.sh", "venv.sh"):
        shutil.copy(ROOT / "scripts" / name, tmp_path / "scripts")
    commit(tmp_path)
    return tmp_path


def commit(checkout: Path) -> None:
    who = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    for words in (["init", "-q"], ["add", "-A"], [*who, "commit", "-qm", "."]):
        subprocess.run(["git", *words], cwd=checkout, check=True, capture_output=True)


def refused(checkout: Path, *arguments: str) -> tuple[int, str]:
    """The exit code and the last line on stderr; no Python is there, so nothing gets built."""
    done = subprocess.run(
        ["bash", checkout / "scripts" / "release.sh", *arguments],
        env={"PATH": str(tools(checkout))},
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.returncode, done.stderr.strip().splitlines()[-1]


def tools(checkout: Path) -> Path:
    """A folder with what the checks need, beside the checkout."""
    folder = checkout.parent / f"{checkout.name}-tools"
    folder.mkdir(exist_ok=True)
    for name in ("bash", "sed", "awk", "grep", "wc", "git", "mktemp", "rm", "dirname", "uname"):
        tool = shutil.which(name)
        if tool and not (folder / name).exists():
            (folder / name).symlink_to(tool)
    return folder


def change(checkout: Path, name: str, old: str, new: str) -> None:
    path = checkout / name
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    commit(checkout)


def test_what_is_in_order_comes_to_the_build(checkout: Path) -> None:
    for arguments in ((), ("--dry-run",)):
        status, message = refused(checkout, *arguments)

        assert (status, message.partition(" (")[0]) == (
            1,
            "roadtorch: error: python3: 3.11 or newer is not there",
        )


def test_an_unknown_argument_is_wrong_usage(checkout: Path) -> None:
    message = "roadtorch: error: --dry: unknown argument (give --dry-run, or none)"
    assert refused(checkout, "--dry") == (2, message)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        (
            "roadtorch/base/version.py",
            "1.2.3",
            "1.2",
            "roadtorch/base/version.py: '1.2' is no version (write MAJOR.MINOR.PATCH)",
        ),
        (
            "CITATION.cff",
            "1.2.3",
            "1.2.2",
            "CITATION.cff: states another version than 1.2.3 (change it there too)",
        ),
        (
            "CHANGELOG.md",
            "- All of it.",
            "",
            "CHANGELOG.md: has no entries under 1.2.3 (move those of Unreleased there)",
        ),
    ],
)
def test_versions_that_do_not_agree_are_refused(
    checkout: Path, name: str, old: str, new: str, message: str
) -> None:
    change(checkout, name, old, new)

    assert refused(checkout, "--dry-run") == (1, f"roadtorch: error: {message}")


def test_entries_under_unreleased_are_refused_but_in_a_dry_run(checkout: Path) -> None:
    change(checkout, "CHANGELOG.md", "## Unreleased\n", "## Unreleased\n\n- More.\n")

    message = "CHANGELOG.md: has 1 lines under Unreleased (move them under 1.2.3)"
    assert refused(checkout) == (1, f"roadtorch: error: {message}")
    assert "Unreleased" not in refused(checkout, "--dry-run")[1]


def test_a_version_that_is_tagged_is_refused(checkout: Path) -> None:
    subprocess.run(["git", "tag", "v1.2.3"], cwd=checkout, check=True)

    message = "v1.2.3: is a tag already (raise the version)"
    assert refused(checkout) == (1, f"roadtorch: error: {message}")


def test_what_is_not_committed_is_refused(checkout: Path) -> None:
    (checkout / "new.py").write_text("")

    message = ".: has changes that no commit has (commit them)"
    assert refused(checkout, "--dry-run") == (1, f"roadtorch: error: {message}")
