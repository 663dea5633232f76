"""Detectors as files that run without Python."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from roadtorch.detector import Detector
from roadtorch.errors import ConfigError, InputError, unknown_name
from roadtorch.export.exportable import (
    BOUND,
    Parity,
    Run,
    exportable,
    notes_of,
    parity,
    rendered_batches,
)
from roadtorch.export.files import open_onnx, open_openvino, write_onnx, write_openvino
from roadtorch.export.graph import EveryPixel, WholePictures
from roadtorch.io.atomic import atomic, make_folder


@dataclass(frozen=True)
class Format:
    """A format of files. suffixes: how they end; the one that is opened is the first.

    needs: the packages of the extra by its name. write: module, notes, path. open: path, threads.
    """

    suffixes: tuple[str, ...]
    needs: tuple[str, ...]
    write: Callable[[WholePictures | EveryPixel, Mapping[str, str], Path], None]
    open: Callable[[Path, int], Run]


FORMATS: Mapping[str, Format] = {
    "onnx": Format((".onnx",), ("onnx", "onnxscript", "onnxruntime"), write_onnx, open_onnx),
    "openvino": Format(
        (".xml", ".bin"), ("openvino", "onnx", "onnxscript"), write_openvino, open_openvino
    ),
}


@dataclass(frozen=True)
class Exported:
    """What was written: files, what they say about themselves, and how far they are off."""

    files: tuple[Path, ...]
    notes: Mapping[str, str]
    parity: Parity


def export_detector(detector: Detector, out: Path, kind: str) -> Exported:
    """Write what can be exported of a detector in a format, once it says what Python says.

    Raises ConfigError for what cannot be exported, an unknown format, another suffix than the
    format has, and a missing extra; InputError when the file would be more than ``BOUND`` off
    (then nothing is written), and when it cannot be written.
    """
    made = format_named(kind)
    if out.suffix != made.suffixes[0]:
        what = f"does not end as {kind} files do"
        raise ConfigError(out, what, f"name it {out.stem or 'road'}{made.suffixes[0]}")
    part = exportable(detector)
    make_folder(out.parent)
    notes = notes_of(detector, part)
    with TemporaryDirectory(prefix="roadtorch.") as folder:
        path = Path(folder) / out.name
        made.write(part.module, notes, path)
        run = made.open(path, torch.get_num_threads())
        found = parity(run, part.reference, rendered_batches())
        if not found.most <= BOUND:
            what = f"would be {found.most:.2g} off in its {found.where}, more than {BOUND:g}"
            raise InputError(out, what, "nothing was written; try other versions of the extra")
        files = tuple(out.with_suffix(suffix) for suffix in made.suffixes)
        for file in reversed(files):
            with atomic(file) as temporary:
                shutil.copyfile(path.with_suffix(file.suffix), temporary)
    return Exported(files, notes, found)


def format_named(kind: str) -> Format:
    """The format of that name; ConfigError where there is none, or its extra is missing."""
    if kind not in FORMATS:
        raise unknown_name("format", kind, FORMATS)
    missing = [name for name in FORMATS[kind].needs if find_spec(name) is None]
    if missing:
        what = f"needs {', '.join(missing)}: not installed"
        raise ConfigError(f"format {kind}", what, f"pip install 'roadtorch[{kind}]'")
    return FORMATS[kind]
