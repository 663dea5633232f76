"""Corrections: the labels that events result in, and logs that survive a crash."""

from pathlib import Path

import numpy as np
import pytest

from roadtorch.base.errors import InputError
from roadtorch.data.corrections import EventLog, LogHead, log_path, read_corrections, read_log
from roadtorch.data.events import (
    LABELS,
    SAYINGS,
    AnyEvent,
    BrushStroke,
    Confirm,
    PolygonStroke,
    Redo,
    Undo,
    layout_layer,
    mask_of,
    parse_event,
    relabel,
    replay,
    road_layer,
    runs_of,
    stroke_mask,
)

SIZE = (20, 30)


def box(identity: str, saying: str, left: int, top: int, right: int, bottom: int) -> PolygonStroke:
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    points = tuple((float(x), float(y)) for x, y in corners)
    return PolygonStroke.model_validate(
        {"kind": "polygon", "id": identity, "saying": saying, "points": points}
    )


def log(folder: Path, image: str, *events: AnyEvent) -> Path:
    path = log_path(folder, image)
    head = LogHead(image=f"../{image}", height=SIZE[0], width=SIZE[1])
    for event in events:
        EventLog(path, head).add(event)
    return path


# --- labels -----------------------------------------------------------------------------


@pytest.mark.parametrize("saying", SAYINGS)
@pytest.mark.parametrize("before", range(len(LABELS)))
def test_a_saying_holds_whatever_was_there(saying: str, before: int) -> None:
    after = relabel(np.array([before], np.uint8), saying)
    road, layout = int(road_layer(after)[0]), int(layout_layer(after)[0])
    expected = {
        "road": (1, 2),
        "not_road": (0, layout),
        "void": (254, 255),
        "sky": (0, 0),
        "vertical": (0, 1),
        "horizontal": (road, 2),
    }
    assert (road, layout) == expected[saying]
    if saying == "horizontal":  # it takes back no verdict on a road, only what sky or wall implied
        kept = int(road_layer(np.array([before], np.uint8))[0])
        assert road == (kept if LABELS[before] in ("road", "not_road") or before == 7 else 255)


# --- events -------------------------------------------------------------------------------


def test_runs_are_the_mask() -> None:
    mask = np.random.default_rng(0).random(SIZE) > 0.5
    assert (mask_of(runs_of(mask), SIZE) == mask).all()
    assert runs_of(np.zeros(SIZE, np.bool_)) == ()


@pytest.mark.parametrize(
    "runs", [(1,), (599, 2), (0, 601), (10**9, 1), (0, 2, 1, 2), (2**31, 2**31)]
)
def test_runs_of_another_image_are_refused(runs: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="runs"):
        mask_of(runs, SIZE)


def test_a_brush_is_round_and_stays_in_the_image() -> None:
    stroke = BrushStroke(kind="brush", id="b", saying="road", points=((0.0, 0.0),), radius=3.0)
    mask = stroke_mask(stroke, SIZE)
    assert (mask[0, 3], mask[3, 0], mask[3, 3]) == (True, True, False)
    assert not mask[:, 6:].any()
    far = {"points": ((-1e5, 1e5), (1e5, -1e5)), "radius": 2000.0}
    assert stroke_mask(stroke.model_copy(update=far), SIZE).all()  # and costs no memory


def test_undo_and_redo_are_events_of_their_own_and_each_counts_once() -> None:
    first, second = box("a", "road", 0, 0, 9, 9), box("b", "not_road", 5, 0, 9, 9)
    both = replay([first, second], SIZE)
    assert both[0, 4] == LABELS.index("road")
    assert both[0, 5] == LABELS.index("not_road")
    assert (replay([first, second, first], SIZE) == both).all()  # sent twice
    undone = [first, second, Undo(kind="undo", id="c", of="b")]
    assert (replay(undone, SIZE) == replay([first], SIZE)).all()
    assert (replay([*undone, Redo(kind="redo", id="d", of="b")], SIZE) == both).all()


def test_right_as_it_is_settles_what_is_open() -> None:
    road = np.zeros(SIZE, np.bool_)
    road[10:] = True
    events = [
        box("a", "void", 0, 0, 3, 3),
        box("b", "not_road", 0, 15, 3, 19),
        box("c", "horizontal", 20, 8, 25, 12),
        Confirm(kind="right", id="d", runs=runs_of(road)),
    ]
    labels = replay(events, SIZE)
    assert (road_layer(labels) != 255).all()
    rows, columns = [0, 19, 19, 8, 12], [0, 0, 10, 22, 22]
    expected = ["void", "not_road", "road", "not_road_horizontal", "road"]
    assert [LABELS[label] for label in labels[rows, columns]] == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        '{"kind":"brush","id":"a","saying":"rode","points":[[1,2]],"radius":1}',
        '{"kind":"brush","id":"a/../b","saying":"road","points":[[1,2]],"radius":1}',
        '{"kind":"polygon","id":"a","saying":"road","points":[[1,2],[NaN,3],[4,5]]}',
        '{"kind":"undo","id":"a","of":"b","extra":1}',
        f'{{"kind":"right","id":"a","runs":[{2**70},1]}}',
        '{"kind":"brought","id":"a","labels":{"cat":[0,1]}}',
    ],
)
def test_what_is_no_event_is_refused_in_a_line(text: str) -> None:
    with pytest.raises(InputError, match=r"^stroke: is no event") as caught:
        parse_event(text, "stroke")
    assert "\n" not in str(caught.value)


# --- logs -------------------------------------------------------------------------------


def ids(path: Path) -> list[str]:
    found = read_log(path)
    assert found is not None
    return [event.id for event in found.events]


@pytest.mark.parametrize("torn", [b'{"kind":"pol', b""])
def test_half_a_line_of_a_crash_is_passed_over_and_cut_off(tmp_path: Path, torn: bytes) -> None:
    path = log(tmp_path, "a.jpg", box("a", "road", 0, 0, 9, 9))
    with path.open("ab") as file:
        file.write(torn)
    assert ids(path) == ["a"]
    log(tmp_path, "a.jpg", box("b", "void", 0, 0, 2, 2))
    assert ids(path) == ["a", "b"]


# --- corrections ------------------------------------------------------------------------


def test_corrections_say_what_training_needs(tmp_path: Path) -> None:
    stroke = box("a", "road", 0, 10, 29, 19).model_copy(update={"seconds": 4.0})
    log(tmp_path / "corrections", "sub/a.jpg", stroke, box("b", "sky", 0, 0, 29, 4))
    (correction,) = read_corrections(tmp_path / "corrections")
    assert (correction.name, correction.image) == ("sub/a.jpg", tmp_path / "sub/a.jpg")
    assert (correction.seconds, correction.clicks, correction.confirmed) == (4.0, 2, False)
    assert correction.road.dtype == correction.layout.dtype == np.uint8
    assert correction.road[[15, 2, 7], 0].tolist() == [1, 0, 255]
    assert correction.layout[[15, 2, 7], 0].tolist() == [2, 0, 255]
    assert correction.says_road[[15, 2, 7], 0].tolist() == [True, True, False]
    (moved,) = read_corrections(tmp_path / "corrections", tmp_path / "elsewhere")
    assert moved.image == tmp_path / "elsewhere/sub/a.jpg"


def test_a_image_on_which_all_was_taken_back_is_left_out(tmp_path: Path) -> None:
    log(tmp_path, "a.jpg", box("a", "road", 0, 0, 9, 9), Undo(kind="undo", id="b", of="a"))
    assert read_corrections(tmp_path) == []
