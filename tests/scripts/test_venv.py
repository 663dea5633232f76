"""scripts/venv.sh: where torch comes from, asked of indices of our own on the loopback."""

import http.server
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "venv.sh"
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere no index is asked")


def test_the_address_of_the_index_stands_in_one_script() -> None:
    root = SCRIPT.parents[1]
    texts = [*root.glob("scripts/*"), root / "Dockerfile", *root.glob(".ci/*")]

    scripts = [path for path in texts if path.is_file()]
    having = [path for path in scripts if b"download.pytorch.org" in path.read_bytes()]

    assert having == [SCRIPT]


class Index(http.server.BaseHTTPRequestHandler):
    """Knows torch and nothing else."""

    def do_GET(self) -> None:
        self.send_response(200 if self.path == "/torch/" else 404)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None: ...


@pytest.fixture
def index() -> Iterator[str]:
    with http.server.HTTPServer(("127.0.0.1", 0), Index) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def silent() -> Iterator[str]:
    """Takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


def chosen(index: str) -> tuple[list[str], str]:
    """pip's options for an index, and the message."""
    code = (
        f'source "{SCRIPT}"; PYTHON={sys.executable}; choose_index; printf "%s\\n" "${{INDEX[@]}}"'
    )
    done = subprocess.run(
        ["bash", "-euc", code],
        env={"PATH": "/usr/bin:/bin", "ROADTORCH_CPU_INDEX": index},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return done.stdout.split(), done.stderr


@LINUX
def test_an_index_of_cpu_wheels_that_answers_is_taken(index: str) -> None:
    options, message = chosen(index)

    assert options == ["--extra-index-url", index]
    assert message == f"torch: CPU wheels from {index} (0.2 GB)\n"


@LINUX
@pytest.mark.parametrize(
    "address",
    ["{index}/elsewhere", "http://127.0.0.1:9", "no address", "http://none.invalid"],
    ids=["without torch", "nobody listens", "no address", "no such name"],
)
def test_without_an_index_of_cpu_wheels_the_size_is_told(index: str, address: str) -> None:
    address = address.format(index=index)

    options, message = chosen(address)

    assert options == []
    assert message.startswith(f"torch: {address} does not answer within 3 seconds.")
    assert "2.8 GB to fetch, 5 GB on disk" in message


@LINUX
def test_an_index_that_keeps_one_waiting_is_left_after_three_seconds(silent: str) -> None:
    start = time.perf_counter()
    options, message = chosen(silent)

    assert options == []
    assert "does not answer" in message
    assert 3 <= time.perf_counter() - start < 60  # a busy machine adds some


@pytest.mark.parametrize("kind", ["base", "test"])
def test_every_file_of_the_package_index_has_the_hashes_of_the_tested_version(kind: str) -> None:
    root = SCRIPT.parents[1]
    lines = (root / "requirements" / f"{kind}.txt").read_text().splitlines()
    pinned = dict(pin.split("==") for pin in pins_of(root / "constraints.txt"))

    names = pins_of(root / "requirements" / f"{kind}.txt")

    assert {name for name in names if name.split("==")[0] in pinned} <= {
        f"{name}=={version}" for name, version in pinned.items()
    }
    assert not {"torch", "torchvision"} & {name.split("==")[0] for name in names}
    ends = [line.endswith("\\") for line in lines if line[0] not in "# "]
    assert len(ends) == len(names) > 30
    assert all(ends)  # a hash follows
    assert all(
        re.fullmatch(r" +--hash=sha256:[0-9a-f]{64}( \\)?", line)
        for line in lines
        if line[0] == " "
    )


def pins_of(path: Path) -> list[str]:
    """name==version of every line, the names as indices have them."""
    lines = (line.split(" ")[0] for line in path.read_text().splitlines())
    pins = (line.partition("==") for line in lines if "==" in line)
    return [f"{re.sub('[-_.]+', '-', name.lower())}=={version}" for name, _, version in pins]
