import sys

import pytest

from roadtorch.installation import codecs


def test_every_format_that_is_read_can_be() -> None:
    *pictures, video = codecs.check_codecs()

    assert [one.state for one in pictures] == ["ok"] * len(codecs.SUFFIXES)
    assert (video.name, video.state) == ("video", "ok")
    assert "reads h264" in video.what


def test_a_format_that_cannot_be_written_or_read_is_broken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fails(_: bytes) -> None:
        raise ValueError("no such codec\nand more")

    monkeypatch.setattr(codecs, "decode", fails)

    first, *_ = codecs.check_codecs()

    assert (first.state, first.what) == ("broken", "no such codec")


def test_pictures_that_come_back_otherwise_are_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    decode = codecs.decode
    monkeypatch.setattr(codecs, "decode", lambda data: 255 - decode(data) // 2)

    assert {one.state for one in codecs.check_codecs()[:-1]} == {"broken"}


def test_without_pyav_video_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr(codecs, "find_spec", lambda _: None)

    video = codecs.check_codecs()[-1]

    assert (video.state, video.remedy) == ("missing", "pip install 'roadtorch[video]'")
