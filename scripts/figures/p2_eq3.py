"""P2, eq. 3: AUC by the inverse of Σ and by the scale of the colour planes."""

from collections.abc import Mapping
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from roadtorch.base.image_cache import cached_per_image
from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Dataset, LabelledItem, subsample_dataset
from roadtorch.detectors.catalogue import load_detector
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.detector import Detector
from roadtorch.detectors.entry import WorkingSettings
from roadtorch.evaluation.evaluate import evaluate
from roadtorch.evaluation.measures import MAXF, MEASURES
from roadtorch.evaluation.methods import Contender, Predictor
from roadtorch.imaging.resize import resize_to_image, resize_to_work, spatial_size
from roadtorch.imaging.segments import paint_segments
from roadtorch.layout.classes import HORIZONTAL
from roadtorch.road.seed_area import seed_rectangle
from roadtorch.road.texture import TextureSettings, fused_uniformity
from scripts.figures.chart import show_table
from scripts.figures.p2_layout import open_camvid
from scripts.figures.p2_road import reach_of_seed


class Variant(NamedTuple):
    """A reading of eq. 3: ridge (0 is the pseudo-inverse), and the largest level of the image.

    With 255 the planes nr, ng and S are fractions still; the others are in levels of 8 bits.
    """

    ridge: float
    largest: float


VARIANTS: Mapping[str, Variant] = {
    "pseudo-inverse, levels to 1": Variant(0, 1),
    "pseudo-inverse, levels to 255": Variant(0, 255),
    "ridge .003, levels to 1": Variant(0.003, 1),
    "ridge .003, levels to 255": Variant(0.003, 255),
    "ridge 1e-9, levels to 1": Variant(1e-9, 1),  # nearly the inverse, which does not exist
}

EVERY = 4
"""Step between CamVid's images."""

IDD_IMAGES = 50

PARTS = ("CPF", "CNN-7 × CPF")

AUC = next(measure for measure in MEASURES if measure.key == "auc_pooled")


@cache
def paper() -> Detector:
    """Load P2's detector."""
    return load_detector("fusion:paper")


def eq3(data: Path, out: Path) -> None:
    """Write AUC of CPF and of its product with CNN-7, isolated areas dropped, by variants."""
    sets = {"CamVid, mean of drives": open_camvid(data, EVERY)}
    if (data / "idd_lite").is_dir():
        sets["IDD"] = subsample_dataset(open_dataset("idd-lite", data / "idd_lite"), IDD_IMAGES)
    rows = [{"set": name, **row} for name, dataset in sets.items() for row in variant_rows(dataset)]
    show_table(out / "p2-eq3.csv", rows)


def variant_rows(dataset: Dataset) -> list[dict[str, str]]:
    """Return AUC with its 95 % interval of each variant and part."""
    contenders = [
        Contender(f"{part}, {title}", partial(prepare, part, variant))
        for part, (title, variant) in product(PARTS, VARIANTS.items())
    ]
    result = evaluate(dataset, contenders, with_baselines=False, measures=(MAXF, AUC), quiet=False)
    rows = []
    for title in VARIANTS:
        row = {"variant": title}
        for part in PARTS:
            scores = result.detectors[f"{part}, {title}"]
            row[part] = f"{AUC.get(scores.headline):.3f} ({scores.intervals[AUC.key]})"
        rows.append(row)
    return rows


def prepare(part: str, variant: Variant, _: Dataset) -> Predictor:
    """Return the detector of a part with a variant of eq. 3."""
    return partial(detect, part, variant)


def detect(part: str, variant: Variant, image: Tensor, _: LabelledItem) -> Detection:
    """Compute CPF, or its product with CNN-7, with a variant of eq. 3."""
    small = resize_to_work(image, WorkingSettings().working)
    cues = analyse(small)
    labels = cues["segments"]
    values = fused_uniformity(
        small * variant.largest,
        labels,
        labels >= 0,
        seed_rectangle(labels.shape),
        TextureSettings(ridge=variant.ridge),
    )[1]
    likelihood = paint_segments(values, labels)
    if part != "CPF":
        likelihood = likelihood * cues["layout"][HORIZONTAL]
    likelihood = reach_of_seed(resize_to_image(likelihood, spatial_size(image)))
    return Detection(likelihood, likelihood >= 0.5, {})


@cached_per_image
def analyse(image: Tensor) -> Mapping[str, Tensor]:
    """Compute the cues of ``fusion:paper`` in an image (3, H, W) at its working size."""
    return paper().analysis(image)
