"""The benchmark of fourteen cameras: gathered by name and bytes from anywhere."""

from pathlib import Path

import pytest

from roadtorch.base.atomic import file_digest
from scripts import benchmark


def test_files_are_gathered_by_their_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows, many = ["file,sha256,source,terms,passed_on"], tmp_path / "many"
    for name in ("a/images/x.1.png", "a/road/x.1.png", "b/images/y.jpg"):
        (path := tmp_path / "any" / name).parent.mkdir(parents=True)
        path.write_text(name)
        rows.append(f"{name},{file_digest(path)},S,MIT,yes")
    path.write_text("changed")
    (tmp_path / "list.csv").write_text("\n".join(rows))
    monkeypatch.setattr(benchmark, "BENCHMARK", tmp_path / "list.csv")

    assert benchmark.main([str(tmp_path / "any"), "--out", str(many)]) == 1

    files = {str(path.relative_to(many)): path.read_text() for path in many.glob("*/*/*")}
    assert files == {name: name for name in ("a/images/x.1.png", "a/road/x.1.png")}
    table = ["a | 2 | 0 | S | MIT | yes", "b | 1 | 1 | S | MIT | yes", "missing b/images/y.jpg"]
    assert capsys.readouterr().out.splitlines()[1:] == [*table, "1 missing"]


@pytest.mark.data
def test_the_list_is_that_of_the_fourteen_cameras(data_root: Path, tmp_path: Path) -> None:
    assert benchmark.main([str(data_root), "--out", str(tmp_path)]) == 0

    made = {path.relative_to(tmp_path): path.read_bytes() for path in tmp_path.glob("*/*/*")}
    many = {path.relative_to(data_root / "many"): path for path in data_root.glob("many/*/*/*")}
    assert made == {n: p.read_bytes() for n, p in many.items() if n.parts[0] != "india_zed"}
