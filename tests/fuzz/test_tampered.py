"""Files that were tampered with: reading them neither crashes, hangs, eats memory nor hides a name.

    python -m pytest tests/fuzz                              # some of each kind
    python -m pytest tests/fuzz --hypothesis-profile long    # thousands of each

Right is what is read and makes sense, or refused in one line that names the file.
"""

import faulthandler
import os
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadtorch.base.compute import forget_peak, peak_mebibytes
from roadtorch.base.errors import InputError, RoadtorchError
from tests.fuzz.footage import FOOTAGE
from tests.fuzz.kinds import KINDS
from tests.fuzz.tampered import Draw, unhurried

SECONDS, GIBIBYTES = 20, 2.0
LONGEST = 1_500  # letters of a refusal, its file's name left out
STDERR = 2  # whatever sys.stderr is meanwhile


def verdict(path: Path, read: Callable[[Path], bool]) -> str:
    """ "read" or "refused"; AssertionError where neither is right.

    A hang ends the process, with the stack.
    """
    faulthandler.dump_traceback_later(SECONDS, exit=True, file=STDERR)
    forget_peak()
    refusal = ""
    try:
        assert read(path), "what was read makes no sense"
    except RoadtorchError as problem:
        refusal = str(problem)
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert peak_mebibytes() < GIBIBYTES * 2**10
    assert not refusal or path.name in refusal, "the name is missing"
    assert len(refusal) <= LONGEST + 3 * len(str(path)), "a refusal without end"
    return "refused" if refusal else "read"


FILES = {name: (kind.write, kind.read) for name, kind in KINDS.items()}


@pytest.mark.parametrize(("make", "read"), (FILES | FOOTAGE).values(), ids=FILES | FOOTAGE)
def test_tampered_files_are_read_or_refused_by_name(
    make: Callable[[Draw, Path], Path], read: Callable[[Path], bool]
) -> None:
    seen: Counter[str] = Counter()

    @unhurried()
    @given(st.data())
    def check(data: st.DataObject) -> None:
        with tempfile.TemporaryDirectory() as folder:
            seen[verdict(make(data.draw, Path(folder)), read)] += 1

    check()

    assert seen["refused"] > 0


ALONE = [name for name in KINDS if name != "sets" and not name.startswith("imported")]
"""Kinds whose reader gets the file itself, not its text or its folder."""


@pytest.mark.parametrize("name", ALONE)
@pytest.mark.parametrize("other", ["pipe", "device"])
def test_no_reader_waits_for_a_pipe_or_reads_a_device_without_end(other: str, name: str) -> None:
    make, read = FILES[name]

    @settings(unhurried(), max_examples=2)
    @given(st.data())
    def check(data: st.DataObject) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = make(data.draw, Path(folder))
            path.unlink()
            os.mkfifo(path) if other == "pipe" else path.symlink_to("/dev/zero")
            assert verdict(path, read) == "refused"

    check()


@pytest.mark.parametrize(
    ("refusal", "wrong"),
    [(("", "bad", ""), "the name is missing"), (("a.bin", "bad", "r" * 10_000), "without end")],
)
def test_a_refusal_that_is_wrong_is_found(refusal: tuple[str, str, str], wrong: str) -> None:
    def refuse(path: Path) -> bool:
        raise InputError(*refusal)

    with pytest.raises(AssertionError, match=wrong):
        verdict(Path("a.bin"), refuse)
