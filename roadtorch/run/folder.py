"""The output folder of a run: locked for one run, and holding results of one setting only."""

import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from roadtorch.base.atomic import (
    claim_results,
    lock_folder,
    make_folder,
    remove_leftovers,
    write_text,
)
from roadtorch.base.bounded import read_regular, to_printable
from roadtorch.base.errors import ConfigError, InputError
from roadtorch.base.settings import INFER_CONFIG
from roadtorch.run.ledger import INDEX_FILE

OUT_HINT = "give another --out"
COCO_FILE, RUN_FILE = "coco.json", "run.json"


@contextmanager
def lock_output(out: Path) -> Iterator[None]:
    """Create, clean and lock an output folder; InputError if it is locked or cannot be written."""
    if re.match(r"[A-Za-z0-9+.-]{2,}:/", str(out)):
        raise InputError(out, "is an address", "give a local folder, then copy or sync it")
    make_folder(out, OUT_HINT)
    try:
        tempfile.TemporaryFile(dir=out).close()
    except OSError as error:
        raise InputError(out, f"cannot be written: {error.strerror}", OUT_HINT) from None
    with lock_folder(out, "wait for it, or give another --out"):
        remove_leftovers([out])
        yield


@contextmanager
def open_result_folder(
    out: Path,
    effective: str,
    overwrite: bool,
    results: Mapping[str, str] = {},
    is_same: Callable[[str], bool] = lambda name: False,
) -> Iterator[None]:
    """Lock an output folder, claim results, and write the effective settings, as TOML, into it.

    Raises as ``lock_output`` and ``claim_results``, and ConfigError where the folder holds results
    of different settings, unless ``overwrite``: the second run would skip what the first one did,
    and mix their results.
    """
    results = {INDEX_FILE: "", INFER_CONFIG: "", **results}
    with lock_output(out), claim_results(out, results, overwrite, is_same):
        config, effective = out / INFER_CONFIG, effective + "\n"
        try:
            differs = config.exists() and read_regular(config) != to_printable(effective).encode()
        except OSError as error:
            raise InputError(config, f"cannot be read: {error.strerror}", OUT_HINT) from None
        if differs and (out / INDEX_FILE).exists() and not overwrite:
            problem = f"holds results of other settings ({INFER_CONFIG})"
            raise ConfigError(out, problem, OUT_HINT + ", or --overwrite")
        write_text(config, effective)
        yield
