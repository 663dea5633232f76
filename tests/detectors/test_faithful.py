"""Detectors called ``:paper`` equal slow implementations of the papers, on a real image."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from scipy.stats import rankdata
from torch import Tensor

from roadtorch.detectors.catalogue import load_detector
from roadtorch.layout.patch_network import PatchNetwork, normalise
from roadtorch.oneclass import mixture
from roadtorch.oneclass.samples import SampleSettings, road_samples
from roadtorch.ufl.features import DictionarySettings, initial_dictionary
from tests.reference import alvarez2012, alvarez2014, zhang2016

STEPS = Path(__file__).resolve().parents[2] / "docs/pictures/steps.jpg"


IMAGES = {"motorway": np.s_[18:198, 40:280], "street": np.s_[256:496, :320]}
"""Where two of README's images are: Udacity's, and one of MCubeS with a lane mark ahead (MIT)."""


@cache
def real_image(name: str, width: int, height: int) -> Tensor:
    """Return a real image with 8-bit levels, float64 (3, H, W)."""
    steps = cv2.imread(str(STEPS))
    assert steps is not None
    small = cv2.resize(steps[IMAGES[name]], (width, height), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(small[..., ::-1].copy()).permute(2, 0, 1).double() / 255


def test_ufl_paper_is_the_text_of_zhang_et_al() -> None:
    image = real_image("motorway", 80, 60)
    start = initial_dictionary(torch.zeros(1, 108).double(), DictionarySettings())

    result = load_detector("ufl:paper", working={"rows": 60}).analysis(image)["likelihood"] >= 0.5

    literal = torch.from_numpy(zhang2016.road(image.numpy(), start.numpy()))
    assert 0.1 < literal.double().mean() < 0.6
    assert torch.equal(result, literal)


@pytest.mark.parametrize(("name", "seed"), [("fusion:paper", 0), ("layout:paper", 1)])
def test_equation_4_and_cnn_7_of_alvarez_et_al_at_single_pixels(name: str, seed: int) -> None:
    image = real_image("motorway", 96, 72)
    detector = load_detector(name)
    network = detector.analysis.get_submodule("network")
    assert isinstance(network, PatchNetwork)
    weights = {name: value.double().numpy() for name, value in network.state_dict().items()}
    places = np.random.default_rng(seed).integers((0, 0), (72, 96), (40, 2))

    result = detector.detect(image.float())

    if name == "fusion:paper":
        pixels = normalise(image, network.settings.normalisation).pixels.numpy()
        segments = result.cues["segments"].numpy()
        literal = alvarez2012.road(image.numpy(), pixels, weights, segments, places)
    else:
        pixels = ((image - 0.5) * 4).numpy()  # (level - ½)·4, which P2 leaves open
        literal = [alvarez2012.ground(pixels, weights, *place) for place in places.tolist()]
    at_places = result.likelihood[tuple(places.T)].double().numpy()
    assert literal == pytest.approx(at_places, abs=1e-4)
    assert np.ptp(literal) > 0.3


@pytest.mark.parametrize(
    ("literal", "settings", "agreement"),
    [
        (alvarez2014.robust_gaussian, {}, 0.995),
        (alvarez2014.mog2, {}, 0.995),
        # Of several summits both have to find the highest.
        (alvarez2014.mog4, {"restarts": 20}, 0.995),
        (alvarez2014.mog_opt, {"restarts": 100}, 0.99),
        (alvarez2014.dlp, {}, 0.995),
        (alvarez2014.pca, {}, 0.995),
    ],
)
def test_oneclass_paper_is_the_text_of_alvarez_et_al(
    literal: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, float]],
    settings: dict[str, int],
    agreement: float,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mixture, "LIKELIHOOD_TOLERANCE", 0.0)  # both run to convergence
    image = real_image("street", 240, 180)
    samples = road_samples(image.float(), ("R", "G", "B"), SampleSettings()).double().numpy()

    name = f"oneclass:{literal.__name__}:RGB:paper"

    result = load_detector(name, classifier=settings).detect(image.float())

    distances, boundary = literal(samples, image.flatten(1).T[::7].numpy())
    ranks = rankdata(distances), rankdata(-result.likelihood.flatten()[::7].numpy())
    assert np.corrcoef(*ranks)[0, 1] > 0.9995
    assert np.mean((distances <= boundary) == result.mask.flatten()[::7].numpy()) > agreement
