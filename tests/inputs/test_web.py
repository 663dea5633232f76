"""URLs: images are fetched, streams are not."""

import base64
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler

import pytest
import torch

from roadtorch import detect_stream, load_detector
from roadtorch.base import urls
from roadtorch.base.errors import InputError
from roadtorch.base.image import decode_image, png_bytes, read_image, to_pixels
from roadtorch.inputs.find import find_inputs
from roadtorch.inputs.images import find_images
from roadtorch.testing import street
from tests.servers import Answer, send, serving


def image() -> bytes:
    return png_bytes(to_pixels(street(48, 64, 1)), 64)


def moved(handler: BaseHTTPRequestHandler) -> None:
    handler.send_response(302)
    handler.send_header("Location", "/a.png")
    handler.end_headers()


def locked(handler: BaseHTTPRequestHandler) -> None:
    credentials = base64.b64encode(b"me:s:cret").decode()
    if handler.headers["Authorization"] == f"Basic {credentials}":
        send(image(), "image/png")(handler)
    else:
        handler.send_error(401)


ANSWERS: dict[str, Answer] = {
    "/a.png": send(image(), "image/png"),
    "/snapshot": send(image(), "image/png"),
    "/plain.png": send(image(), "application/octet-stream"),
    "/moved.png": moved,
    "/locked.png": locked,
    "/cut.png": send(image(), "image/png", 10**6),
    "/long.png": send(bytes(10**6 + 1), "image/png"),
    "/late.png": lambda _: time.sleep(1),
    "/camera.png": send(b"", "multipart/x-mixed-replace; boundary=x", 0),
    "/live": send(b"", "video/mp2t", 0),
}


@pytest.fixture(scope="module")
def host() -> Iterator[str]:
    def answer(handler: BaseHTTPRequestHandler) -> None:
        path = handler.path.partition("?")[0]
        ANSWERS.get(path, lambda handler: handler.send_error(404))(handler)

    with serving(answer) as host:
        yield host


@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("a.png", "a.png"),
        ("snapshot?size=2", "snapshot"),
        ("plain.png", "plain.png"),
        ("moved.png", "moved.png"),
    ],
)
def test_the_server_or_a_name_says_what_is_an_image(path: str, name: str, host: str) -> None:
    (item,), sources = find_inputs([f"http://{host}/{path}"])

    assert sources == []
    assert item.row_name == name
    assert torch.equal(item.read(), street_as_png())


def test_detectors_and_streams_take_an_address(host: str) -> None:
    detector, url = load_detector("prior:rows"), f"http://{host}/a.png"

    assert detector(url).mask.shape == (48, 64)
    assert [detection.mask.shape for detection in detect_stream(url, detector)] == [(48, 64)]


@pytest.mark.parametrize("url", ["s3://bucket/a.png", "file:///a.png", "zip://a.png"])
def test_addresses_of_no_server_are_refused(url: str) -> None:
    with pytest.raises(InputError, match=f"{url}: is no web address"):
        read_image(url)
    for find in (find_inputs, find_images):
        with pytest.raises(InputError, match=f"{url}: cannot be read from a URL"):
            find([url])


def test_a_password_is_sent_and_not_printed(host: str) -> None:
    (item,), _ = find_inputs([f"http://me:s%3Acret@{host}/locked.png"])
    assert torch.equal(item.read(), street_as_png())

    with pytest.raises(InputError) as error:
        find_inputs([f"http://me:wrong@{host}/locked.png"])
    assert str(error.value).startswith(f"http://{host}/locked.png: returned 401")


def test_what_does_not_end_is_a_stream(host: str) -> None:
    images, sources = find_inputs([f"http://{host}/{path}" for path in ("camera.png", "live")])

    assert images == []
    assert [source.live for source in sources] == [True, True]


@pytest.mark.parametrize(
    ("url", "error"),
    [
        ("http://{host}/none.png", "returned 404 Not Found"),
        ("http://{host}/cut.png", "cannot be fetched: it is truncated after"),
        ("http://{host}/late.png", "cannot be fetched: 0.2 seconds without a response"),
        ("http://{host}/long.png", "has more than 1,000,000 bytes"),
        ("http://127.0.0.1:9/a.png", "cannot be fetched: "),
    ],
)
def test_server_faults(url: str, error: str, host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(urls, "RESPONSE_TIMEOUT", 0.2)
    monkeypatch.setattr(urls, "MAX_BYTES", 10**6)
    url = url.format(host=host)

    with pytest.raises(InputError) as raised:
        read_image(url)

    assert str(raised.value).startswith(f"{url}: {error}")
    assert "\n" not in str(raised.value)


def street_as_png() -> torch.Tensor:
    return decode_image(image(), "street")
