"""Corrections: the labels that events result in, and logs that survive a crash."""

from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.errors import InputError
from roadtorch.data.corrections import EventLog, LogHeader, log_path, read_corrections, read_log
from roadtorch.data.events import (
    LABEL_NAMES,
    AnyEvent,
    BrushStroke,
    Confirm,
    PolygonStroke,
    Redo,
    Undo,
    layout_layer,
    relabel,
    replay,
    road_layer,
    stroke_mask,
)
from roadtorch.data.polygons import decode_counts, encode_counts

SIZE = (20, 30)


def box(event_id: str, label: str, x1: int, y1: int, x2: int, y2: int) -> PolygonStroke:
    corners = ((x1, y1), (x2, y1), (x2, y2), (x1, y2))
    points = tuple((float(x), float(y)) for x, y in corners)
    return PolygonStroke.model_validate(
        {"kind": "polygon", "id": event_id, "label": label, "points": points}
    )


def log(folder: Path, image: str, *events: AnyEvent) -> Path:
    path = log_path(folder, image)
    head = LogHeader(image=f"../{image}", height=SIZE[0], width=SIZE[1])
    for event in events:
        EventLog(path, head).add(event)
    return path


# --- labels -----------------------------------------------------------------------------


@pytest.mark.parametrize("label", LABEL_NAMES[1:7])
@pytest.mark.parametrize("previous", range(len(LABEL_NAMES)))
def test_a_label_holds_whatever_it_replaces(label: str, previous: int) -> None:
    labels = relabel(np.array([previous], np.uint8), label)
    road, layout = int(road_layer(labels)[0]), int(layout_layer(labels)[0])
    expected = {
        "road": (1, 2),
        "not_road": (0, layout),
        "void": (254, 255),
        "sky": (0, 0),
        "vertical": (0, 1),
        "horizontal": (road, 2),
    }
    assert (road, layout) == expected[label]
    if label == "horizontal":  # it keeps road and not road, but not what sky and wall imply
        previous_road = int(road_layer(np.array([previous], np.uint8))[0])
        keeps = LABEL_NAMES[previous] in ("road", "not_road") or previous == 7
        assert road == (previous_road if keeps else 255)


# --- events -------------------------------------------------------------------------------


@pytest.mark.parametrize("threshold", [-1, 0.5, 2])
def test_counts_are_the_mask(threshold: float) -> None:
    mask = np.random.default_rng(0).random(SIZE) > threshold
    assert (decode_counts(encode_counts(mask), SIZE) == mask).all()


@pytest.mark.parametrize("counts", [(), (1,), (599, 2), (0, 601), (10**9, 1), (2**31, 2**31)])
def test_counts_of_another_image_are_refused(counts: tuple[int, ...]) -> None:
    event = Confirm.model_construct(kind="confirm", id="a", counts=counts)
    with pytest.raises(InputError, match="are counted, not 30 by 20"):
        replay([event], SIZE)


def test_a_brush_is_round_and_stays_in_the_image() -> None:
    stroke = BrushStroke(kind="brush", id="b", label="road", points=((0.0, 0.0),), radius=3.0)
    mask = stroke_mask(stroke, SIZE)
    assert (mask[0, 3], mask[3, 0], mask[3, 3]) == (True, True, False)
    assert not mask[:, 6:].any()
    far = {"points": ((-1e5, 1e5), (1e5, -1e5)), "radius": 2000.0}
    assert stroke_mask(stroke.model_copy(update=far), SIZE).all()  # and costs no memory


def test_undo_and_redo_are_events_of_their_own_and_each_counts_once() -> None:
    first, second = box("a", "road", 0, 0, 9, 9), box("b", "not_road", 5, 0, 9, 9)
    labels = replay([first, second], SIZE)
    assert labels[0, 4] == LABEL_NAMES.index("road")
    assert labels[0, 5] == LABEL_NAMES.index("not_road")
    assert (replay([first, second, first], SIZE) == labels).all()  # sent twice
    undone = [first, second, Undo(kind="undo", id="c", of="b")]
    assert (replay(undone, SIZE) == replay([first], SIZE)).all()
    assert (replay([*undone, Redo(kind="redo", id="d", of="b")], SIZE) == labels).all()


def test_confirming_labels_the_remaining_pixels() -> None:
    road = np.zeros(SIZE, np.bool_)
    road[10:] = True
    events = [
        box("a", "void", 0, 0, 3, 3),
        box("b", "not_road", 0, 15, 3, 19),
        box("c", "horizontal", 20, 8, 25, 12),
        Confirm(kind="confirm", id="d", counts=encode_counts(road)),
    ]
    labels = replay(events, SIZE)
    assert (road_layer(labels) != 255).all()
    rows, columns = [0, 19, 19, 8, 12], [0, 0, 10, 22, 22]
    expected = ["void", "not_road", "road", "not_road_horizontal", "road"]
    assert [LABEL_NAMES[label] for label in labels[rows, columns]] == expected


# --- logs -------------------------------------------------------------------------------


def ids(path: Path) -> list[str]:
    event_log = read_log(path)
    assert event_log is not None
    return [event.id for event in event_log.events]


@pytest.mark.parametrize("torn", [b'{"kind":"pol', b""])
def test_half_a_line_of_a_crash_is_passed_over_and_cut_off(tmp_path: Path, torn: bytes) -> None:
    path = log(tmp_path, "a.jpg", box("a", "road", 0, 0, 9, 9))
    with path.open("ab") as file:
        file.write(torn)
    assert ids(path) == ["a"]
    log(tmp_path, "a.jpg", box("b", "void", 0, 0, 2, 2))
    assert ids(path) == ["a", "b"]


# --- corrections ------------------------------------------------------------------------


def test_corrections_have_what_training_needs(tmp_path: Path) -> None:
    stroke = box("a", "road", 0, 10, 29, 19).model_copy(update={"seconds": 4.0})
    log(tmp_path / "corrections", "sub/a.jpg", stroke, box("b", "sky", 0, 0, 29, 4))
    (correction,) = read_corrections(tmp_path / "corrections")
    assert (correction.name, correction.image) == ("sub/a.jpg", tmp_path / "sub/a.jpg")
    assert (correction.seconds, correction.clicks, correction.confirmed) == (4.0, 2, False)
    road, layout = road_layer(correction.labels), layout_layer(correction.labels)
    assert road.dtype == layout.dtype == np.uint8
    assert road[[15, 2, 7], 0].tolist() == [1, 0, 255]
    assert layout[[15, 2, 7], 0].tolist() == [2, 0, 255]
    (moved,) = read_corrections(tmp_path / "corrections", tmp_path / "elsewhere")
    assert moved.image == tmp_path / "elsewhere/sub/a.jpg"


def test_an_image_without_effective_events_is_left_out(tmp_path: Path) -> None:
    log(tmp_path, "a.jpg", box("a", "road", 0, 0, 9, 9), Undo(kind="undo", id="b", of="a"))
    assert read_corrections(tmp_path) == []
