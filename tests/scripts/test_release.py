"""scripts/release.sh: what it refuses before it builds anything."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = {
    "roadtorch/base/version.py": '__version__ = "1.2.3"\n',
    "CITATION.cff": "version: 1.2.3\n",
    "CHANGELOG.md": "# Changelog\n\n## Unreleased\n\n## 1.2.3 (2026-01-01)\n\n- All of it.\n",
}
"""What the script looks at first, with a version that can be released."""

TOOLS = ("bash", "sed", "awk", "grep", "wc", "git", "mktemp", "rm", "dirname", "uname")
BUILD = "python3: 3.11 or newer is not there"
"""What stops it at the build, as there is no Python among the tools."""

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not there")


@pytest.mark.parametrize(
    ("changes", "words", "message"),
    [
        ({}, (), BUILD),
        ({}, ("--dry-run",), BUILD),
        ({}, ("--dry",), "--dry: unknown argument"),
        ({"roadtorch/base/version.py": '__version__ = "1.2"\n'}, (), "'1.2' is no version"),
        ({"CITATION.cff": "version: 1.2.2\n"}, (), "CITATION.cff: states another version than"),
        ({"CHANGELOG.md": "## Unreleased\n## 1.2.3\n"}, (), "has no entries under 1.2.3"),
        ({"CHANGELOG.md": "## Unreleased\n- a\n## 1.2.3\n- b\n"}, (), "has 1 lines under Unr"),
        ({"CHANGELOG.md": "## Unreleased\n- a\n## 1.2.3\n- b\n"}, ("--dry-run",), BUILD),
        ({"tagged": ""}, (), "v1.2.3: is a tag already"),
        ({"new.py": ""}, ("--dry-run",), ".: has changes that no commit has"),
    ],
)
def test_what_is_not_in_order_is_refused_before_the_build(
    changes: dict[str, str], words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    checkout, tools = tmp_path / "checkout", tmp_path / "tools"
    tools.mkdir()
    for name in TOOLS:
        if tool := shutil.which(name):
            (tools / name).symlink_to(tool)
    for name, text in (FILES | changes).items():
        if name != "new.py":
            (checkout / name).parent.mkdir(parents=True, exist_ok=True)
            (checkout / name).write_text(text, encoding="utf-8")
    shutil.copytree(ROOT / "scripts", checkout / "scripts")
    person = ("-c", "user.name=test", "-c", "user.email=test@example.org")
    for command in (("init", "-q"), ("add", "-A"), (*person, "commit", "-qm", ".")):
        subprocess.run(("git", *command), cwd=checkout, check=True, capture_output=True)
    if "tagged" in changes:
        subprocess.run(("git", "tag", "v1.2.3"), cwd=checkout, check=True)
    if "new.py" in changes:
        (checkout / "new.py").touch()

    command = ["bash", checkout / "scripts" / "release.sh", *words]
    done = subprocess.run(command, env={"PATH": str(tools)}, capture_output=True, text=True)

    assert done.returncode == (2 if "--dry" in words else 1)
    assert done.stderr.strip().splitlines()[-1].startswith("roadtorch: error: ")
    assert message in done.stderr.strip().splitlines()[-1]
