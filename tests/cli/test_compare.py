"""roadtorch compare: two results on labels, on corrections, and where they disagree."""

import csv
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from roadtorch.annotate.session import import_event
from roadtorch.base.errors import ConfigError, DatasetError, WeightsError
from roadtorch.base.image import write_npy
from roadtorch.cli.compare import compare
from roadtorch.data.corrections import EventLog, LogHead, log_path, open_corrections
from roadtorch.evaluation.disagreement import disagreement, unlabelled_set
from roadtorch.inputs.pictures import picture_item
from roadtorch.layout.picture_network import PictureNetwork, PictureNetworkSettings
from roadtorch.layout.weights import save_network
from roadtorch.testing.scenes import write_picture
from tests.command import invoked
from tests.streets import scene

COUNT = 4


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compare") / "streets"
    for seed in range(COUNT):
        write_picture(folder / f"street_{seed}.png", scene(seed, 48, 64))
    return folder


@pytest.fixture(scope="module")
def corrections(streets: Path) -> Path:
    """Everything said of the road of all pictures but the last, as it is rendered."""
    folder = streets.parent / "corrections"
    for seed in range(COUNT - 1):
        name = f"street_{seed}.png"
        labels = np.where(scene(seed, 48, 64).road.numpy(), 1, 2).astype(np.uint8)
        head = LogHead(picture=f"../streets/{name}", height=48, width=64)
        EventLog(log_path(folder, name), head).add(import_event(labels))
    return folder


run = partial(invoked, compare)


def test_corrected_pictures_are_a_labelled_set(corrections: Path) -> None:
    dataset = open_corrections(corrections)
    assert [item.name for item in dataset.items] == ["street_0", "street_1", "street_2"]
    image, truth = dataset.read(dataset.items[1])
    assert truth.valid.all()
    assert torch.equal(truth.road, scene(1, 48, 64).road)
    assert image.shape == (3, 48, 64)


def test_two_are_scored_on_corrections_with_intervals(corrections: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    result = run(
        "prior:triangle", "prior:rows", "--corrections", corrections, "--worst", 1, "--out", out
    )

    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert any(line.startswith("minus A:prior:triangle") for line in lines)
    pairs = next(line for line in lines if line.startswith("B:prior:rows") and " to " in line)
    assert pairs.split()[1].startswith(("+", "-"))
    assert (out / "report.html").is_file()
    assert (out / "metrics.json").is_file()


def test_without_labels_the_page_shows_where_they_differ_most(
    streets: Path, tmp_path: Path
) -> None:
    maps, empty = tmp_path / "maps", tmp_path / "empty"
    maps.mkdir()
    empty.mkdir()
    for seed in range(COUNT):  # the more pictures, the more of them is called road
        share = (torch.arange(48) >= 48 - 10 * (seed + 1)).float()[:, None].expand(48, 64)
        write_npy(maps / f"street_{seed}.npy", share)
        write_npy(empty / f"street_{seed}.npy", 0 * share)

    result = run(maps, empty, "--images", streets, "--out", tmp_path / "out", "--worst", 2)

    assert result.exit_code == 0
    rows = list(csv.DictReader((tmp_path / "out" / "disagreement.csv").read_text().splitlines()))
    assert [row["image"] for row in rows] == [f"street_{seed}" for seed in (3, 2, 1, 0)]
    assert float(rows[0]["differs"]) == pytest.approx(40 / 48, abs=1e-5)
    assert float(rows[0]["only_second"]) == float(rows[0]["iou"]) == 0
    page = (tmp_path / "out" / "disagreement.html").read_text()
    assert page.count("data:image/jpeg") == 2
    assert "A:maps" in page
    assert result.stdout.splitlines()[0].split()[0] == "picture"


def test_a_picture_that_one_cannot_look_at_is_told_and_the_rest_is_done(
    streets: Path, tmp_path: Path
) -> None:
    write_npy(tmp_path / "street_1.npy", torch.ones(48, 64))

    result = run(tmp_path, "prior:rows", "--images", streets)

    assert result.exit_code == 1
    assert result.stdout.splitlines()[1].startswith("street_1")
    assert result.stderr.count("failed: ") == COUNT - 1


def test_it_says_that_people_are_behind_weights(streets: Path, tmp_path: Path) -> None:
    network = PictureNetwork(PictureNetworkSettings(height=32, width=40, narrow=8, wide=8))
    path = tmp_path / "mine" / "weights.safetensors"
    path.parent.mkdir()
    save_network(path, network, {"corrections": [{"pictures": 7, "pixels": 9}]})

    result = run(path, "prior:rows", "--images", streets / "street_0.png")

    assert "A:mine-weights was trained with 7 pictures that people corrected" in result.stderr


def test_masks_are_compared_pixel_by_pixel() -> None:
    first, second = torch.zeros(4, 5, dtype=torch.bool), torch.zeros(4, 5, dtype=torch.bool)
    first[:2], second[1:2, :4] = True, True
    second[3] = True
    (item,) = unlabelled_set([picture_item(Path("a.png"), "a")]).items

    found = disagreement(item, first, second)

    assert (found.first, found.second) == (10 / 20, 9 / 20)
    assert (found.only_first, found.only_second) == (6 / 20, 5 / 20)
    assert found.differs == pytest.approx(11 / 20)
    assert found.iou == pytest.approx(4 / 15)
    assert disagreement(item, ~(first | ~first), first & ~first).iou == 1


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("fusion", "no/such.safetensors"), WeightsError),
        (("fusion", "nothing/here"), ConfigError),
        (("fusion", "fusionn"), ConfigError),
    ],
)
def test_what_cannot_be_compared_is_told(
    arguments: tuple[str, str], error: type[Exception], streets: Path
) -> None:
    with pytest.raises(error):
        run(*arguments, "--images", streets)


def test_one_kind_of_pictures_is_asked_for(streets: Path, tmp_path: Path) -> None:
    assert run("fusion", "prior:rows").exit_code == 2
    assert run("fusion", "labeller", "--images", streets, "--labelled", "folder:x").exit_code == 2
    with pytest.raises(DatasetError, match="holds no corrections"):
        run("prior:rows", "prior:triangle", "--corrections", tmp_path)
