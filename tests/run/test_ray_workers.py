"""Ray on this machine, as users start it: same files as without Ray, after crashes and Ctrl-C too.

In subprocesses: Ray opens sockets on the loopback and emits deprecation warnings.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep

import pytest
from click.testing import CliRunner

from roadtorch.cli import main
from roadtorch.testing.scenes import render_scene, write_image
from tests.command import bytes_in, read_index_rows

COMMAND = [sys.executable, "-m", "roadtorch", "infer"]
WORK = ("--detector", "cpf", "--threads", "1", "--save", "likelihood,mask,overlay,json")
RAY = ("--engine", "ray", "--jobs", "2")
LONGEST = 900.0  # seconds for what takes ten on an idle machine


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of 16 small rendered streets and a file that is not an image."""
    folder = tmp_path_factory.mktemp("images")
    for seed in range(16):
        write_image(folder / f"{seed:02}.png", render_scene(seed, 60, 80))
    (folder / "bad.png").write_bytes(b"no image")
    return folder


@pytest.fixture(scope="module")
def expected(images: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a run without Ray."""
    out = tmp_path_factory.mktemp("expected")
    CliRunner().invoke(main, ["infer", str(images), *WORK, "--out", str(out)])
    return out


def start(*words: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*COMMAND, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"RAY_worker_niceness": "0"},  # 15: next to nothing on a busy machine
    )


def wait_for_a_mask(out: Path, run: subprocess.Popen[str]) -> None:
    end = monotonic() + LONGEST
    while not any(out.rglob("*.mask.png")):
        assert run.poll() is None, run.communicate()
        assert monotonic() < end
        sleep(0.01)


def find_actors(run: subprocess.Popen[str]) -> Iterator[int]:
    """Yield the processes of a run's Ray actors, by their names and ancestors."""
    for entry in Path("/proc").iterdir():
        try:
            words = (entry / "cmdline").read_bytes() if entry.name.isdigit() else b""
        except OSError:
            continue
        if words.startswith(b"ray::") and b"Actor" in words and run.pid in parents(entry.name):
            yield int(entry.name)


def parents(process: str) -> Iterator[int]:
    while process not in ("0", "1"):
        status = Path("/proc", process, "stat").read_text()
        process = status.rpartition(")")[2].split()[1]
        yield int(process)


def without_ms(out: Path) -> dict[str, dict[str, str]]:
    rows = read_index_rows(out)
    for row in rows.values():
        row["ms"] = ""
    return rows


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for the worker in /proc")
def test_a_killed_worker_costs_one_image(images: Path, expected: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = start(images, *WORK, "--out", out, *RAY)
    wait_for_a_mask(out, run)
    os.kill(next(find_actors(run)), signal.SIGKILL)

    stderr = run.communicate(timeout=LONGEST)[1]

    lines = [line for line in stderr.splitlines() if " left" not in line]  # of the progress
    failed = {name: row for name, row in read_index_rows(out).items() if row["status"] != "done"}
    assert run.returncode == 1, stderr
    assert len(lines) == 3, stderr
    assert lines[-1] == f"roadtorch: 15 done, 2 failed; results in {out}"
    assert failed.pop("bad.png")["status"] in lines[0] + lines[1]
    ((name, row),) = failed.items()
    assert f"{images}/{name}: its worker process died" in row["status"]
    assert row["status"] in lines[0] + lines[1]
    done = {file: data for file, data in bytes_in(expected).items() if name[:2] != file[:2]}
    assert {file: data for file, data in bytes_in(out).items() if name[:2] != file[:2]} == done

    CliRunner().invoke(main, ["infer", str(images), *WORK, "--out", str(out)])

    assert bytes_in(out) == bytes_in(expected)
    assert without_ms(out) == without_ms(expected)


@pytest.mark.slow
def test_an_interrupted_run_keeps_its_rows(images: Path, expected: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    run = start(images, *WORK, "--out", out, *RAY)
    wait_for_a_mask(out, run)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: Ray's processes get it too

    stderr = run.communicate(timeout=LONGEST)[1]

    rows = read_index_rows(out)
    assert run.returncode == 130, stderr
    assert stderr.endswith("roadtorch: interrupted; finished results are kept\n")
    assert 0 < len(rows) < 17
    subprocess.run([*COMMAND, images, *WORK, "--out", out], capture_output=True, check=False)
    assert bytes_in(out) == bytes_in(expected)
    assert without_ms(out) == without_ms(expected)


@pytest.mark.slow
def test_no_cluster_at_the_address_is_one_line(images: Path, tmp_path: Path) -> None:
    run = start(images, *WORK, "--out", tmp_path / "out", "--engine", "127.0.0.1:9")

    stderr = run.communicate(timeout=LONGEST)[1]

    assert run.returncode == 2
    assert stderr.startswith("roadtorch: error: --engine 127.0.0.1:9: no Ray cluster answers: ")
    assert stderr.count("\n") == 1
