"""The page that shows footage: the newest frame, its headers, and the end."""

import io
import json
import urllib.error
import urllib.request
from email.message import Message
from pathlib import Path
from threading import Timer

import numpy as np
import torch
from PIL import Image

from roadtorch import Detection
from roadtorch.annotate.viewer import Viewer
from roadtorch.inputs.item import Item
from tests.command import Call
from tests.videos import write_video


def frame(number: int) -> Item:
    return Item(f"{number}", "drive", lambda: torch.zeros(3, 24, 32), number=number)


def detection(grey: float) -> Detection:
    mask = torch.zeros(24, 32, dtype=torch.bool)
    return Detection(mask.float(), mask, {}, 0.75, image=torch.full((3, 24, 32), grey))


def request_frame(
    viewer: Viewer, after: str = "", token: str | None = None
) -> tuple[int, Message, bytes]:
    """Return the status, headers and body of the next frame."""
    url = f"http://127.0.0.1:{viewer.address.port}/api/frame?after={after}"
    headers = {"X-Token": viewer.address.token if token is None else token}
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as refused:
        with refused:
            return refused.code, refused.headers, refused.read()


def test_the_newest_frame_is_shown_with_its_trust_and_those_between_are_left_out() -> None:
    with Viewer() as viewer:
        for number in range(3):
            viewer.write(frame(number), detection(number / 4))

        status, headers, body = request_frame(viewer)

    assert status == 200
    assert (headers["X-Frame"], headers["X-Trust"]) == ("2", "0.75")
    assert float(headers["X-Rate"]) > 0
    assert abs(np.asarray(Image.open(io.BytesIO(body)))[12, :2].astype(int) - 128).max() < 8


def test_who_has_the_newest_waits_for_the_next_and_is_told_of_the_end() -> None:
    with Viewer() as viewer:
        viewer.write(frame(0), detection(0))
        first = request_frame(viewer)[1]["X-Number"]
        Timer(0.2, lambda: viewer.write(frame(1), detection(0))).start()
        second = request_frame(viewer, first)[1]
        ending = Timer(1, viewer.__exit__)  # when the request has been sent
        ending.start()

        status, *_ = request_frame(viewer, second["X-Number"])
        ending.join()

    assert second["X-Frame"] == "1"
    assert status == 410


def test_a_stranger_sees_nothing() -> None:
    with Viewer() as viewer:
        viewer.write(frame(0), detection(0))

        status, _, body = request_frame(viewer, token="")

    assert status == 403
    assert "token: is missing or wrong" in json.loads(body)["error"]


def test_infer_prints_the_address_and_ends_as_ever(call: Call, tmp_path: Path) -> None:
    drive, out = write_video(tmp_path / "drive.mp4"), tmp_path / "roads"

    ended = call("infer", drive, "--view", "--detector", "prior:rows", "--out", out)

    assert ended.exit_code == 0, ended.stderr
    assert ended.stdout.startswith("Open http://127.0.0.1:")
    assert (out / "drive.overlay.mp4").exists()
