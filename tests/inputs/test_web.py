"""Addresses of the web: images are fetched, streams are not."""

import base64
import io
import time
from collections.abc import Callable, Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest
import torch
from PIL import Image

from roadtorch import detect_stream, load_detector
from roadtorch.base import urls
from roadtorch.base.errors import InputError
from roadtorch.base.image import decode_image, read_image, to_pixels
from roadtorch.inputs.find import find_inputs
from roadtorch.inputs.pictures import find_pictures
from roadtorch.testing import street

Answer = Callable[[BaseHTTPRequestHandler], None]


def picture(kind: str = "PNG") -> bytes:
    data = io.BytesIO()
    Image.fromarray(to_pixels(street(48, 64, 1))).save(data, kind)
    return data.getvalue()


def body(data: bytes, kind: str, length: int | None = None) -> Answer:
    def send(handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", kind)
        handler.send_header("Content-Length", str(len(data) if length is None else length))
        handler.end_headers()
        handler.wfile.write(data)

    return send


def moved(handler: BaseHTTPRequestHandler) -> None:
    handler.send_response(302)
    handler.send_header("Location", "/a.png")
    handler.end_headers()


def locked(handler: BaseHTTPRequestHandler) -> None:
    told = base64.b64encode(b"me:s:cret").decode()
    if handler.headers["Authorization"] == f"Basic {told}":
        body(picture(), "image/png")(handler)
    else:
        handler.send_error(401)


ANSWERS: dict[str, Answer] = {
    "/a.png": body(picture(), "image/png"),
    "/snapshot": body(picture(), "image/png"),
    "/plain.png": body(picture(), "application/octet-stream"),
    "/moved.png": moved,
    "/locked.png": locked,
    "/cut.png": body(picture(), "image/png", 10**6),
    "/late.png": lambda _: time.sleep(1),
    "/camera.png": body(b"", "multipart/x-mixed-replace; boundary=x"),
    "/live": body(b"", "video/mp2t"),
}


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        ANSWERS.get(self.path.partition("?")[0], lambda handler: handler.send_error(404))(self)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def host() -> Iterator[str]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = Thread(target=partial(server.serve_forever, 0.01))
        thread.start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("a.png", "a.png"),
        ("a.png?size=2", "a.png"),
        ("snapshot", "snapshot"),
        ("plain.png", "plain.png"),
        ("moved.png", "moved.png"),
    ],
)
def test_a_picture_is_what_the_server_calls_one_or_else_its_name(
    path: str, name: str, host: str
) -> None:
    (found,), sources = find_inputs([f"http://{host}/{path}"])

    assert sources == []
    assert found.row_name == name
    assert torch.equal(found.read(), street_as_png())


def test_detectors_and_streams_take_an_address(host: str) -> None:
    detector, url = load_detector("prior:rows"), f"http://{host}/a.png"

    assert detector(url).mask.shape == (48, 64)
    assert [detection.mask.shape for detection in detect_stream(url, detector)] == [(48, 64)]


@pytest.mark.parametrize("url", ["s3://bucket/a.png", "file:///a.png", "zip://a.png"])
def test_addresses_of_no_server_are_refused(url: str) -> None:
    with pytest.raises(InputError, match=f"{url}: is not of the web"):
        read_image(url)
    for find in (find_inputs, find_pictures):
        with pytest.raises(InputError, match=f"{url}: is an address that is not read"):
            find([url])


def test_a_password_is_sent_and_told_nobody(host: str) -> None:
    (found,), _ = find_inputs([f"http://me:s%3Acret@{host}/locked.png"])
    assert torch.equal(found.read(), street_as_png())

    with pytest.raises(InputError) as error:
        find_inputs([f"http://me:wrong@{host}/locked.png"])
    assert str(error.value).startswith(f"http://{host}/locked.png: is answered with 401")


@pytest.mark.parametrize("path", ["camera.png", "live"])
def test_what_does_not_end_is_a_stream(path: str, host: str) -> None:
    pictures, (source,) = find_inputs([f"http://{host}/{path}"])

    assert pictures == []
    assert source.live


@pytest.mark.parametrize(
    ("path", "problem"),
    [
        ("none.png", "is answered with 404 Not Found"),
        ("cut.png", "cannot be fetched: it is cut after"),
        ("late.png", "cannot be fetched: 0.2 seconds without an answer"),
    ],
)
def test_what_servers_do_wrong_is_said_in_a_line(
    path: str, problem: str, host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urls, "ANSWER", 0.2)

    with pytest.raises(InputError) as error:
        read_image(f"http://{host}/{path}")

    assert str(error.value).startswith(f"http://{host}/{path}: {problem}")
    assert "\n" not in str(error.value)


def test_a_body_that_is_too_large_and_a_host_that_is_not_there_are_refused(
    host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(urls, "MAX_BYTES", 100)
    with pytest.raises(InputError, match="has more than 100 bytes"):
        read_image(f"http://{host}/a.png")

    with pytest.raises(InputError, match=r"cannot be fetched: .*refused"):
        read_image("http://127.0.0.1:9/a.png")


def street_as_png() -> torch.Tensor:
    return decode_image(picture(), "street")
