"""The sweep over topologies: what is shortened, the table, and going on where it was."""

import csv
import sys
from pathlib import Path

import pytest
import torch

from roadtorch.train.config import PatchTraining
from tests.streets import scene, write_camvid
from tests.train.runs import PATCHES, write_config, write_streets
from train import sweep_topologies
from train.topologies import P2_TOPOLOGIES
from train.topology_table import LABELLER, Studied, accuracy, best_of_patches, table


def confusion(right: int, wrong: int) -> torch.Tensor:
    counts = torch.zeros(4, 4, dtype=torch.int64)
    counts[:3, :3] = wrong
    counts.diagonal()[:3] = right
    return counts


def studied(name: str, right: int) -> Studied:
    topology = P2_TOPOLOGIES[name.removesuffix(" grey")]
    topology = sweep_topologies.on_grey(topology) if name.endswith("grey") else topology
    seconds = torch.tensor([1.0, 0.1])
    return Studied(name, topology, 10, 0.5, {"a": confusion(right, 1)}, seconds)


def test_training_is_shortened_alike_whatever_the_topology() -> None:
    base = PatchTraining()

    one, other = (
        sweep_topologies.shortened(base, P2_TOPOLOGIES[name]) for name in ("CNN-7", "CNN-13")
    )

    assert one.network.topology != other.network.topology
    same = other.network.model_copy(update={"topology": one.network.topology})
    assert other.model_copy(update={"network": same}) == one
    assert (one.sites.around, one.descent.batch) == (0, 32)
    assert one.descent.rate == base.descent.rate


def test_the_costliest_training_comes_first_and_grey_beside_colour() -> None:
    names = [*sweep_topologies.family(("CNN-1", "CNN-13", "CNN-7"))]

    assert names == ["CNN-13", "CNN-13 grey", "CNN-7", "CNN-7 grey", "CNN-1", "CNN-1 grey"]


def test_the_papers_accuracy_counts_void_as_vertical() -> None:
    seen = confusion(8, 1)
    seen[3, 0] = 10  # void, taken for sky: wrong in P2's reading

    found = accuracy({"a": seen, "b": confusion(4, 3)})

    assert found.pooled == pytest.approx(12 / 20)
    assert found.drives == pytest.approx((0.8 + 0.4) / 2)
    assert found.paper == pytest.approx((12 / 20 + 12 / 30 + 12 / 20) / 3)


def test_a_line_for_each_topology_and_the_best_of_each_patch_size() -> None:
    rows = {name: studied(name, right) for name, right in (("CNN-7", 8), ("CNN-1", 4))}
    rows |= {f"{name} grey": studied(f"{name} grey", 2) for name in ("CNN-7", "CNN-1")}

    lines = table(rows, ({"a": confusion(18, 1)}, torch.tensor([2.0, 0.2])))

    assert [line["name"] for line in lines] == ["CNN-1", "CNN-7", LABELLER]
    assert [line["accuracy"] for line in lines] == ["0.667", "0.800", "0.900"]
    assert lines[1]["grey accuracy"] == "0.500"
    assert lines[1]["P2, s"] == "1.96 / 0.21"
    assert [one.name for one in best_of_patches(list(rows.values()))] == ["CNN-7"]


def test_a_sweep_writes_its_table_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    streets = write_streets(tmp_path / "streets", 2)
    write_camvid(tmp_path / "camvid", "train", {"0001TP_1": scene(5, 48, 64)})
    config = write_config(tmp_path / "patches.toml", PATCHES)
    out = tmp_path / "out"
    words = ["sweep", streets, tmp_path / "camvid", "--out", out, "--config", config]
    words += ["--every", 1, "--score-every", 1, "--rounds", 1, "--jobs", 1, "--only", "CNN-1"]
    monkeypatch.setattr(sys, "argv", [str(word) for word in words])

    sweep_topologies.main()
    made = {path: path.stat().st_mtime_ns for path in out.glob("*.safetensors")}
    (out / "CNN-1 grey.npz").unlink()
    sweep_topologies.main()

    assert {path.stem for path in made} == {"CNN-1", "CNN-1 grey"}
    assert made == {path: path.stat().st_mtime_ns for path in made}
    with (out / "topologies.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["CNN-1", LABELLER]
    assert int(rows[0]["patches"]) > 50
    assert (out / "topologies.png").stat().st_size > 10_000
    assert (out / "topologies.md").read_text().count("\n") == 4
