"""P1, Figs. 1 to 3: the stages, what preprocessing evens out, and eq. 3 against eq. 4."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor

from roadtorch.data.catalogue import open_dataset
from roadtorch.data.dataset import Truth
from roadtorch.evaluation.metrics import Decisions, count_mask, f_measure, precision, recall
from roadtorch.ufl.features import white_patches
from roadtorch.ufl.maps import make_encoder, to_unit
from roadtorch.ufl.pictures import dictionary_picture
from scripts.figures_p1_overlay import agreement
from scripts.figures_p1_pictures import (
    example,
    learned,
    panels,
    program_cues,
    put,
    save,
    small,
)

PATCH = 12
"""Side of the road patches of Fig. 2, pixels of 160x120."""

SCORED = 12
"""Pictures on which eqs. 3 and 4 are scored."""


def figure1(data: Path, out: Path) -> None:
    """The framework: preprocessing, dictionary, maps, tree, regions, road."""
    image, truth = example(data)
    cues = program_cues(image)
    shown = {
        "picture": image,
        "blurred and equalised": cues["equalised"],
        "dictionary, best base first": cues["dictionary"],
        "selected feature maps": cues["selected_maps"],
        "their mean": cues["mean_map"],
        "thresholds survived": cues["tree_levels"],
        "stability of the selected nodes": cues["node_stability"],
        "road: yellow, red too much, green missed": agreement(image, cues["iteration_2"], truth),
    }
    figure, axes = panels(len(shown), 4)
    for panel, (title, picture) in zip(axes, shown.items(), strict=True):
        put(panel, title, picture)
    save(figure, out / "p1-fig1.png")


# --- Fig. 2 -----------------------------------------------------------------------------


def road_patches(truth: Truth, count: int, side: int = PATCH) -> list[tuple[int, int]]:
    """Upper left corners of squares that are road throughout, from the farthest to the nearest.

    truth: of a picture. Raises ValueError where no square of that side fits.
    """
    from torch.nn.functional import avg_pool2d

    fits = avg_pool2d((truth.road & truth.valid).float()[None], side, 1)[0] == 1
    rows = fits.any(1).nonzero()[:, 0]
    if not len(rows):
        raise ValueError(f"no road of {side}x{side} pixels")
    chosen = rows[torch.linspace(0, len(rows) - 1, count).round().long()].tolist()
    corners = []
    for row in chosen:
        columns = fits[row].nonzero()[:, 0]
        corners.append((row, int(columns[len(columns) // 2])))
    return corners


def unevenness(image: Tensor, corners: Sequence[tuple[int, int]]) -> tuple[float, float]:
    """How far patches differ in brightness, and how far their textures do: both over the mean.

    The deviation of the patches' means, and of the deviations inside of them, divided by the
    mean brightness of all. image: (3,H,W).
    """
    patches = torch.stack([cut(image, corner).mean(0) for corner in corners])
    level = patches.mean()
    inside = patches.flatten(1).std(1)
    return float(patches.mean((1, 2)).std() / level), float(inside.std() / level)


def cut(image: Tensor, corner: tuple[int, int]) -> Tensor:
    """The patch (3,side,side) of an image at its upper left corner."""
    row, column = corner
    return image[:, row : row + PATCH, column : column + PATCH]


def figure2(data: Path, out: Path) -> None:
    """Road patches, far to near, without and after preprocessing."""
    image, truth = example(data)
    pictures = {"without preprocessing": image, "after": learned(image)[0].even}
    corners = road_patches(truth, 4)
    figure, axes = panels(10, 5, 2.4)
    for start, (title, picture) in zip((0, 5), pictures.items(), strict=True):
        put(axes[start], title, picture / picture.amax())
        for number, corner in enumerate(corners, 1):
            put(axes[start + number], f"patch {number}", cut(picture / picture.amax(), corner))
            axes[start].text(corner[1], corner[0], str(number), color="red", fontsize=9)
        brightness, texture = unevenness(picture, corners)
        print(f"{title:22} brightness differs by {brightness:.3f}, texture by {texture:.4f}")
    save(figure, out / "p1-fig2.png")


# --- Fig. 3 -----------------------------------------------------------------------------


def encoded(image: Tensor, kind: str) -> tuple[Tensor, Tensor, Tensor]:
    """All maps (K,h,w) in [0,1] of eq. 3 (``patch``) or 4 (``base``), order and dictionary."""
    found, settings = learned(image, maps={"encoder": kind})
    patches = white_patches(found.even, settings.dictionary)
    encode = make_encoder(patches, found.dictionary, settings.maps.encoder)
    side = settings.dictionary.side
    size = (image.shape[1] - side + 1, image.shape[2] - side + 1)
    return to_unit(encode(found.dictionary)).view(-1, *size), found.maps.order, found.dictionary


def zero_share(maps: Tensor) -> float:
    """The share of pixels at which a map of (K,h,w) is 0, mean over the maps."""
    return float((maps == 0).float().mean())


def encoder_scores(
    pictures: Sequence[tuple[Tensor, Truth]], kinds: Sequence[str] = ("patch", "base")
) -> dict[str, Decisions]:
    """Counts of the program's masks with eq. 3 and eq. 4, pooled over pictures and truth."""
    found: dict[str, Decisions] = {}
    for kind in kinds:
        for image, truth in pictures:
            mask = program_cues(image, maps={"encoder": kind})["iteration_2"]
            counts = count_mask(mask, truth.road, truth.valid)
            found[kind] = found[kind] + counts if kind in found else counts
    return found


def figure3(data: Path, out: Path) -> None:
    """Dictionary, maps of four bases by eq. 3 and by eq. 4, and what each equation scores."""
    image, _ = example(data)
    by_patch, _, _ = encoded(image, "patch")
    by_base, order, dictionary = encoded(image, "base")
    ranks = [0, len(order) // 3, 2 * len(order) // 3, len(order) - 1]
    figure, axes = panels(10, 5, 2.6)
    side = round((dictionary.shape[1] / 3) ** 0.5)
    plain = dictionary_picture(dictionary, torch.arange(len(order)), side, (115, 155))
    put(axes[0], "dictionary (a)", plain)
    put(axes[5], "by score, eq. 5 (c)", dictionary_picture(dictionary, order, side, (115, 155)))
    for place, rank in enumerate(ranks, 1):
        base = int(order[rank])
        put(axes[place], f"rank {rank + 1}, eq. 3 (b)", by_patch[base])
        put(axes[place + 5], f"rank {rank + 1}, eq. 4 (b)", by_base[base])
    save(figure, out / "p1-fig3.png")
    shares = " ".join(f"{zero_share(maps):.2f}" for maps in (by_patch, by_base))
    print(f"share of zeros in a map, eqs. 3 and 4: {shares}")
    val = open_dataset("camvid", data / "camvid", "val")
    step = max(1, len(val.items) // SCORED)
    scored = encoder_scores([small(*val.read(item)) for item in val.items[::step]])
    for equation, counts in zip(("eq. 3", "eq. 4"), scored.values(), strict=True):
        figures = (precision(counts), recall(counts), f_measure(counts))
        print(equation, "P R F", " ".join(f"{float(one):.3f}" for one in figures))


FIGURES: Mapping[str, Callable[[Path, Path], None]] = {
    "p1-fig1": figure1,
    "p1-fig2": figure2,
    "p1-fig3": figure3,
}
