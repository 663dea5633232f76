"""Pages: names exist, examples run, claims agree with their tables."""

import csv
import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from pathlib import Path
from textwrap import dedent
from types import ModuleType

import pytest
from scipy.stats import spearmanr

from docs._extensions import generated_parts as parts
from docs._extensions.plain_docstrings import as_restructured
from roadtorch.base.atomic import file_digest
from roadtorch.base.errors import RoadtorchError
from roadtorch.base.settings import parse_assignments
from roadtorch.detectors.catalogue import detector_entry, list_detectors
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.weights import DEFAULT_WEIGHTS, load_network, shipped_weights
from roadtorch.road import trust
from roadtorch.testing.scenes import render_scene, write_image
from scripts.figures import FIGURES
from scripts.readme_pictures import made_with
from tests.videos import write_video
from train.claim_scores import page_rows

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("fusion", "features", "layout_texture", "one_class", "index")
FAMILIES = ("ufl", "fusion", "cpf", "layout", "prior", "oneclass")
SETTINGS_OF = (
    "ufl",
    "fusion:paper",
    *(f"oneclass:{name}:RGB" for name in ("svdd", "robust_gaussian", "mog2", "dlp", "hist64_s")),
)


def is_setting(assignment: str) -> bool:
    """Return whether some detector of the papers takes ``group.key=value``."""
    for name in SETTINGS_OF:
        try:
            detector_entry(name).make_settings(parse_assignments([assignment]))
        except RoadtorchError:
            continue
        return True
    return False


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_of_the_papers_names_exists(page: str) -> None:
    text = (ROOT / "docs/how" / f"{page}.md").read_text(encoding="utf-8")
    named = re.findall(r"`([^`\s]+)`", text)
    known = [*list_detectors("*"), *list_detectors("oneclass:*:*"), "prior:mean"]

    detectors = [n for n in named if ":" in n and n.split(":")[0] in FAMILIES and "<" not in n]
    assert [n for n in detectors if not any(fnmatch(name, n) for name in known)] == []
    assert [n for n in named if re.fullmatch(r"\w+\.\w+=[\w.]+", n) and not is_setting(n)] == []
    files = [n for n in named if re.match(r"(tests|configs|train|scripts)/", n)]
    assert [n for n in files if not (ROOT / n).exists()] == []
    assert [n for n in re.findall(r"scripts/figures (\S+)", text) if n not in FIGURES] == []


def test_modules_that_the_page_of_the_architecture_names_exist() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = re.findall(r"`([\w/]+\.py)`", page)

    assert named
    assert [name for name in named if not (ROOT / "roadtorch" / name).is_file()] == []


def test_the_detector_of_contributing_keeps_the_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.S)
    module = ModuleType("their_package")
    monkeypatch.setitem(sys.modules, "their_package", module)

    exec("\n".join(map(dedent, blocks)), vars(module))

    assert module.ENTRY.name == "bright"
    assert module.check_detector


@pytest.mark.parametrize("page", ["README.md", "docs/grid.md", "docs/how/one_class.md"])
def test_examples_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("street.png", "street.jpg"):
        write_image(Path(name), scene := render_scene(0, 64, 96))
    write_video(Path("drive.mp4"), (0.0, 0.1))

    for block in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.S):
        exec(block, dict.fromkeys(("samples", "pixels"), scene.image[:2, 0].T))

    assert len(list(tmp_path.iterdir())) > 3 or "how" in page  # the others save results


# --- claims -----------------------------------------------------------------------------

RESEARCH = ROOT / "docs" / "research"
COMBINATIONS = ["RGB", "nrng", "O1O2", "Lab", "HSV", "HS"]

Cells = Mapping[tuple[str, str], float]
"""Scores by classifier and planes."""


def apart(cells: Cells, names: Sequence[str], planes: Iterable[str]) -> str:
    """Return the largest difference of classifiers in some planes."""
    spread = [[cells[name, each] for name in names] for each in planes]
    return f"{max(max(values) - min(values) for values in spread):.1f}"


def claims(ours: Cells, printed: Cells) -> Iterator[str]:
    """Yield sentences of the page with the figures of the tables: ours on CamVid, and P3's."""
    every = {plane for _, plane in ours}
    for claim, names, planes in (
        ("SVDD and dLP are one classifier: within {} in every column ({})", ["svdd", "dlp"], every),
        ("of SVDD in single planes ({1})", ["svdd", "mpm"], every - {*COMBINATIONS}),
        ("combinations: within {} ({})", ["kmeans", "kcentres", "mst"], COMBINATIONS),
    ):
        yield claim.format(apart(ours, names, planes), apart(printed, names, planes))
    robust = ["gaussian", "robust_gaussian"]
    without_hsv = apart(printed, robust, {*COMBINATIONS} - {"HSV"})
    yield f"({without_hsv} but for HSV, where they are {apart(printed, robust, ['HSV'])}"
    yield f"within {apart(ours, ['gaussian', 'robust_gaussian:paper'], COMBINATIONS)} in comb"

    cells = [key for key in printed if not key[0].endswith(":paper")]
    letter = {key: ours.get((f"{key[0]}:paper", key[1]), ours[key]) for key in cells}
    best = max(letter, key=lambda key: letter[key])
    rank = spearmanr(list(letter.values()), [printed[key] for key in cells])[0]
    yield f"the best of CamVid is `{best[0]}:{best[1]}` with {letter[best]:.1f}"
    yield f"over {len(letter)} cells is {rank:+.2f} on CamVid".replace("0.", ".")
    for name in ("robust_gaussian", "mog4", "dlp", "pca"):
        yield f"| {ours[f'{name}:paper', 'RGB']:.1f} → {ours[name, 'RGB']:.1f} |"


def test_the_page_says_what_the_tables_say() -> None:
    with (RESEARCH / "oneclass_table3.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    ours, printed = (
        {(row["classifier"], row["representation"]): float(row[key]) for row in rows if row[key]}
        for key in ("camvid", "p3")
    )
    page = " ".join((ROOT / "docs/how/one_class.md").read_text(encoding="utf-8").split())

    assert [claim for claim in claims(ours, printed) if claim not in page] == []


def test_the_page_has_the_table_that_was_measured() -> None:
    page = (ROOT / "docs/research/claim.md").read_text(encoding="utf-8").splitlines()
    assert [row for row in page_rows(RESEARCH) if row not in page] == []


# --- parts made of the code -------------------------------------------------------------


def test_links_lead_to_pages_of_the_site_but_in_code() -> None:
    code = "\n```\n[x](features.md)\n```\n"
    text = "[x](../../train/README.md) [y](features.md#z) [w](../../roadtorch/weights/cnn-7.md)"
    links = "x (`train/README.md`) [y](/how/features.md#z) [w](/reference/index.md#weights-cnn-7)"

    assert parts.linked(text + code, parts.DOCS / "how") == links + code


def test_cards_are_sections_of_the_page_of_weights() -> None:
    assert parts.cards(["cnn-7"]).startswith("(weights-cnn-7)=\n## cnn-7.safetensors\n")
    assert set(parts.CARDS) == {path.stem for path in ROOT.glob("roadtorch/weights/*.md")}


def test_docstrings_show_what_they_say() -> None:
    docstring = """Return |x|
of a *b*.

>>> 1
1

Args:
    one: a
        and c.
    two, three: d.

Returns:
    A mask,
    shape (H, W).

Raises:
    InputError: if wrong."""

    lines = [str(line) for line in docstring.split("\n")]
    assert as_restructured(lines) == [
        *("Return \\|x\\| of a \\*b\\*.", "", "::", "", "    >>> 1", "    1", ""),
        *(":param one: a and c.", ":param two: d.", ":param three: d.", ""),
        *(":returns: A mask, shape (H, W).", "", ":raises InputError: if wrong.", ""),
    ]


def test_the_page_on_fusion_states_the_size_of_the_network_and_the_formula_of_trust() -> None:
    page = (ROOT / "docs/how/fusion.md").read_text(encoding="utf-8")
    network = load_network(shipped_weights(DEFAULT_WEIGHTS))
    assert isinstance(network, BackboneNetwork)
    parts = network, network.backbone, network.head
    stated = [f"{sum(weight.numel() for weight in part.parameters()):,}" for part in parts]
    stability, expected, _ = trust.FEATURE_WEIGHTS

    stated += [f"({trust.INTERCEPT} + {stability}\\,s + {expected}\\,e\\bigr)"]
    stated += [f"{trust.ROAD_INTERCEPT} + {trust.ROAD_STABILITY}\\,s - {-trust.ROAD_ENTROPY}\\,h"]
    assert [text for text in stated if text not in page] == []


def test_hashes_of_weights_on_a_page_are_those_that_ship() -> None:
    page = (ROOT / "docs/installation.md").read_text(encoding="utf-8")
    stated = re.findall(r"(\S+)\.safetensors +SHA-256 (\w+)…", page)

    assert stated
    assert stated == [(name, file_digest(shipped_weights(name))[:12]) for name, _ in stated]


def test_the_images_were_made_with_the_weights_and_settings_that_ship() -> None:
    """Compare hashes; to make them anew: python scripts/readme_pictures.py DATA."""
    made = ROOT / "docs" / "pictures" / "made.json"
    assert json.loads(made.read_text(encoding="utf-8")) == made_with()
