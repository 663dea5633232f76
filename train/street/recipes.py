"""Recipes of runs, and their hypotheses, written before they run. Each gets the same time.

The runs start from what ships, so that their weights can be averaged, and each differs from an
earlier one by one change.
"""

from dataclasses import dataclass, replace

from roadtorch.layout.backbone_network import LITE0, make_blocks
from train.street.pack import REAL, SIMULATED

SHIPPED_SIZES = ((128, 160), (192, 256), (256, 320))
"""Sizes of configs/backbone-free.toml, as near as they are."""

LARGE_SIZES = ((192, 256), (192, 256), (256, 352), (288, 384))

TALL_SIZES = ((192, 256), (224, 256), (224, 256), (288, 320))

ALL_KINDS, STREETS, PHOTOGRAPHED = "set", "streets", "photo"
"""Folders of worlds: of all kinds (30000 and on), streets framed anew (40000 and on), and these
streets with photographs of ground, walls and skies."""


@dataclass(frozen=True)
class Recipe:
    """What a run learns from, and how.

    groups: fractions of a batch by group of the pack; those that the pack lacks leave their part to
    the others. sizes: of the network's input, one sampled for each batch. border: weight added to
    pixels where road meets something vertical; if it is not 0, machine labels teach nothing there.
    stride: of the pixels on which the loss is computed, in pixels of the input. margin: least
    |2p - 1| for a machine-labelled pixel's road target p to count. dim: fraction of a batch that is
    underexposed. frozen: first blocks of the backbone that do not learn. upper: fractions
    of the rows that show the upper part of the images (``resize_rows``; 0: all rows are alike), one
    sampled for each batch.
    """

    name: str
    hypothesis: str
    groups: dict[str, float]
    initial: str = "backbone-free"
    sizes: tuple[tuple[int, int], ...] = SHIPPED_SIZES
    border: float = 0.0
    stride: int = 4
    margin: float = 0.1
    dim: float = 0.0
    learning_rate: float = 4e-4
    frozen: int = 0
    upper: tuple[float, ...] = (0.0,)
    seed: int = 0


CONTROL = Recipe(
    "control",
    "the recipe that shipped, ten times as long, on 619 real images: F within .004 of what ships",
    {REAL: 0.5, ALL_KINDS: 0.4, SIMULATED: 0.1},
)
FRAMED = replace(
    CONTROL,
    name="streets",
    hypothesis="streets framed anew, and dim images: the wrong halves shrink, nights gain",
    groups={REAL: 0.5, ALL_KINDS: 0.3, STREETS: 0.15, SIMULATED: 0.05},
    dim=0.15,
)
THIN = replace(
    FRAMED,
    name="thin",
    hypothesis="borders weigh where truth is exact, and nowhere else; the loss at half the size: "
    "less of what stands on the road is road",
    border=3.0,
    stride=2,
)
LOW = replace(
    THIN,
    name="low",
    hypothesis="the upper three tenths at a sixth of the rows: towns gain, as they do without any "
    "learning (+.005 to +.020; many .898 for .903), and trails do not lose once it is learned",
    groups={REAL: 0.6, ALL_KINDS: 0.25, STREETS: 0.1, SIMULATED: 0.05},
    upper=(1 / 6, 1 / 6, 0.0),
    learning_rate=3e-4,
    frozen=2,
)
TALL = replace(
    LOW,
    name="tall",
    hypothesis="learned at the taller sizes at which what ships is better anyhow (224x256 for "
    "192x256: many .905 for .910): towns and dusk gain further, trails do not lose",
    sizes=TALL_SIZES,
    upper=(0.21, 0.21, 0.0),
)
HEADS = replace(
    THIN,
    name="heads",
    hypothesis="rendered-free's three heads, on worlds varied anew at every visit, gain alone, and "
    "fusion:large with them",
    initial="rendered-free",
    groups={ALL_KINDS: 0.6, STREETS: 0.3, SIMULATED: 0.1},
    sizes=TALL_SIZES,
    frozen=len(make_blocks(LITE0)),
    learning_rate=1e-3,
)
RECIPES = (
    TALL,
    replace(
        TALL,
        name="photo",
        hypothesis="streets with photographs in place of those without: pavements are told apart",
        groups={REAL: 0.6, ALL_KINDS: 0.25, PHOTOGRAPHED: 0.1, SIMULATED: 0.05},
    ),
    HEADS,
    replace(
        HEADS,
        name="photoheads",
        hypothesis="half of the streets with photographs: heads that know no real image gain most",
        groups={ALL_KINDS: 0.6, STREETS: 0.15, PHOTOGRAPHED: 0.15, SIMULATED: 0.1},
    ),
    replace(
        HEADS, name="unweighed", hypothesis="borders that weigh nothing: heads lose", border=0.0
    ),
    LOW,
    THIN,
    replace(
        THIN,
        name="doubt",
        hypothesis="what the teacher doubts on real images teaches nothing: halves gain further",
        margin=0.6,
        seed=1,
    ),
    replace(
        THIN,
        name="sizes",
        hypothesis="learned at up to 288x384: thin things, and the crops of fusion:large, gain",
        sizes=LARGE_SIZES,
    ),
    FRAMED,
    CONTROL,
)
"""In the order in which they run: the last two are there to compare with."""
