"""Labels of other programs, brought in as the work of a user."""

import os
import secrets
import time
from pathlib import Path

import numpy as np

from roadtorch.annotate.pictures import PictureFolder
from roadtorch.annotate.session import checked_user
from roadtorch.annotate.work import open_work
from roadtorch.data.correction_formats import FORMATS
from roadtorch.data.correction_labels import LABELS
from roadtorch.data.journal import JournalHead, journal_path
from roadtorch.data.labelme import picture_size
from roadtorch.data.strokes import Brought, runs_of


def bring_in(name: str, origin: Path, folder: Path, out: Path, user: str) -> int:
    """Add the labels of a format in ``origin`` to a user's journals; how many pictures had some.

    Raises ConfigError for a name that is none for a user, DatasetError for what cannot be read;
    then nothing was added.
    """
    checked_user(user)
    pictures = PictureFolder(folder, out)
    sizes = {one: picture_size(pictures.path(one)) for one in pictures.names()}
    found = FORMATS[name].read(origin, sizes)
    for picture, labels in found.items():
        height, width = sizes[picture]
        relative = os.path.relpath(pictures.root / picture, pictures.apart)
        head = JournalHead(picture=relative, user=user, height=height, width=width)
        act = brought(labels)
        open_work(journal_path(out, picture, user), head).add(act)
    return len(found)


def brought(labels: np.ndarray) -> Brought:
    """The act that makes labels uint8 (H,W) what they are here."""
    present = np.unique(labels).tolist()
    runs = {LABELS[number]: runs_of(labels == number) for number in present}
    identity = secrets.token_hex(16)
    return Brought(kind="brought", id=identity, time=round(time.time(), 3), labels=runs)
