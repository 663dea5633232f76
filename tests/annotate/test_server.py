"""The server: who may ask, how much may be sent, what is told."""

import asyncio
import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import httpx
import numpy as np
import pytest
from starlette.applications import Starlette

from roadtorch.annotate.server import MAX_BODY, STATIC, annotation_app
from roadtorch.annotate.session import Session
from roadtorch.data.event_log import log_path, read_log

TOKEN = "t" * 32

HERE = "http://127.0.0.1:8765"

NAME = "street_0.png"

WHO = f"name={NAME}&user=ann"


@dataclass
class Client:
    """Asks an application without a socket, and without Starlette's client, which wants httpx2."""

    app: Starlette
    headers: Mapping[str, str] = field(default_factory=dict)

    def request(self, method: str, path: str, **values: Any) -> httpx.Response:
        async def asked() -> httpx.Response:
            transport = httpx.ASGITransport(self.app)
            async with httpx.AsyncClient(transport=transport, base_url=HERE) as client:
                headers = {**self.headers, **values.pop("headers", {})}
                return await client.request(method, path, headers=headers, **values)

        return asyncio.run(asked())

    def get(self, path: str, **values: Any) -> httpx.Response:
        return self.request("GET", path, **values)

    def post(self, path: str, **values: Any) -> httpx.Response:
        return self.request("POST", path, **values)


@pytest.fixture
def client(session: Session) -> Client:
    return Client(annotation_app(session, TOKEN, 8765), {"x-token": TOKEN})


def click(identity: str = "a", **changes: object) -> dict[str, object]:
    event = {"kind": "superpixel", "id": identity, "saying": "road", "segments": [0, 1]}
    return {**event, **changes}


def test_a_click_is_kept_and_the_picture_told_anew(client: Client, session: Session) -> None:
    answer = client.post(f"/api/event?{WHO}", json=click())
    told = answer.json()
    assert (answer.status_code, told["version"], told["size"]) == (200, 1, [64, 48])
    layers = np.frombuffer(base64.b64decode(told["layers"]), np.uint8).reshape(48, 64)
    labels = np.frombuffer(client.get(f"/api/superpixels?name={NAME}").content, "<u2")
    assert ((layers & 7 == 1) == (labels.reshape(48, 64) < 2)).all()
    assert ((layers >> 3 & 1)[layers & 7 == 1] == 1).all()
    assert len(read_log(log_path(session.out, NAME, "ann")).events) == 1


@pytest.mark.parametrize("headers", [{}, {"x-token": "foreign"}, {"x-token": TOKEN + "x"}])
@pytest.mark.parametrize("path", ["/", f"/api/state?{WHO}"])
def test_a_foreign_token_is_refused(session: Session, path: str, headers: dict[str, str]) -> None:
    stranger = Client(annotation_app(session, TOKEN, 8765))
    answer = stranger.get(path, headers=headers)
    assert answer.status_code == 403
    assert "token: is missing or wrong (open the address" in answer.json()["error"]


def test_a_foreign_name_for_this_host_is_refused(client: Client) -> None:
    answer = client.get("/api/pictures", headers={"host": "evil.example:8765"})
    assert answer.status_code == 421


def test_every_answer_has_its_policy(client: Client) -> None:
    for path in ("/", "/static/annotate.js", "/api/pictures", "/api/nothing", "/static/x.js"):
        policy = client.get(path).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy


def test_the_page_asks_nobody_else_and_has_no_script_inside(client: Client) -> None:
    page = client.get(f"/?token={TOKEN}").text
    texts = [page, *(client.get(f"/static/{name}").text for name in STATIC)]
    assert not any("http://" in text or "https://" in text for text in texts)
    assert page.count("<script") == page.count('<script type="module" src="/static/')
    assert "style=" not in page


@pytest.mark.parametrize(
    "path", ["/static/../server.py", "/static/%2e%2e%2fserver.py", "/static/x"]
)
def test_no_other_file_is_served(client: Client, path: str) -> None:
    assert client.get(path).status_code == 404


@pytest.mark.parametrize("name", ["../x.png", "%2e%2e%2fx.png", "/etc/passwd", ""])
@pytest.mark.parametrize("call", ["picture", "thumbnail", "superpixels", "state"])
def test_a_path_outside_is_refused(client: Client, call: str, name: str) -> None:
    answer = client.get(f"/api/{call}?name={name}&user=ann")
    assert answer.status_code == 400
    assert "is no picture of this folder" in answer.json()["error"]


def test_a_stroke_that_is_too_long_is_refused_and_nothing_kept(
    client: Client, session: Session
) -> None:
    body = json.dumps(click(segments=[1] * (MAX_BODY // 3 + 1)))
    answer = client.post(f"/api/event?{WHO}", content=body)
    assert answer.status_code == 413
    assert f"more than {MAX_BODY:,} bytes" in answer.json()["error"]
    assert not log_path(session.out, NAME, "ann").exists()


@pytest.mark.parametrize("body", ["", "{", "[]", json.dumps(click(saying="cat"))])
def test_what_is_no_event_is_refused(client: Client, body: str) -> None:
    answer = client.post(f"/api/event?{WHO}", content=body)
    assert answer.status_code == 400
    assert answer.json()["error"].startswith("stroke: is no event of a correction")


def test_a_picture_that_is_gone_is_told(client: Client, session: Session) -> None:
    (session.pictures.root / NAME).unlink()
    answer = client.get(f"/api/state?{WHO}")
    assert answer.status_code == 410
    assert "is no longer there" in answer.json()["error"]


def test_the_list_comes_once_until_it_changes(client: Client) -> None:
    first = client.get("/api/pictures").json()
    assert [one["name"] for one in first["pictures"]] == [f"street_{n}.png" for n in range(3)]
    assert client.get(f"/api/pictures?stamp={first['stamp']}").status_code == 204
    client.post(f"/api/event?{WHO}", json=click())
    second = client.get(f"/api/pictures?stamp={first['stamp']}").json()
    assert second["pictures"][0]["users"]["ann"]["version"] == 1


def test_pictures_and_thumbnails_are_jpeg(client: Client) -> None:
    for call in ("picture", "thumbnail"):
        answer = client.get(f"/api/{call}?name={NAME}")
        assert answer.headers["content-type"] == "image/jpeg"
        assert answer.content[:2] == b"\xff\xd8"
