"""scripts/venv.sh: where torch comes from, asked of indices of our own on the loopback."""

import re
import sys
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from subprocess import run
from threading import Event

import pytest

from tests.servers import serving

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "venv.sh"


ended = Event()


def answer(handler: BaseHTTPRequestHandler) -> None:
    """Serve torch and nothing else; below /silent after the test alone."""
    if handler.path.startswith("/silent"):
        ended.wait(60)
    handler.send_response(200 if handler.path == "/torch/" else 404)
    handler.end_headers()


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no index is asked")
@pytest.mark.parametrize(
    ("address", "is_taken"),
    [
        ("{index}", True),
        ("{index}/elsewhere", False),
        ("{index}/silent", False),
        ("http://127.0.0.1:9", False),
        ("http://none.invalid", False),
    ],
)
def test_an_index_is_taken_where_it_answers_soon(address: str, is_taken: bool) -> None:
    ended.clear()
    with serving(answer) as host:
        address = address.format(index=f"http://{host}")
        code = f'source "{SCRIPT}"; PYTHON={sys.executable}; choose_index; echo "${{INDEX[@]}}"'
        variables = {"PATH": "/usr/bin:/bin", "ROADTORCH_CPU_INDEX": address}
        done = run(["bash", "-euc", code], env=variables, capture_output=True, text=True)
        ended.set()

    assert done.returncode == 0
    assert done.stdout.strip() == (f"--extra-index-url {address}" if is_taken else "")
    message = "CPU wheels from" if is_taken else "does not answer within 3 seconds"
    assert message in done.stderr


@pytest.mark.parametrize("kind", ["base", "test"])
def test_every_file_of_the_package_index_has_the_hashes_of_the_tested_version(kind: str) -> None:
    root = SCRIPT.parents[1]
    text = (root / "requirements" / f"{kind}.txt").read_text()
    pinned, locked = (
        dict(re.findall(r"^([^#\s=]+)==([^\s;]+)", each.lower().replace("_", "-"), re.M))
        for each in ((root / "constraints.txt").read_text(), text)
    )

    assert len(locked) > 30
    assert not [name for name in locked.keys() & pinned if locked[name] != pinned[name]]
    assert not {"torch", "torchvision"} & locked.keys()
    entries = re.split(r"\n(?=\S)", re.sub(r"(?m)^ *#.*\n", "", text).strip())
    assert all(re.search(r"( \\\n +--hash=sha256:[0-9a-f]{64})+$", entry) for entry in entries)
