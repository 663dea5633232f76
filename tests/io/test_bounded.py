"""Files that are none, files without end, and names in any encoding."""

import os
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.camera.calibration import read_calibration
from roadtorch.camera.camera import Camera
from roadtorch.data.annotations import read_annotation
from roadtorch.data.conditions import with_conditions
from roadtorch.data.dataset import Dataset
from roadtorch.data.folder import FolderLabels
from roadtorch.data.labels import read_labels
from roadtorch.data.maps import read_map
from roadtorch.errors import InputError, RoadtorchError
from roadtorch.evaluation.document import earlier_thresholds
from roadtorch.io.bounded import printable, read_regular
from roadtorch.io.image import read_image
from roadtorch.layout.weights import load_network
from roadtorch.road.ego import read_ego_mask
from roadtorch.runs.folder import result_folder
from roadtorch.runs.index import read_index
from roadtorch.settings import read_settings_file
from roadtorch.train.folder import RunFolder
from roadtorch.train.prepared import PreparedFolder, read_arrays
from roadtorch.train.processes import Processes


def test_a_pipe_and_a_device_are_refused_and_nobody_waits(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "zero.png").symlink_to("/dev/zero")

    for name in ("pipe.png", "zero.png"):
        with pytest.raises(InputError, match=rf"{name}: cannot be read: it is a pipe or a device"):
            read_image(tmp_path / name)


def test_a_link_to_itself_is_refused_with_its_name(tmp_path: Path) -> None:
    loop = tmp_path / "loop.png"
    loop.symlink_to(loop)

    with pytest.raises(InputError, match=r"loop\.png: cannot be read: Too many levels"):
        read_image(loop)


def test_a_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")

    assert read_regular(path, most=5) == b"12345"
    with pytest.raises(OSError, match="more than 4 bytes"):
        read_regular(path, most=4)


def test_files_that_grow_as_they_are_read_are_read_to_their_end() -> None:
    assert b"MemTotal" in read_regular("/proc/meminfo")  # whose size is told as 0


def test_bytes_that_are_no_text_are_shown_and_ascii_systems_get_their_letters_back() -> None:
    assert printable(os.fsdecode(b"z\xff.jpg")) == r"z\xff.jpg"
    assert printable("Straße".encode().decode("ascii", "surrogateescape")) == "Straße"
    assert printable("Straße") == "Straße"


@given(st.text(st.characters()))
def test_every_text_can_be_written(text: str) -> None:
    shown = printable(text)

    kept = [letter for letter in text if not 0xD800 <= ord(letter) < 0xE000]
    assert shown.encode().decode() == shown
    assert shown == text or any(0xD800 <= ord(letter) < 0xE000 for letter in text)
    assert not kept or all(letter in shown for letter in kept)


@given(st.binary())
def test_every_name_can_be_written(name: bytes) -> None:
    shown = printable(os.fsdecode(name)).encode()

    assert shown.decode("utf-8") == name.decode("utf-8", "backslashreplace")


# --- every reader -----------------------------------------------------------------------


class Waited(BaseException):
    """No Exception, which a reader might take for damage."""


@contextmanager
def within(seconds: float, path: Path) -> Iterator[None]:
    """Waited instead of reading for ever; who opens a pipe and holds the interpreter is let go."""

    def end(*_: object) -> None:
        raise Waited

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    words = ["sh", "-c", f'sleep {seconds + 1} && exec 3<>"$0"', path]
    writer = subprocess.Popen(words, start_new_session=True)
    try:
        yield
        assert signal.setitimer(signal.ITIMER_REAL, 0)[0] > 0
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        os.killpg(writer.pid, signal.SIGKILL)
        writer.wait()


def _pictures(path: Path) -> Dataset:
    return Dataset("folder", path.parent, "all", (), FolderLabels())


READERS: dict[str, Callable[[Path], object]] = {
    "index.csv": read_index,
    "config.toml": lambda path: result_folder(path.parent, "", False).__enter__(),
    "settings.toml": read_settings_file,
    "camera.toml": Camera.read,
    "conditions.csv": lambda path: with_conditions(_pictures(path), path),
    "calibration.txt": read_calibration,
    "map.npy": read_map,
    "map.png": read_map,
    "ego.png": lambda path: read_ego_mask(str(path)),
    "label.png": read_labels,
    "annotation.json": lambda path: read_annotation(path, (1, 1)),
    "annotation.xml": lambda path: read_annotation(path, (1, 1)),
    "network.safetensors": load_network,
    "metrics.json": lambda path: earlier_thresholds(path, []),
    "prepared.npz": read_arrays,
    "settings.json": lambda path: PreparedFolder(path.parent, Processes()).claim({}),
    "checkpoint.pt": lambda path: RunFolder(path.parent).read_checkpoint(),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_no_reader_waits_for_a_pipe_or_reads_a_device_without_end(
    kind: str, name: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    os.mkfifo(path) if kind == "pipe" else path.symlink_to("/dev/zero")

    with within(3, path), pytest.raises(RoadtorchError, match=re.escape(name)):
        READERS[name](path)
