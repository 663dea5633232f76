"""Smoothed labels, the calibration of a network to them, and the verdict."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from roadtorch import load_detector
from roadtorch.base.image import write_rgb
from roadtorch.base.settings import find_config, merge, read_settings_file
from roadtorch.evaluation.metrics import ConfusionCounts, f_measure
from roadtorch.inputs.images import find_images
from roadtorch.inputs.item import Item
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.weights import weights_path
from roadtorch.run.memo import read_arrays, write_arrays
from roadtorch.testing.scenes import render_scene
from roadtorch.train.adaptation.adapt import write_biased, write_smoothed_labels
from roadtorch.train.adaptation.frames import sample_frames
from roadtorch.train.adaptation.verdict import MaskCounts, count_masks, decide_verdict, fit_bias
from roadtorch.train.config import ImageTraining, build_training
from roadtorch.train.prepared import from_uint8, image_file_name, to_uint8
from roadtorch.train.teachers import prepare_image, resize_as_prepared
from tests.draws import seeded_generator

SHIPPED = weights_path("backbone-free")


def training_of(**changes: object) -> ImageTraining:
    training = build_training(merge(read_settings_file(find_config("adapt")), changes))
    assert isinstance(training, ImageTraining)
    return training


# --- the teacher ---------------------------------------------------------------------------


def roads(files: list[Path]) -> Tensor:
    return torch.stack(
        [from_uint8(read_arrays(file, "maps")["maps"][NUM_CLASSES]) for file in files]
    )


def test_views_of_one_place_become_alike_and_others_stay(tmp_path: Path) -> None:
    (tmp_path / "drive").mkdir()
    street, generator = render_scene(1, 120, 160).image, seeded_generator(0)
    for number in range(4):
        noise = 0.05 * torch.randn(street.shape, generator=generator)
        write_rgb(tmp_path / f"drive/{number}.jpg", (street + noise).clamp(0, 1))
    write_rgb(tmp_path / "drive/4.jpg", render_scene(2, 120, 160).image)
    frames = sample_frames([str(tmp_path / "drive")], tmp_path / "frames", 10, quiet=True)
    labels, prepared = tmp_path / "labels", tmp_path / "prepared"
    training = training_of(teacher={"detector": "labeller"})

    assert write_smoothed_labels(frames, labels, prepared, training, quiet=True) is None

    files = [sorted(folder.rglob("*.npz")) for folder in (labels, prepared)]
    single, averaged = map(roads, files)
    assert averaged[:4].var(0).mean() < 0.2 * single[:4].var(0).mean()
    assert torch.allclose(averaged[4], single[4], atol=1 / 255)
    before, after = (read_arrays(names[0], "image")["image"] for names in files)
    assert before.equal(after)


# --- the bias ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Item], Path]:
    """Write streets, and the masks of `fusion` as prepared labels of a teacher."""
    folder, teacher = tmp_path_factory.mktemp("streets"), load_detector("fusion")
    (folder / "prepared").mkdir()
    for number in range(2):
        write_rgb(folder / f"{number}.jpg", render_scene(number, 96, 128).image)
    images = find_images([str(folder / "*.jpg")])
    for image in images:
        road = teacher.detect(image.read()).mask.float()[None]
        layout = torch.cat([torch.zeros(2, 96, 128), torch.ones(1, 96, 128)])
        maps = resize_as_prepared(torch.cat([layout, road]), training_of().network, (96, 128))
        arrays = {"maps": to_uint8(maps), "ego": to_uint8(0 * road[0])}
        write_arrays(folder / "prepared" / f"{image_file_name(image)}.npz", arrays)
    return images, folder / "prepared"


@pytest.mark.parametrize("shift", [-2.0, 2.0], ids=["timid", "bold"])
def test_bias_undoes_shift(shift: float, streets: tuple[list[Item], Path], tmp_path: Path) -> None:
    shifted, corrected = tmp_path / "s.file", tmp_path / "m.file"
    images, prepared = streets
    write_biased(SHIPPED, shifted, shift)

    bias = fit_bias(images, shifted, prepared, training_of(), quiet=True)
    write_biased(shifted, corrected, bias)

    assert bias == pytest.approx(-shift, abs=1)
    files = (shifted, corrected, corrected)
    judged = count_masks(images, files, prepared, training_of(), quiet=True)
    shifted_f, corrected_f, _ = (float(f_measure(ConfusionCounts(*rows.sum(0)))) for rows in judged)
    assert corrected_f > max(shifted_f, 0.97)


def test_masks_are_compared_in_the_rows_of_prepared_images(
    streets: tuple[list[Item], Path], tmp_path: Path
) -> None:
    images, training = streets[0], training_of(network={"upper_rows": 0.5})
    for image in images:
        arrays = prepare_image(image.read(), load_detector("fusion"), training)
        write_arrays(tmp_path / f"{image_file_name(image)}.npz", arrays)

    judged = count_masks(images, (SHIPPED, SHIPPED, SHIPPED), tmp_path, training, quiet=True)

    assert float(f_measure(ConfusionCounts(*judged.initial.sum(0)))) > 0.97


def test_without_evidence_none_is_shifted(streets: tuple[list[Item], Path], tmp_path: Path) -> None:
    assert fit_bias(streets[0], SHIPPED, tmp_path / "nothing", training_of(), quiet=True) == 0


# --- the verdict ---------------------------------------------------------------------------

Half = tuple[list[int], list[int], list[int]]
"""Pixels found of 100 of road in each frame: before, after, by the averaged network."""


def judged(half: Half) -> MaskCounts:
    return MaskCounts(*(torch.tensor([[hit, 0, 100 - hit, 0] for hit in hits]) for hits in half))


@pytest.mark.parametrize(
    ("halves", "word"),
    [
        ([([50] * 12, [60] * 12, [60] * 12)] * 2, "adopt"),
        ([([60] * 24, [50] * 24, [50] * 24)], "do not adopt"),
        # a loss of the half that both together make good
        ([([60] * 24, [50] * 24, [70] * 24)], "cannot tell"),
        # what was seen is no reason to adopt
        ([([60] * 24, [60] * 24, [90] * 24)], "cannot tell"),
        # the judge errs too
        ([([60] * 24, [60] * 24, [60] * 24)], "cannot tell"),
        # one stretch alone may be chance
        ([([60] * 24, [60] * 20 + [90] * 4, [60] * 24)], "cannot tell"),
        # few frames, however large the gain
        ([([10] * 15, [90] * 15, [90] * 15)], "cannot tell"),
        # a half that loses weighs against one that gains
        ([([50] * 12, [60] * 12, [60] * 12), ([60] * 12, [50] * 12, [50] * 12)], "cannot tell"),
    ],
)
def test_a_verdict_needs_a_change_on_held_out_frames(halves: list[Half], word: str) -> None:
    assert decide_verdict([judged(half) for half in halves]).word == word


def test_a_verdict_is_a_sentence_with_its_figures() -> None:
    assert str(decide_verdict([judged(([60] * 24, [50] * 24, [70] * 24))])) == (
        "cannot tell: on 24 held-out frames the mask may or may not agree better with the teacher: "
        "F 0.750 to 0.667, -0.083 (95 % -0.083 to -0.083); averaged network 0.824"
    )
