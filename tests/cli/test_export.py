from pathlib import Path

from tests.command import Call


def test_export_tells_what_it_wrote_and_nothing_else(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "new" / "road.onnx"

    result = call("export", "layout:cnn-7", "--out", out)

    assert result.exit_code == 0, result.stderr
    assert out.is_file()
    assert result.stderr == ""
    first, what, *notes, last = result.stdout.splitlines()
    assert first.startswith(f"{out}: ")
    assert what.startswith("layout:cnn-7: its likelihood and layout")
    assert {line.split()[0] for line in notes} >= {"colour_order", "threshold", "terms"}
    assert last.startswith("parity with Python on 6 rendered pictures: at most ")


def test_export_says_in_one_line_what_cannot_be_exported(call: Call, tmp_path: Path) -> None:
    result = call("export", "lbp", "--out", tmp_path / "a.onnx")

    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr == (
        "roadtorch: error: lbp: cannot be exported (those that can: fusion, layout, layout:cnn-7)\n"
    )
