"""Every result has one owner, whatever the source; a write that fails costs one picture."""

import warnings
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.command import ROWS, Call, files_in, rows_of, save_picture
from tests.videos import write_video


def write_inputs(root: Path, names: Sequence[str]) -> list[Path]:
    """Pictures, videos, and the members of archives: ``a.zip!drive/1.png``; what to give."""
    loose, given = root / "loose", {}
    loose.mkdir(parents=True)
    for seed, name in enumerate(names):
        archive, _, member = name.rpartition("!")
        if member.endswith((".mp4", ".avi")):
            write_video(loose / member)
        else:
            picture = save_picture((root / "packed" if archive else loose) / member, seed)
        if archive:
            with zipfile.ZipFile(root / archive, "a") as packed:
                packed.write(picture, member)
        given[root / archive if archive else loose] = None
    return list(given)


@pytest.mark.parametrize(
    ("names", "done"),
    [
        (["a.zip!drive/1.png", "a.zip!drive/1.jpg", "a.zip!drive/1.bmp", "a.zip!2.png"], 2),
        (["in/1.png", "a.zip!in/1.png", "a.zip!2.png"], 2),
        (["drive.mp4", "a.zip!drive/000003.png", "a.zip!2.png"], 13),
        (["a.zip!run.png", "a.zip!1.png"], 1),
        (["a.zip!1.png", "a.zip!1.labelme.png"], 1),
    ],
)
def test_who_comes_second_is_refused_by_name_and_replaces_nothing(
    names: list[str], done: int, call: Call, tmp_path: Path, out: Path
) -> None:
    given = write_inputs(tmp_path / "in", names)
    run = ("infer", *given, *ROWS, "--out", out, "--save", "mask,json,polygons")

    result, again = call(*run), call(*run)

    assert result.exit_code == again.exit_code == 1
    rows = rows_of(out)
    frames = [row for name, row in rows.items() if Path(name).suffix not in (".zip", ".mp4")]
    written = {name for name in files_in(out) if name.endswith(".mask.png")}
    assert len(written) == sum(row["status"] == "done" for row in frames) == done
    refused = [row["status"] for row in frames if row["status"] != "done"]
    assert len(refused) + done == len(frames) > done
    assert all("both would write" in status for status in refused)


def test_a_member_that_is_refused_owns_no_name_and_equal_names_are_told(
    call: Call, tmp_path: Path, out: Path
) -> None:
    data = save_picture(tmp_path / "x.png", 0).read_bytes()
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of zipfile, about the second c.png
        for name in ("a:b.png", "a_b.png", "c.png", "c.png"):
            archive.writestr(name, data)

    call("infer", tmp_path / "a.zip", *ROWS, "--out", out)

    statuses = {name: row["status"] for name, row in rows_of(out).items()}
    assert (statuses["a_b"], statuses["c"]) == ("done", "done")
    assert "has a name outside the archive" in statuses["a.zip!a_b"]
    assert "both would write" in statuses["a.zip!c.png"]


def test_pictures_beside_a_video_of_their_name_keep_their_rows(
    call: Call, tmp_path: Path, out: Path
) -> None:
    given = write_inputs(tmp_path, ["drive.mp4", "drive/000003.png", "drive/x.png"])

    result = call("infer", *given, *ROWS, "--out", out)

    assert result.exit_code == 0, result.stderr
    assert {"drive/000003.png", "drive/x.png"} < set(rows_of(out))


def test_a_name_that_is_too_long_costs_its_own_member(
    call: Call, tmp_path: Path, out: Path
) -> None:
    names = [*(f"a.zip!{number}.png" for number in range(4)), f"a.zip!1{'n' * 245}.png"]
    given = write_inputs(tmp_path, names)

    result = call("infer", *given, *ROWS, "--out", out)

    assert result.exit_code == 1
    rows = rows_of(out)
    assert [name[:2] for name, row in rows.items() if row["status"].startswith("failed")] == ["1n"]
    assert sum(row["status"] == "done" for row in rows.values()) == 4
    assert rows["a.zip"]["status"].startswith(f"partial: {given[0]}: 4 of 5 frames (")
    assert result.stderr.endswith(f"roadtorch: 0 done, 1 partial; results in {out}\n")
