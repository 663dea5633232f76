"""The server's life: its port, its token, and what a restart has to find again."""

import json
import os
import secrets
import socket
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pydantic
from pydantic import Field

from roadtorch.annotate.machine import AnnotationSettings
from roadtorch.annotate.next_pictures import PictureOrder
from roadtorch.annotate.session import Session, look_at_all
from roadtorch.annotate.views import VIEWS, ViewStore
from roadtorch.annotate.work import PictureFolder
from roadtorch.data.event_log import read_logs
from roadtorch.detector import Detector
from roadtorch.errors import ConfigError
from roadtorch.io.atomic import atomic, remove_leftovers
from roadtorch.settings import Settings

HOST = "127.0.0.1"  # and never another one

FIRST_PORT, PORTS = 8765, 50

FILE = ".session.json"


class Address(Settings):
    """Where a page was last, so that one that is open finds a server that was started again."""

    port: int = Field(ge=1, le=65535)
    token: str = Field(min_length=20, max_length=100)

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"


def last_address(out: Path) -> Address | None:
    """The address that was used for a folder of corrections before, if it is known."""
    try:
        return Address.model_validate_json((out / FILE).read_bytes())
    except (OSError, pydantic.ValidationError):
        return None


def keep_address(out: Path, address: Address) -> None:
    """Remember the address; the file is for its owner alone."""
    with atomic(out / FILE) as temporary:
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w") as file:
            json.dump(address.model_dump(), file)


def bound_socket(port: int | None, last: int | None) -> socket.socket:
    """A listening socket on the loopback interface.

    port: the one that was asked for; ConfigError where it is taken. Else the last one, or the
    next one that is free.
    """
    free = [*([last] if last else []), *range(FIRST_PORT, FIRST_PORT + PORTS)]
    for candidate in free if port is None else [port]:
        found = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((HOST, candidate))
            found.listen()
        except OSError:
            found.close()
        else:
            return found
    if port is not None:
        raise ConfigError("--port", f"{port} is taken", "give another one, or leave it out")
    last_port = FIRST_PORT + PORTS - 1
    raise ConfigError("--port", f"{FIRST_PORT} to {last_port} are taken", "give one that is free")


def opened_session(
    folder: Path,
    out: Path,
    detector: Detector,
    settings: AnnotationSettings | None = None,
    order: PictureOrder | None = None,
) -> Session:
    """A session for a folder; DatasetError where a log in ``out`` cannot be read.

    What killed ones left half-written is removed, so no other may be at work there.
    """
    settings = settings or AnnotationSettings()
    read_logs(out)
    remove_leftovers(Path(below) for below, _, _ in os.walk(out / VIEWS))
    views = ViewStore(out / VIEWS, detector, settings)
    return Session(PictureFolder(folder, out), views, out, settings, order=order)


@dataclass
class PageServer:
    """A server that is ready to run. address: where its page is."""

    address: Address
    session: Session
    _server: Any
    _listening: socket.socket

    def run(self) -> None:
        """Serve, and look at the pictures meanwhile, until interrupted or told to stop."""
        stop = threading.Event()
        looking = threading.Thread(target=look_at_all, args=(self.session, stop), daemon=True)
        looking.start()
        try:
            self._server.run(sockets=[self._listening])
        finally:
            stop.set()
            looking.join(10)

    def stop(self) -> None:
        """End ``run``, from another thread."""
        self._server.should_exit = True


def page_server(session: Session, port: int | None = None) -> PageServer:
    """The server of a session's page, its port taken and its address kept for a restart.

    Raises ConfigError for a port that is taken, and without the packages that it needs.
    """
    try:
        import uvicorn

        from roadtorch.annotate.server import Impatient, annotation_app
    except ImportError:
        remedy = "pip install 'roadtorch[annotate]'"
        raise ConfigError("annotate", "needs Starlette and uvicorn", remedy) from None
    last = last_address(session.out)
    listening = bound_socket(port, last.port if last else None)
    token = last.token if last else secrets.token_urlsafe(24)
    address = Address(port=listening.getsockname()[1], token=token)
    keep_address(session.out, address)
    app = annotation_app(session, token, address.port)
    config = uvicorn.Config(
        app, http=Impatient, log_level="error", access_log=False, timeout_graceful_shutdown=2
    )
    return PageServer(address, session, uvicorn.Server(config), listening)
