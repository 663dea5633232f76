"""Every result has one owner, whatever the source; a write that fails costs one picture."""

import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.command import ROWS, Call, rows_of, save_picture
from tests.videos import write_video


def write_inputs(root: Path, names: Sequence[str]) -> Path:
    """Pictures and videos in a folder."""
    for seed, name in enumerate(names):
        if name.endswith(".mp4"):
            write_video(root / name)
        else:
            save_picture(root / name, seed)
    return root


@pytest.mark.parametrize(
    "names",
    [
        ["1.png", "1.jpg"],
        ["drive.mp4", "drive/000003.png"],
        ["1.png", "run.png"],
        ["1.png", "1.labelme.png"],
        [r"1\xff.png", os.fsdecode(b"1\xff.png")],  # index.csv calls both 1\xff.png
    ],
)
def test_two_images_with_one_result(
    names: list[str], call: Call, tmp_path: Path, out: Path
) -> None:
    (tmp_path / "in").mkdir()
    given = write_inputs(tmp_path / "in", names)

    result = call("infer", given, *ROWS, "--out", out, "--save", "json,polygons,cues")

    assert result.exit_code == 2
    assert "both would write" in result.stderr
    assert not out.exists()


def test_images_beside_a_video_of_their_name_stay(call: Call, tmp_path: Path, out: Path) -> None:
    given = write_inputs(tmp_path, ["drive.mp4", "drive/000003.png", "drive/x.png"])

    result = call("infer", given, *ROWS, "--out", out)

    assert result.exit_code == 0, result.stderr
    assert {"drive/000003.png", "drive/x.png"} < set(rows_of(out))


def test_a_name_that_is_too_long_costs_its_own_image(call: Call, tmp_path: Path, out: Path) -> None:
    names = [*(f"{number}.png" for number in range(4)), f"1{'n' * 245}.png"]
    given = write_inputs(tmp_path / "in", names)

    result = call("infer", given, *ROWS, "--out", out)

    assert result.exit_code == 1
    statuses = {name[:2]: row["status"] for name, row in rows_of(out).items()}
    assert statuses.pop("1n").startswith("failed")
    assert set(statuses.values()) == {"done"}
    assert len(statuses) == 4
