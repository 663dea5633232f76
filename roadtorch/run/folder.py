"""The folder of a run's results: locked, and who owns which name in it."""

import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from roadtorch.base.atomic import locked, make_folder, remove_leftovers, write_text
from roadtorch.base.bounded import printable, read_regular
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.data.maps import CONFIG
from roadtorch.run.ledger import INDEX

ELSEWHERE = "give another --out"
COCO, RUN = "coco.json", "run.json"


@contextmanager
def output_lock(out: Path) -> Iterator[None]:
    """A folder for the results of this run alone, without what killed runs left half-written.

    Raises InputError before the work when it cannot be written, or another run writes there.
    """
    if re.match(r"[A-Za-z0-9+.-]{2,}:/", str(out)):
        raise InputError(out, "is an address", "give a folder, and copy or sync it")
    make_folder(out, ELSEWHERE)
    try:
        tempfile.TemporaryFile(dir=out).close()
    except OSError as error:
        problem = f"cannot be written: {error.strerror}"
        raise InputError(out, problem, ELSEWHERE) from None
    with locked(out, "wait for it, or give another --out"):
        remove_leftovers([out])
        yield


@contextmanager
def result_folder(out: Path, effective: str, overwrite: bool) -> Iterator[None]:
    """Lock the folder of a run's results for this run, with its settings, ``effective``, in it.

    Raises as ``output_lock``, and ConfigError if earlier settings were different, unless
    ``overwrite``: a second run with another detector would skip what the first one did, and the
    folder would mix the results of both.
    """
    with output_lock(out):
        config, effective = out / CONFIG, effective + "\n"
        try:
            is_other = config.exists() and read_regular(config) != printable(effective).encode()
        except OSError as error:
            raise InputError(config, f"cannot be read: {error.strerror}", ELSEWHERE) from None
        if is_other and (out / INDEX).exists() and not overwrite:
            problem = f"holds results of other settings ({CONFIG})"
            raise ConfigError(out, problem, ELSEWHERE + ", or --overwrite")
        write_text(config, effective)
        yield
