"""URLs: images are fetched, streams are not."""

import base64
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from threading import Event

import cv2
import pytest
import torch

from roadtorch import detect_stream, load_detector
from roadtorch.base import urls
from roadtorch.base.bounded import strip_password
from roadtorch.base.errors import InputError
from roadtorch.base.image import decode_image, read_image, to_pixels
from roadtorch.inputs.find import find_inputs
from roadtorch.inputs.images import find_images
from roadtorch.testing import street
from tests.command import ROWS, Call, save_image
from tests.servers import Answer, send, serving


def png_bytes(image: torch.Tensor) -> bytes:
    return cv2.imencode(".png", to_pixels(image)[..., ::-1])[1].tobytes()


def image() -> bytes:
    return png_bytes(street(48, 64, 1))


def locked(handler: BaseHTTPRequestHandler) -> None:
    credentials = base64.b64encode(b"me:s:cret").decode()
    if handler.headers["Authorization"] == f"Basic {credentials}":
        send(image(), "image/png")(handler)
    else:
        handler.send_error(401)


def echo_credentials(handler: BaseHTTPRequestHandler) -> None:
    """Send an image 7 pixels wide to a request with credentials, else one 5 wide."""
    width = 7 if "Authorization" in handler.headers else 5
    send(png_bytes(street(16, width, 1)), "image/png")(handler)


def redirect(handler: BaseHTTPRequestHandler) -> None:
    handler.send_response(302)
    handler.send_header("Location", handler.path.partition("?")[2])
    handler.end_headers()


def packed(handler: BaseHTTPRequestHandler) -> None:
    handler.send_response(200)
    handler.send_header("Content-Type", "image/png")
    handler.send_header("Content-Encoding", "br")
    handler.end_headers()


ended = Event()

ANSWERS: dict[str, Answer] = {
    "/who.png": echo_credentials,
    "/redirect.png": redirect,
    "/octets": send(image(), "application/octet-stream"),
    "/Stra%C3%9Fe%20a.png": send(image(), "image/png"),
    "/brotli.png": packed,
    "/a.png": send(image(), "image/png"),
    "/snapshot": send(image(), "image/png"),
    "/locked.png": locked,
    "/cut.png": send(image(), "image/png", 10**6),
    "/long.png": send(bytes(10**6 + 1), "image/png"),
    "/late.png": lambda _: ended.wait(60),
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
        ("redirect.png?/a.png", "redirect.png"),
        ("octets", "octets"),
        ("Straße a.png", "Straße-a.png"),
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


@pytest.mark.parametrize(
    ("target", "width"),
    [("/who.png", 7), ("http://{host}/who.png", 7), ("http://{elsewhere}/who.png", 5)],
)
def test_no_other_origin_gets_the_password(target: str, width: int, host: str) -> None:
    with serving(echo_credentials) as elsewhere:
        target = target.format(host=host, elsewhere=elsewhere)
        image = read_image(f"http://me:p@ssword@{host}/redirect.png?{target}")

    assert image.shape[2] == width


@pytest.mark.parametrize(
    "url",
    [
        "rtsp://me:hu5h@127.0.0.1:9/live",
        "rtsp://me:pass@hu5h@127.0.0.1:9/live",
        "rtsp://me:pass/hu5h@127.0.0.1:9/live",
        "rtsp://127.0.0.1:9/user=me_password=hu5h_channel=1.sdp",
        "http://me:pass@hu5h@127.0.0.1:9/drive.mp4?token=hu5.h",
        "http://127.0.0.1:9/a.png?password=hu5h",
    ],
)
def test_secrets_of_an_address_are_in_no_file_and_no_message(
    url: str, tmp_path: Path, call: Call
) -> None:
    save_image(tmp_path / "a.png")

    result = call("infer", tmp_path / "a.png", url, *ROWS, "--out", tmp_path / "out")

    files = [file for file in (tmp_path / "out").rglob("*") if file.is_file()]
    texts = [str(file) + file.read_bytes().decode(errors="replace") for file in files]
    assert result.exit_code
    assert not [text for text in [result.output, *texts] if "hu5" in text]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("http://host:80/me@home.jpg", "http://host:80/me@home.jpg"),
        ("http://[::1]:80/a@b", "http://[::1]:80/a@b"),
        ("http://me:p@ss/word@h/a", "http://h/a"),
        ("/data/user=5/a@b.jpg", "/data/user=5/a@b.jpg"),
        ("http://h/a?id=3&sig=x%2Fy&z=1#t", "http://h/a?id=3&sig=***&z=1#t"),
        ("cannot open 'http://a:b@h' (refused)", "cannot open 'http://h' (refused)"),
    ],
)
def test_only_secrets_leave_a_text(text: str, expected: str) -> None:
    assert strip_password(text) == expected


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("http://h/a%20b?x=[1]&y=~", "http://h/a%20b?x=[1]&y=~"),
        ("http://münchen.de:81/ü ö", "http://xn--mnchen-3ya.de:81/%C3%BC%20%C3%B6"),
        ("rtsp://me:a/b@c@h/x", "rtsp://me:a%2Fb%40c@h/x"),
    ],
)
def test_addresses_as_servers_want_them(url: str, expected: str) -> None:
    assert urls.encode_url(url) == expected


def test_what_does_not_end_is_a_stream(host: str) -> None:
    images, sources = find_inputs([f"http://{host}/{path}" for path in ("camera.png", "live")])

    assert images == []
    assert [source.live for source in sources] == [True, True]


@pytest.mark.parametrize(
    ("url", "error"),
    [
        ("http://{host}/none.png", "returned 404 Not Found"),
        ("http://{host}/cut.png", "cannot be fetched: it is truncated after"),
        ("http://{host}/brotli.png", "cannot be fetched: it is packed by br"),
        ("http://{host}/late.png", "cannot be fetched: 0.2 seconds without a response"),
        ("http://{host}/long.png", "has more than 1,000,000 bytes"),
        ("http://127.0.0.1:9/a.png", "cannot be fetched: "),
    ],
)
def test_server_faults(url: str, error: str, host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(urls, "RESPONSE_TIMEOUT", 0.2 if "late" in url else 60)
    monkeypatch.setattr(urls, "MAX_BYTES", 10**6)
    ended.clear()
    url = url.format(host=host)

    with pytest.raises(InputError) as raised:
        read_image(url)
    ended.set()

    assert str(raised.value).startswith(f"{url}: {error}")
    assert "\n" not in str(raised.value)


def street_as_png() -> torch.Tensor:
    return decode_image(image(), "street")
