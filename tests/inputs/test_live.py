"""Streams over the loopback that break off, fall silent or never answer; no camera."""

import socket
import time
from collections.abc import Iterator
from contextlib import closing
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from threading import Event

import pytest

from roadtorch.base.errors import InputError
from roadtorch.inputs import live
from roadtorch.inputs.item import Item, Selection
from roadtorch.inputs.live import camera_source, newest_frames, stream_source
from tests.servers import send, serving
from tests.videos import write_video


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"TIMEOUT": 60.0, "RETRIES": 2, "BACKOFF": 0.05}.items():
        monkeypatch.setattr(live, name, value)


@pytest.fixture
def stream(tmp_path: Path) -> bytes:
    """Return a second of MPEG-TS, cut in the middle of a packet."""
    path = write_video(tmp_path / "live.ts", [n / 20 for n in range(40)], options={"g": "5"})
    return path.read_bytes()[:-1000]


def test_a_stream_that_breaks_off_is_connected_to_anew(stream: bytes) -> None:
    connections, numbers, seconds = [], [], []

    def answer(handler: BaseHTTPRequestHandler) -> None:
        connections.append(handler.path)
        if len(connections) > 3:
            handler.send_error(503)
        else:
            send(stream, "video/mp2t", 0)(handler)

    def look(frames: Iterator[Item]) -> None:
        for frame in frames:
            numbers.append(frame.number)
            seconds.append(frame.seconds)
            assert frame.read().shape == (3, 48, 64)
            while len(connections) < 2:  # until the first stream is over
                time.sleep(0.01)

    with serving(answer) as host:  # FFmpeg's sockets are not those that tests are kept from
        url = f"http://{host}/live"
        with pytest.raises(InputError, match="reconnecting failed 2 times") as caught:
            look(stream_source(url, "live", Selection()).items())

    assert len(connections) == 5  # three good ones, and two tries after the last
    assert caught.value.where == url
    assert numbers == sorted(set(numbers))
    assert numbers[-1] + 1 > len(numbers)  # some went by while others were looked at
    assert seconds[0] == 0
    assert seconds == sorted(seconds)


def test_a_limit_closes_the_connection(stream: bytes) -> None:
    with serving(send(stream, "video/mp2t", 0)) as host:
        frames = stream_source(f"http://{host}/live", "live", Selection(limit=2)).items()

        assert [frame.name[:5] for frame in frames] == ["live/", "live/"]


def test_a_stream_that_never_answers_is_given_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "TIMEOUT", 0.5)
    monkeypatch.setattr(live, "BACKOFF", 60)
    with closing(socket.create_server(("127.0.0.1", 0))) as silent:
        url = f"http://127.0.0.1:{silent.getsockname()[1]}/live"
        start = time.monotonic()

        with pytest.raises(InputError, match=r"gives no answer within 0.5 seconds"):
            next(stream_source(url, "live", Selection()).items())

    assert time.monotonic() - start < 60  # no reconnection was tried


def test_nobody_there_is_told_at_once() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
    url = f"rtsp://user:secret@127.0.0.1:{port}/live"

    with pytest.raises(InputError, match="cannot be read: Connection refused") as caught:
        next(stream_source(url, "live", Selection()).items())

    assert "secret" not in str(caught.value)


def test_no_such_camera(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="camera:63: no such camera"):
        next(camera_source(63, Selection()).items())

    assert capfd.readouterr().err == ""


def test_only_the_newest_frame_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"GRACE_PERIOD": 0.5, "TIMEOUT": 0.5, "RETRIES": 0, "BACKOFF": 0}.items():
        monkeypatch.setattr(live, name, value)
    looked, sent, end = Event(), Event(), Event()

    def connect() -> Iterator[None]:
        yield None
        looked.wait(60)
        yield from (None, None, None)
        sent.set()
        end.wait(60)
        raise InputError("x", "has ended", "check the stream")

    frames = newest_frames(connect, "x", "x")  # pyright: ignore

    assert next(frames).number == 0
    looked.set()
    sent.wait(60)
    assert next(frames).number == 3
    with pytest.raises(InputError, match=r"x: gives no frame within 1.5 seconds"):
        next(frames)
    end.set()


def test_an_unforeseen_error_in_the_thread_is_raised() -> None:
    def connect() -> Iterator[None]:
        raise ZeroDivisionError("oh")
        yield

    with pytest.raises(InputError, match=r"ZeroDivisionError: oh \(report it\)"):
        next(newest_frames(connect, "x", "x"))  # pyright: ignore[reportArgumentType]
