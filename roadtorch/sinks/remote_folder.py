"""A folder of results behind a URL of fsspec."""

import posixpath
import secrets
from dataclasses import dataclass
from typing import Any

from roadtorch.errors import InputError
from roadtorch.io.addresses import file_system, url_errors
from roadtorch.io.atomic import LEFTOVER

RENAMING = ("file", "local", "memory", "sftp", "ssh", "smb", "hdfs")
"""File systems that show a file while it is written, and rename at no cost. Those of object
stores show nothing before all is there, and rename by copying."""


@dataclass(frozen=True)
class RemoteFolder:
    """A folder behind a URL; it need not exist. It can be pickled."""

    url: str

    def write(self, name: str, data: bytes) -> None:
        """Write a file, never half of it; sub-folders in its name are made.

        Raises InputError naming the file when it cannot be written.
        """
        system, path = self._at(name)
        with url_errors(self.shown(name)):
            system.makedirs(posixpath.dirname(path), exist_ok=True)
            if not _renames(system):
                system.pipe_file(path, data)
                return
            half = posixpath.join(
                posixpath.dirname(path), f".roadtorch.{secrets.token_hex(4)}.part"
            )
            system.pipe_file(half, data)
            system.mv(half, path)

    def read(self, name: str) -> bytes | None:
        """The bytes of a file; None where there is none. InputError when it cannot be read."""
        system, path = self._at(name)
        with url_errors(self.shown(name)):
            return system.cat_file(path) if system.exists(path) else None

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        system, path = self._at(name)
        with url_errors(self.shown(name)):
            return system.isfile(path)

    def tidy(self) -> None:
        """Remove what killed workers left half-written; nobody may be writing there now."""
        system, path = self._at("")
        if not _renames(system):
            return
        with url_errors(self.url):
            for file in system.find(path):
                if LEFTOVER.fullmatch(posixpath.basename(file)):
                    system.rm_file(file)

    def shown(self, name: str) -> str:
        """What messages call a file."""
        return f"{self.url.rstrip('/')}/{name}"

    def _at(self, name: str) -> tuple[Any, str]:
        if "::" in self.url:
            what = "is inside another file"
            raise InputError(self.url, what, "give the URL of a folder that can be written")
        system, path = file_system(self.url)
        return system, posixpath.join(path, name) if name else path


def _renames(system: Any) -> bool:
    kinds = system.protocol if isinstance(system.protocol, tuple) else (system.protocol,)
    return any(kind in RENAMING for kind in kinds)
