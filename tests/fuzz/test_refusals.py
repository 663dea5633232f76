"""The contract of every reader: a file that it cannot use is refused in one line with a hint.

    python -m pytest tests/fuzz                              # some of each kind
    python -m pytest tests/fuzz --hypothesis-profile long    # thousands of each

A file is read plausibly, or is refused as ``FILE: problem (hint)``: no traceback,
no hang, no memory without end, nothing half-written.
"""

import faulthandler
import os
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from roadtorch.base.compute import peak_memory_mib
from roadtorch.base.errors import RoadtorchError
from tests.command import Call, files_in, save_image
from tests.fuzz.footage import FOOTAGE
from tests.fuzz.kinds import KINDS
from tests.fuzz.mutations import Draw, fuzz_settings, scene
from tests.streets import write_drives

Read = Callable[[Path], bool]

SECONDS, GIBIBYTES = 20, 2.0
LONGEST = 1_500  # letters of a refusal, its file's name left out
STDERR = 2  # whatever sys.stderr is meanwhile


def check_line(error: RoadtorchError, path: Path) -> None:
    """Assert that a refusal is one line: the file or its folder, what is wrong, what to do."""
    text = str(error)
    assert path.name in error.where or error.where == str(path.parent), "the name is missing"
    assert error.problem, "it does not say what is wrong"
    assert error.hint, "it does not say what to do"
    assert len(text) <= LONGEST + 3 * len(str(path)), "a refusal without end"
    assert len(f"{error.problem}{error.hint}".splitlines()) == 1, "several lines"


def verdict(path: Path, read: Read) -> str:
    """Return "read" or "refused"; AssertionError where neither is right.

    A hang ends the process, with the stack.
    """
    faulthandler.dump_traceback_later(SECONDS, exit=True, file=STDERR)
    with suppress(OSError):  # the peak of this file alone, where the system can (Linux)
        Path("/proc/self/clear_refs").write_text("5")
    refusal = None
    try:
        assert read(path), "the result is not plausible"
    except RoadtorchError as error:
        refusal = error
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert peak_memory_mib() < GIBIBYTES * 2**10
    if refusal is None:
        return "read"
    check_line(refusal, path)
    return "refused"


# --- mutated files --------------------------------------------------------------------------

FILES = {name: (kind.write, kind.read) for name, kind in KINDS.items()} | FOOTAGE


@pytest.mark.parametrize(("make", "read"), FILES.values(), ids=FILES)
def test_mutated_files_are_read_or_refused(make: Callable[[Draw, Path], Path], read: Read) -> None:
    verdicts: Counter[str] = Counter()

    @fuzz_settings()
    @given(st.data())
    def check(data: st.DataObject) -> None:
        with tempfile.TemporaryDirectory() as folder:
            verdicts[verdict(make(data.draw, Path(folder)), read)] += 1

    check()

    assert verdicts["refused"] > 0


# --- files of another kind ------------------------------------------------------------------

FOREIGN: Mapping[str, Callable[[Path], object]] = {
    "missing": lambda path: None,
    "empty": lambda path: path.write_bytes(b""),
    "folder": lambda path: path.mkdir(),
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path.name),
    "image": lambda path: scene(0).save(path, "PNG"),
    "page": lambda path: path.write_text("<!DOCTYPE html>\n<html><body>404</body></html>\n"),
    "values": lambda path: path.write_text('{"a": [1, 2, {}], "detectors": 3}'),
    "settings": lambda path: path.write_text('detector = "none"\n[network]\nwide = -1\n'),
    "noise": lambda path: path.write_bytes(bytes(range(256)) * 40),
}


# --- the command line -----------------------------------------------------------------------

PRIOR = "--detector prior:rows"
COMMANDS: Mapping[str, set[str]] = {
    f"infer @a.png {PRIOR}": {"image"},
    f"infer @a.mp4 {PRIOR}": {"image"},  # FFmpeg goes by the content
    f"infer @a.bag {PRIOR}": set(),
    f"infer @a.mcap {PRIOR}": set(),
    "infer IMAGE --config @a.toml": {"empty"},
    f"infer IMAGE {PRIOR} --camera @camera.toml": set(),
    f"infer IMAGE {PRIOR} --set ego.mask=@ego.png": {"image"},
    "infer IMAGE --detector layout:cnn-7 --set weights.file=@a.safetensors": set(),
    "label @a.png": {"image"},
    f"infer IMAGE {PRIOR} --save grid --set grid.height=1 --camera @camera.toml": set(),
    "camera IMAGE --camera-info @info.yaml": set(),
    "camera @a.mp4": set(),
    "train --images @a.png --config cnn7": {"image"},
    "train --images IMAGE --config @a.toml": {"empty"},
    "train --images IMAGE --config corrections --corrections @corrections": set(),
    "adapt @a.mp4": set(),
    f"evaluate camvid @camvid {PRIOR}": set(),
    f"evaluate camvid CAMVID {PRIOR} --conditions @a.csv": set(),
    f"evaluate camvid CAMVID {PRIOR} --threshold-from @metrics.json": set(),
    f"evaluate camvid CAMVID {PRIOR} --camera @camera.toml": set(),
    "annotate FOLDER --import coco --from @coco.json": set(),
}
"""Commands with a wrong file, and the files that they accept."""


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, str]:
    """Write the inputs that commands need apart from the wrong file."""
    folder = tmp_path_factory.mktemp("inputs")
    image = save_image(folder / "folder" / "street.png")
    write_drives(folder)
    return {"IMAGE": str(image), "FOLDER": str(image.parent), "CAMVID": str(folder / "camvid")}


@pytest.mark.parametrize("line", COMMANDS)
def test_a_command_says_in_a_line_what_is_wrong_and_leaves_nothing_half_written(
    line: str, call: Call, places: Mapping[str, str], tmp_path: Path
) -> None:
    for name in FOREIGN.keys() - COMMANDS[line]:
        folder = tmp_path / name
        folder.mkdir()
        FOREIGN[name](folder / re.findall(r"@(\S+)", line)[0])
        words = [places.get(word, word).replace("@", f"{folder}/") for word in line.split()]

        result = call(*words, "--out", folder / "out")

        about = f"{name}: {result.stderr}"
        (file,) = re.findall(rf"{folder}/(\S+)", " ".join(words))
        key = "none|network.wide" if name == "settings" and "--config @" in line else file
        assert result.exit_code in (1, 2), about
        assert "bug in roadtorch" not in about
        assert re.search(rf"^roadtorch: .*({key})", result.stderr, re.M), about
        assert not any(".part" in written for written in files_in(folder)), about
        if result.exit_code == 2:
            assert re.fullmatch(r"(.+\n)?roadtorch: error: .+ \(.+\)\n", result.stderr), about
