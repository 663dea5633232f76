"""README and docs: every bound figure is as its source has it; what the front page shows works."""

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadtorch.scenes.street import render_scene, write_picture
from scripts import bound_figures, readme_evaluations, readme_figures
from scripts.readme_evaluations import RUNS, SLOW_RUNS, Run, facts, records_of

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The documents and their records, to be changed."""
    shutil.copy(ROOT / "README.md", tmp_path)
    (tmp_path / "docs").mkdir()
    for path in (ROOT / "docs").iterdir():
        if path.suffix in (".md", ".json"):
            shutil.copy(path, tmp_path / "docs")
    shutil.copytree(ROOT / readme_figures.FIGURES, tmp_path / readme_figures.FIGURES)
    return tmp_path


# --- figures ---------------------------------------------------------------------------------


def test_every_bound_figure_is_as_its_source_has_it() -> None:
    assert readme_figures.check(ROOT, readme_figures.records(ROOT)) == []


def test_a_stale_figure_planted_in_readme_is_found(copy: Path) -> None:
    known = readme_figures.records(copy)
    text = (copy / "README.md").read_text()
    planted = re.sub(r"\.\d+(?=<!-- figure: many\.fusion\.f_mask\.worst -->)", ".999", text)
    assert planted != text
    (copy / "README.md").write_text(planted)

    (wrong,) = readme_figures.check(copy, known)
    assert wrong.startswith("README.md:")
    assert ": .999: many.fusion.f_mask.worst is " in wrong

    readme_figures.write(copy, known)
    assert (copy / "README.md").read_text() == text


def test_a_changed_source_makes_documents_stale(copy: Path) -> None:
    path = copy / readme_figures.FIGURES / "many.json"
    rows = json.loads(path.read_text())
    for row in rows:
        if row["name"] == "many.fusion.f_mask":
            row["value"] += 0.02
    path.write_text(json.dumps(rows))

    wrong = readme_figures.check(copy, readme_figures.records(copy))
    assert any(one.startswith("README.md") and "table front" in one for one in wrong)
    assert any(one.startswith("docs/many.md") for one in wrong)


@pytest.mark.parametrize("name", readme_figures.WHOLLY_BOUND)
def test_a_figure_without_a_source_is_found(copy: Path, name: str) -> None:
    path = copy / name
    path.write_text(path.read_text() + "\nIt takes 32 ms.\n")
    (wrong,) = readme_figures.check(copy, readme_figures.records(copy))
    assert wrong.startswith(name)
    assert wrong.endswith("32 has no source")


def test_no_record_is_kept_that_no_document_uses() -> None:
    kept = set(readme_figures.records(ROOT)) - set(facts())
    assert kept <= readme_figures.used(ROOT)


def test_the_facts_are_those_of_the_code() -> None:
    found = {name: one.value for name, one in facts().items()}
    assert found["facts.classifiers"] == 17
    assert found["facts.representations"] == 19


# --- evaluations as records ------------------------------------------------------------------

METRICS = {
    "images": 5,
    "detectors": {
        "fusion": {
            "f_mask": 0.8,
            "maxf": 0.9,
            "auc_pooled": 0.96,
            "layout": {"mean": None, "sky": 0.7},
            "groups": {"a": {"f_mask": 0.9, "maxf": 0.95}, "b": {"f_mask": 0.7, "maxf": 0.99}},
            "conditions": {"night": {"f_mask": 0.5}},
            "ci95": {"maxf": [0.88, 0.91], "f_mask": None},
            "settings": {"random_seed": 3},
            "floor": False,
        },
        "lbp": {"auc_pooled": 0.8, "maxf": 0.5, "groups": {}, "ci95": {}},
    },
    "paired": {"detectors": {"lbp": {"maxf": {"difference": -0.4, "ci95": [-0.5, -0.3]}}}},
}


def test_an_evaluation_becomes_flat_records() -> None:
    found = {name: one.value for name, one in records_of("run", METRICS, "x").items()}
    wanted = {
        "run.images": 5,
        "run.fusion.maxf": 0.9,
        "run.fusion.maxf.low": 0.88,
        "run.fusion.maxf.high": 0.91,
        "run.fusion.f_mask@b": 0.7,
        "run.fusion.f_mask@night": 0.5,
        "run.fusion.f_mask.worst": 0.7,
        "run.fusion.f_mask.worst.camera": "b",
        "run.fusion.maxf.worst.camera": "a",
        "run.fusion.layout.sky": 0.7,
        "run.lbp.maxf.less": -0.4,
        "run.lbp.maxf.less.high": -0.3,
    }
    assert {name: found.get(name) for name in wanted} == wanted
    assert found["run.fusion.auc_pooled.over_lbp"] == pytest.approx(0.2)
    assert not [
        name for name in found if "seed" in name or "layout.mean" in name or "floor" in name
    ]


def test_every_run_compares_with_fusion_and_keeps_its_figures_apart() -> None:
    for run in (*RUNS, *SLOW_RUNS):
        words = run.command("D", "O")
        assert words[0] == "evaluate"
        assert words[-1] == f"O/{run.name}"
        assert not [word for word in words if "DATA" in word or "OUT" in word]
        assert "fusion" in run.detectors


def test_a_run_is_made_and_its_used_figures_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for camera in ("a", "b"):
        (tmp_path / "many" / camera / "masks").mkdir(parents=True)
        for seed in range(2):
            street = render_scene(seed, 48, 64)
            write_picture(tmp_path / "many" / camera / "images" / f"{seed}.png", street)
            mask = street.road.numpy().astype(np.uint8) * 255
            cv2.imwrite(str(tmp_path / "many" / camera / "masks" / f"{seed}.png"), mask)
    run = Run("many", ("folder", "DATA/many"), ("fusion",))
    monkeypatch.setattr(readme_evaluations, "RUNS", (run,))

    readme_evaluations.evaluate(tmp_path, tmp_path / "out", ["many"], jobs=1)
    used = {"many.fusion.f_mask", "many.fusion.f_mask@a", "other.figure"}
    (path,) = readme_evaluations.collect(tmp_path / "out", tmp_path / "figures", used)

    found = bound_figures.read_records([path])
    assert set(found) == {"many.fusion.f_mask", "many.fusion.f_mask@a"}
    assert 0 < float(found["many.fusion.f_mask"].value) <= 1
    assert found["many.fusion.f_mask"].command.startswith("roadtorch evaluate folder DATA/many")


# --- the front page --------------------------------------------------------------------------


def test_the_example_in_python_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (block,) = re.findall(r"```python\n(.*?)```", README, re.S)
    write_picture(tmp_path / "street.png", render_scene(1, 96, 128))
    (tmp_path / "street.png").rename(tmp_path / "street.jpg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(block, names)
    detection = names["detection"]
    assert detection.mask.shape == (96, 128)  # pyright: ignore[reportAttributeAccessIssue]
    assert 0 <= detection.trust <= 1  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    "path", ["README.md", "docs/results.md", "docs/many.md", "docs/adapting.md"]
)
def test_links_lead_somewhere(path: str) -> None:
    page = ROOT / path
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if not link.startswith(("https://", "#")):
            assert (page.parent / link.partition("#")[0]).exists(), link


def test_the_pictures_are_small_and_their_sources_named() -> None:
    folder = ROOT / "docs" / "pictures"
    assert sum(path.stat().st_size for path in folder.iterdir()) < 1.5e6
    assert (folder / "drive.gif").stat().st_size < 600_000
    sources = (folder / "sources.csv").read_text()
    assert all(name in sources for name in readme_figures.readme_pictures.CHOSEN)
    assert all(word in README for word in ("MIT", "CC BY 4.0", "docs/pictures/sources.csv"))


def test_the_figures_of_a_page_without_a_source_are_listed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "page.md").write_text("F .5\n\n.6<!-- figure: x --> and 7\n")
    assert readme_figures.main(["free", str(tmp_path / "page.md")]) == 0
    told = capsys.readouterr().out.splitlines()
    assert [line.rpartition("page.md:")[2] for line in told] == ["1: .5", "3: 7"]


def test_a_figure_of_neither_task_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        readme_figures.main([])
    assert "give --check, or one of evaluate, write, free, make" in capsys.readouterr().err
