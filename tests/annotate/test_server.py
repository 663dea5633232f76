"""The server: access control, limits and answers."""

import asyncio
import base64
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np
import pytest
from starlette.applications import Starlette
from starlette.types import Receive, Scope, Send

from roadtorch.annotate.server import MAX_BODY, PAGE_FOLDER, AccessMiddleware, make_app
from roadtorch.annotate.session import Session
from roadtorch.data.corrections import log_path, read_log

TOKEN = "t" * 32
ORIGIN = "http://127.0.0.1:8765"
NAME = "street_0.png"
QUERY = f"name={NAME}"


@dataclass
class Client:
    """A client of an application without a socket; Starlette's own client needs httpx2."""

    app: Starlette
    headers: Mapping[str, str] = field(default_factory=dict)

    def get(self, path: str, method: str = "GET", **values: Any) -> httpx.Response:
        async def request() -> httpx.Response:
            transport = httpx.ASGITransport(self.app)
            async with httpx.AsyncClient(transport=transport, base_url=ORIGIN) as client:
                headers = {**self.headers, **values.pop("headers", {})}
                return await client.request(method, path, headers=headers, **values)

        return asyncio.run(request())

    def post(self, path: str, **values: Any) -> httpx.Response:
        return self.get(path, "POST", **values)


@pytest.fixture
def client(session: Session) -> Client:
    return Client(make_app(session, TOKEN), {"x-token": TOKEN})


def click(identity: str = "a", **changes: object) -> dict[str, object]:
    event = {"kind": "superpixel", "id": identity, "label": "road", "segments": [0, 1]}
    return {**event, **changes}


def test_an_event_of_another_folder_waits(client: Client, session: Session) -> None:
    key = client.get("/api/images").json()["folder"]
    client_code, page = ((PAGE_FOLDER / f"{n}.js").read_text() for n in ("client", "annotate"))

    answers = [client.post(f"/api/event?{QUERY}&folder={k}", json=click()) for k in ("other", key)]

    assert [answer.status_code for answer in answers] == [403, 200]
    assert "event: is of another folder" in answers[0].text
    assert "entry.folder === this.folder" in client_code
    assert "outbox.folder = folder" in page


def test_a_click_is_kept_and_the_image_told_anew(client: Client, session: Session) -> None:
    answer = client.post(f"/api/event?{QUERY}", json=click())
    state = answer.json()
    assert (answer.status_code, state["version"], state["size"]) == (200, 1, [64, 48])
    layers = np.frombuffer(base64.b64decode(state["layers"]), np.uint8).reshape(48, 64)
    labels = np.frombuffer(client.get(f"/api/superpixels?name={NAME}").content, "<u2")
    assert ((layers & 7 == 1) == (labels.reshape(48, 64) < 2)).all()
    assert ((layers >> 3 & 1)[layers & 7 == 1] == 1).all()
    log = read_log(log_path(session.out, NAME))
    assert log is not None
    assert len(log.events) == 1


@pytest.mark.parametrize("headers", [{}, {"x-token": "foreign"}, {"x-token": TOKEN + "x"}])
@pytest.mark.parametrize("path", ["/", f"/api/state?{QUERY}"])
def test_a_foreign_token_is_refused(session: Session, path: str, headers: dict[str, str]) -> None:
    stranger = Client(make_app(session, TOKEN))
    answer = stranger.get(path, headers=headers)
    assert answer.status_code == 403
    assert "token: is missing or wrong (open the address" in answer.json()["error"]


@pytest.mark.parametrize(
    ("header", "value", "status"),
    [
        ("origin", ORIGIN, 200),
        *(
            ("origin", origin, 403)
            for origin in ("http://localhost:8765", "https://evil.example", "null")
        ),
        ("host", "evil.example:8765", 400),
    ],
)
def test_another_page_or_host_is_refused_although_it_knows_the_token(
    client: Client, session: Session, header: str, value: str, status: int
) -> None:
    answer = client.post(f"/api/event?{QUERY}", json=click(), headers={header: value})
    assert answer.status_code == status
    assert log_path(session.out, NAME).exists() == (status == 200)


def test_who_is_cut_off_at_the_end_is_told_to_ask_again() -> None:
    reached = asyncio.Event()

    async def endless(scope: Scope, receive: Receive, send: Send) -> None:
        reached.set()
        await asyncio.sleep(600)

    async def answered() -> httpx.Response:
        transport = httpx.ASGITransport(AccessMiddleware(endless, TOKEN))  # pyright: ignore
        async with httpx.AsyncClient(transport=transport, base_url=ORIGIN) as client:
            request = asyncio.create_task(client.get("/", headers={"x-token": TOKEN}))
            await reached.wait()
            request.cancel()
            return await request

    assert asyncio.run(answered()).status_code == 503


def test_every_answer_has_its_policy(client: Client) -> None:
    for path in ("/", "/static/annotate.js", "/api/images", "/api/nothing", "/static/x.js"):
        policy = client.get(path).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy


def test_the_page_asks_nobody_else_and_has_no_script_inside(client: Client) -> None:
    page = client.get(f"/?token={TOKEN}").text
    texts = [page, *(client.get(f"/static/{file.name}").text for file in PAGE_FOLDER.iterdir())]
    assert not any("http://" in text or "https://" in text for text in texts)
    assert page.count("<script") == page.count('<script type="module" src="/static/')
    assert "style=" not in page


TOO_LONG = json.dumps(click(segments=[1] * (MAX_BODY // 3 + 1)))


@pytest.mark.parametrize(
    ("path", "body", "status", "message"),
    [
        *(
            (f"/static/{name}", None, 404, "Not Found")
            for name in ("../server.py", "%2e%2e%2fserver.py", "x")
        ),
        *(
            (f"/api/{call}?name={name}", None, 400, "is not an image of this folder")
            for call in ("image", "thumbnail", "superpixels", "state")
            for name in ("../x.png", "%2e%2e%2fx.png", "/etc/passwd", "", "street_2.png")
        ),
        (f"/api/event?{QUERY}", TOO_LONG, 413, f"more than {MAX_BODY:,} bytes"),
        *(
            (f"/api/event?{QUERY}", body, 400, "stroke: is not a correction event")
            for body in ("", "{", "[]", json.dumps(click(label="cat")))
        ),
    ],
)
def test_what_is_refused(
    client: Client, session: Session, path: str, body: str | None, status: int, message: str
) -> None:
    assert "street_2.png" in session.images.names()
    (session.images.root / "street_2.png").unlink()
    answer = client.get(path) if body is None else client.post(path, content=body)
    assert answer.status_code == status
    assert re.search(message, answer.text)
    assert not log_path(session.out, NAME).exists()


@pytest.mark.parametrize("call", ["pathlib.Path.mkdir", "roadtorch.data.corrections.os.fsync"])
def test_a_stroke_that_finds_no_room_on_the_disk_may_be_sent_again(
    client: Client, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(call, full)
        assert client.post(f"/api/event?{QUERY}", json=click()).status_code == 507
    assert client.post(f"/api/event?{QUERY}", json=click()).status_code == 200


def test_the_list_comes_once_until_it_changes(client: Client) -> None:
    first = client.get("/api/images").json()
    assert [entry["name"] for entry in first["images"]] == [f"street_{n}.png" for n in range(3)]
    assert client.get(f"/api/images?stamp={first['stamp']}").status_code == 204
    client.post(f"/api/event?{QUERY}", json=click())
    second = client.get(f"/api/images?stamp={first['stamp']}").json()
    assert second["images"][0]["version"] == 1


def test_images_and_thumbnails_are_jpeg(client: Client) -> None:
    for call in ("image", "thumbnail"):
        answer = client.get(f"/api/{call}?name={NAME}")
        assert answer.headers["content-type"] == "image/jpeg"
        assert answer.content[:2] == b"\xff\xd8"
