"""A session without its server: views, logs and restarts."""

import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from roadtorch.annotate.report import corrections_report
from roadtorch.annotate.server import Address, bind_socket, read_address, write_address
from roadtorch.annotate.session import Session, compute_views, open_session
from roadtorch.base.errors import DatasetError, InputError
from roadtorch.data.corrections import read_corrections
from roadtorch.data.events import Confirm, Redo, SuperpixelStroke, Undo, road_layer
from roadtorch.detectors.catalogue import load_detector
from roadtorch.testing.scenes import write_image
from tests.streets import scene

NAME = "street_0.png"


def superpixel(identity: str, label: str, *segments: int) -> SuperpixelStroke:
    return SuperpixelStroke.model_validate(
        {"kind": "superpixel", "id": identity, "label": label, "segments": segments}
    )


def reopen(session: Session) -> Session:
    return open_session(session.images.root, session.out, load_detector("prior:triangle"))


def test_a_stroke_is_on_disk_and_a_restart_finds_it(session: Session) -> None:
    state = session.add(NAME, superpixel("a", "road", 0, 1))
    again = reopen(session).state(NAME)
    assert again["layers"] == state["layers"]
    assert again["version"] == 1
    (correction,) = read_corrections(session.out)
    view = session.view(NAME)
    assert (road_layer(correction.labels) == 1).sum() == int((view.labels < 2).sum())


def test_undo_and_redo_are_told(session: Session) -> None:
    layers = session.state(NAME)["layers"]
    first = session.add(NAME, superpixel("a", "road", 0))
    assert session.add(NAME, superpixel("a", "road", 0))["version"] == 1  # sent again
    undone = session.add(NAME, Undo(kind="undo", id="b", of="a"))
    assert undone["layers"] == layers
    assert undone["redo"] == ["a"]
    assert undone["events"] == []
    again = session.add(NAME, Redo(kind="redo", id="c", of="a"))
    assert again["layers"] == first["layers"]
    assert again["redo"] == []
    assert again["clicks"] == 1


def test_right_as_it_is_keeps_what_was_shown(session: Session) -> None:
    layers = session.state(NAME)["layers"]
    state = session.add(NAME, Confirm(kind="confirm", id="a"))
    assert state["confirmed"]
    (correction,) = read_corrections(session.out)
    assert correction.confirmed
    assert set(np.unique(road_layer(correction.labels))) <= {0, 1}
    road = np.frombuffer(layers, np.uint8).reshape(48, 64) >> 3 & 1
    assert (road_layer(correction.labels) == road).all()


OTHER_SPELLINGS = ("nosuch/../{}", "./{}", "../streets/{}", "/{}", "{}/", "a\0{}")


@pytest.mark.parametrize(
    "name", [*(text.format(NAME) for text in OTHER_SPELLINGS), "link.png"]
)  # the link leads outside
def test_names_that_are_none_begin_no_log(session: Session, tmp_path: Path, name: str) -> None:
    shutil.copy(session.images.root / NAME, tmp_path / "secret.png")
    (session.images.root / "link.png").symlink_to(tmp_path / "secret.png")
    with pytest.raises(InputError, match="is not an image of this folder"):
        session.add(name, superpixel("a", "road", 0))
    assert "link.png" not in session.images.names()
    assert not list(tmp_path.rglob("*.jsonl"))


@pytest.mark.parametrize("torn", [b"", b'{"roadtorch": 1, "pict'])
def test_a_log_without_a_first_line_stops_nobody(session: Session, torn: bytes) -> None:
    (session.out / f"{NAME}.strokes.jsonl").write_bytes(torn)
    again = reopen(session)
    assert again.listing()[0]["version"] == 0
    assert again.add(NAME, superpixel("a", "road", 0))["version"] == 1
    assert reopen(session).state(NAME)["version"] == 1


def test_a_image_that_changed_its_size_keeps_its_corrections(session: Session) -> None:
    session.add(NAME, superpixel("a", "road", 0))
    write_image(session.images.root / NAME, scene(1, 40, 64))
    with pytest.raises(InputError, match="was corrected at 64 by 48 pixels"):
        reopen(session).add(NAME, superpixel("b", "road", 1))


def test_an_image_that_was_replaced_is_told_on_the_page_and_in_training(session: Session) -> None:
    session.add("street_0.png", superpixel("a", "road", 1))
    session.images.path("street_0.png").write_bytes(
        session.images.path("street_1.png").read_bytes()
    )

    for opened in (session, reopen(session)):
        with pytest.raises(InputError, match=r"street_0\.png: is not the image that was corrected"):
            opened.state("street_0.png")
    with pytest.warns(UserWarning, match=r"street_0\.png: is not the image that was corrected"):
        read_corrections(session.out)


def test_a_full_disk_or_a_wrong_superpixel_leaves_nothing_half_done(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.add(NAME, superpixel("a", "road", 0))
    layers = session.state(NAME)["layers"]
    log = session.out / f"{NAME}.strokes.jsonl"
    lines = log.read_bytes()

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match="a higher number was clicked"):
        session.add(NAME, superpixel("a", "road", 10_000))
    monkeypatch.setattr("roadtorch.data.corrections.os.fsync", full)
    with pytest.raises(InputError, match="cannot be written: No space left"):
        session.add(NAME, superpixel("b", "road", 1))
    assert session.state(NAME)["layers"] == layers
    assert log.read_bytes() == lines


def test_many_at_once_lose_nothing(session: Session) -> None:
    def strokes(start: int) -> None:
        for number in range(start, start + 5):
            session.add(NAME, superpixel(f"s{number}", "road", number % 5))

    with ThreadPoolExecutor(4) as workers:
        list(workers.map(strokes, range(0, 20, 5)))
    assert reopen(session).state(NAME)["version"] == 20


def test_the_background_looks_at_all_and_at_new_ones(session: Session) -> None:
    (session.images.root / "broken.png").write_bytes(b"no image")
    stop = threading.Event()
    thread = threading.Thread(target=compute_views, args=(session, stop))
    thread.start()
    for _ in range(6000):
        if len(session.trusts) == 3:
            break
        stop.wait(0.05)
    stop.set()
    thread.join()
    assert sorted(session.trusts) == ["street_0.png", "street_1.png", "street_2.png"]
    assert all((session.out / ".views" / f"{name}.npz").is_file() for name in session.trusts)


def test_a_folder_that_changes_is_seen(session: Session) -> None:
    names = session.images.names()
    session.images.out = session.images.root / "corrections"
    session.images.out.mkdir()
    for candidate in ("zz.png", "corrections/a.png"):
        shutil.copy(session.images.root / NAME, session.images.root / candidate)
    session.images._listed -= 10
    assert session.images.names() == (*names, "zz.png")


def test_a_broken_log_is_told_before_the_page_opens(session: Session) -> None:
    session.add(NAME, superpixel("a", "road", 0))
    with (session.out / f"{NAME}.strokes.jsonl").open("a") as file:
        file.write("nonsense\n")
    with pytest.raises(DatasetError, match=r"jsonl:3: is not a correction event"):
        reopen(session)


# --- report -----------------------------------------------------------------------------


def test_the_report_says_what_the_time_bought(session: Session) -> None:
    stroke = superpixel("a", "road", 0).model_copy(update={"seconds": 30.0})
    session.add(NAME, stroke)
    session.add(NAME, Confirm(kind="confirm", id="b", seconds=30.0))
    lines = corrections_report(session.out).splitlines()
    assert lines[1].split()[:3] == [NAME, "1", "60"]
    assert "1 image, 1 confirmed; 1 click, 1.0 minutes" in lines[3]
    assert "mean F" in lines[5]
    assert len(lines) == 6


def test_the_least_trusted_images_come_first_and_confirmed_ones_last(session: Session) -> None:
    session.trusts |= {"street_0.png": 0.9, "street_1.png": 0.2}  # that of the third is unknown
    session.add("street_1.png", Confirm(kind="confirm", id="a"))
    names = [entry["name"] for entry in session.listing()]
    assert names == ["street_0.png", "street_2.png", "street_1.png"]


# --- addresses --------------------------------------------------------------------------


def test_the_address_is_found_again_and_is_the_owners_alone(tmp_path: Path) -> None:
    assert read_address(tmp_path) is None
    address = Address(port=8765, token="t" * 30)
    write_address(tmp_path, address)
    assert read_address(tmp_path) == address
    assert (tmp_path / ".session.json").stat().st_mode & 0o077 == 0
    (tmp_path / ".session.json").write_text("{")
    assert read_address(tmp_path) is None


def test_a_port_that_is_taken_is_passed_over() -> None:
    with bind_socket() as first, bind_socket(first.getsockname()[1]) as second:
        assert second.getsockname()[1] != first.getsockname()[1]
        assert second.getsockname()[0] == "127.0.0.1"
