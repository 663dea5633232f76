"""The folder of results: one that can be written, by this run alone, tidy."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from roadtorch.errors import InputError
from roadtorch.io.atomic import locked, make_folder, remove_leftovers

ELSEWHERE = "give another --out"


@contextmanager
def claimed(out: Path) -> Iterator[None]:
    """A folder for the results of this run alone, without what killed runs left half-written.

    Raises InputError before the work when it cannot be written, or another run writes there.
    """
    make_folder(out, ELSEWHERE)
    try:
        tempfile.TemporaryFile(dir=out).close()
    except OSError as problem:
        what = f"cannot be written: {problem.strerror}"
        raise InputError(out, what, ELSEWHERE) from None
    with locked(out, "wait for it, or give another --out"):
        remove_leftovers([out])
        yield
