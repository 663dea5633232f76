"""Corrections of people in training: what they said is the truth, machine labels fill the rest."""

import json
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from roadtorch.data.correction_labels import NOT_ROAD, ROAD_SAID, VOID_SAID
from roadtorch.data.corrections import Correction
from roadtorch.data.labelme import picture_size
from roadtorch.errors import InputError
from roadtorch.imaging.resize import at_picture_size
from roadtorch.io.atomic import make_folder, write_text
from roadtorch.layout.classes import CLASSES, UNLABELLED
from roadtorch.layout.weights import people_behind, weights_path
from roadtorch.settings import toml_lines
from roadtorch.sources.pictures import Picture
from roadtorch.train.config import Descent, PictureTraining, Training
from roadtorch.train.prepared import Arrays, name_of, to_bytes, write_arrays
from roadtorch.train.teachers import Targets

HALF = 0.5
"""Share of a cell's pixels that have to be said before the cell counts as said."""

SPACING = 8
"""Pixels, at working size, between the patches that are taken where people spoke: as far apart as
superpixels are."""

# --- which ------------------------------------------------------------------------------


def corrections_by_picture(
    pictures: Sequence[Picture], corrections: Iterable[Correction]
) -> dict[str, Correction]:
    """The correction of each picture that has one, by the picture's name with ending.

    Raises InputError where none of them is of these pictures, or one has another size by now.
    """
    given = list(corrections)
    by_path = {one.picture.resolve(): one for one in given}
    found = {}
    for picture in pictures:
        if (one := by_path.get(picture.path.resolve())) is not None:
            if picture_size(picture.path) != one.labels.shape:
                what = "has another size than when it was corrected"
                raise InputError(picture.path, what, "give the pictures that were corrected")
            found[name_of(picture)] = one
    if given and not found:
        what = f"and {len(given) - 1} others are corrected, and none of them is among --images"
        raise InputError(given[0].picture, what, "give the pictures that were corrected")
    return found


def corrections_summary(corrections: Mapping[str, Correction]) -> dict[str, Any] | None:
    """What is kept of the corrections that a run uses; None without any.

    pictures, people and pixels: how many. sha256: of all that was said.
    """
    if not corrections:
        return None
    digest = sha256()
    for name, one in sorted(corrections.items()):
        digest.update(json.dumps([name, one.labels.shape]).encode())
        digest.update(np.ascontiguousarray(one.labels).tobytes())
    return {
        "pictures": len(corrections),
        "people": len({user for one in corrections.values() for user in one.users}),
        "pixels": sum(int((one.labels > 0).sum()) for one in corrections.values()),
        "sha256": digest.hexdigest(),
    }


def paced(descent: Descent, halfway: float, pictures: int) -> Descent:
    """The descent for so many corrected pictures (none: as it is). Ours.

    The learning rate is that of very many times n / (n + halfway): a few pictures that are unlike
    what comes do less harm, and twenty are learned from in as many steps.
    """
    if not pictures:
        return descent
    rate = descent.learning_rate * pictures / (pictures + halfway)
    return descent.model_copy(update={"learning_rate": rate})


def write_corrections(
    folder: Path, files: Mapping[Path, Correction], shrink: Callable[[Correction], Arrays]
) -> dict[Path, Path]:
    """Write what training needs of the corrections; the written file of each prepared one.

    shrink: what that is of one, at the size at which the network works.
    """
    make_folder(folder)
    written = {file: folder / f"{number:06d}.npz" for number, file in enumerate(sorted(files))}
    for file, path in written.items():
        write_arrays(path, shrink(files[file]))
    return written


# --- whole pictures ---------------------------------------------------------------------


def correction_planes(correction: Correction, size: tuple[int, int]) -> Arrays:
    """``planes``, uint8 (6,h,w) as 255ths: shares of a cell's pixels that people called so.

    Road, not road, void; sky, vertical, horizontal.
    """
    road, layout = torch.from_numpy(correction.road), torch.from_numpy(correction.layout)
    planes = [road == value for value in (ROAD_SAID, NOT_ROAD, VOID_SAID)]
    planes += [layout == number for number in range(CLASSES)]
    return {"planes": to_bytes(adaptive_avg_pool2d(torch.stack(planes).to(torch.float32), size))}


def corrected_targets(targets: Targets, planes: Tensor, weight: float) -> Targets:
    """Targets in which what people said replaces the machine's.

    planes: (B,6,H,W) of ``correction_planes``. Where they are void, neither counts; where they
    are road there is no ego car.
    """
    road, other, void, layout = planes.split((1, 1, 1, CLASSES), 1)
    known, left_out = road + other >= HALF, void > HALF
    share = road / (road + other).clamp_min(1e-6)
    layout_share = layout.sum(1, keepdim=True)
    layout_known, no_ego = layout_share >= HALF, road >= HALF

    def weighed(own: Tensor, where: Tensor) -> Tensor:
        return torch.where(where, weight, own).masked_fill(left_out, 0)

    return Targets(
        torch.where(layout_known, layout / layout_share.clamp_min(1e-6), targets.layout),
        weighed(targets.layout_weight, layout_known),
        torch.where(known, share, targets.road),
        weighed(targets.road_weight, known),
        torch.where(no_ego, 0, targets.ego),
        torch.where(no_ego, weight, targets.ego_weight),
    )


def corrected_shares(shares: Tensor, corrected: Tensor, share: float) -> Tensor:
    """Shares (n,) of visits of which the corrected pictures, bool (n,), get ``share`` together.

    Unchanged where all pictures are corrected, or none.
    """
    if not corrected.any() or corrected.all():
        return shares
    own, others = shares[corrected].sum(), shares[~corrected].sum()
    return torch.where(corrected, shares * (share / own), shares * ((1 - share) / others))


# --- patches ----------------------------------------------------------------------------


class LabelledCentres(NamedTuple):
    """Where patches are taken: centres int16 (n,2), classes uint8 (n,), weights float32 (n,)."""

    centres: Tensor
    classes: Tensor
    weights: Tensor


def correction_layout(correction: Correction, size: tuple[int, int]) -> Arrays:
    """``layout``, uint8 (h,w): 0, 1, 2, 255 not said; ``known``: 1 where no machine label counts.

    Who says void, or "not road", says nothing of the layout; void counts as known all the same.
    """
    layout = at_picture_size(torch.from_numpy(correction.layout), size)
    void = at_picture_size(torch.from_numpy(correction.road == VOID_SAID), size)
    return {"layout": layout, "known": ((layout != UNLABELLED) | void).to(torch.uint8)}


def corrected_centres(
    labelled: LabelledCentres, correction: Arrays, weight: float
) -> LabelledCentres:
    """The machine's where nobody spoke, and a grid of places where somebody named a class."""
    layout, known = correction["layout"], correction["known"].bool()
    rows, columns = labelled.centres.long().unbind(1)
    kept = ~known[rows, columns]
    places = torch.zeros_like(known)
    places[SPACING // 2 :: SPACING, SPACING // 2 :: SPACING] = True
    new = (places & (layout != UNLABELLED)).nonzero()
    classes = layout[new[:, 0], new[:, 1]].to(labelled.classes.dtype)
    return LabelledCentres(
        torch.cat([labelled.centres[kept], new.to(labelled.centres.dtype)]),
        torch.cat([labelled.classes[kept], classes]),
        torch.cat([labelled.weights[kept], torch.full((len(new),), weight)]),
    )


def repeated(files: Sequence[Path], corrected: Container[Path], share: float) -> list[Path]:
    """The files, corrected ones so often that they are about ``share`` of all, once at least."""
    own = [file for file in files if file in corrected]
    others = len(files) - len(own)
    if not own or not others or share == 1:
        return own if own and share == 1 else list(files)
    times = max(1, round(share * others / ((1 - share) * len(own))))
    return [file for file in files for _ in range(times if file in corrected else 1)]


# --- what fusion makes of the weights ---------------------------------------------------


def write_corrected(path: Path, weights: Path, corrections: Sequence[Correction]) -> bool:
    """Write a file for ``--config``: ``fusion`` with these weights.

    By true labels 0 are the log odds that part road from background, not the usual centre.
    False, and nothing written, where people called no pixel road or not road.
    """
    roads = [one.road for one in corrections]
    if not any(((road == ROAD_SAID) | (road == NOT_ROAD)).any() for road in roads):
        return False
    lines = [
        f"# From {len(corrections)} pictures that people corrected: not label-free.",
        'detector = "fusion"',
        *toml_lines({"weights": {"file": str(weights.resolve())}, "calibration": {"centre": 0.0}}),
    ]
    write_text(path, "\n".join([*lines, ""]))
    return True


# --- what the weights say of them -------------------------------------------------------


def corrections_behind(training: Training) -> list[Mapping[str, Any]]:
    """The corrections behind what a training begins with: its start, and its teacher's weights.

    WeightsError for a weight file that cannot be used.
    """
    names = [training.start]
    if isinstance(training, PictureTraining):
        names.append(training.teacher.weights)
    found = [one for name in names if name for one in people_behind(weights_path(name))]
    return [one for number, one in enumerate(found) if one not in found[:number]]


def card_of(behind: Sequence[Mapping[str, Any]]) -> str:
    """The card beside weights that were trained with corrections of people."""
    lines = [
        "# Weights trained with corrections of people",
        "",
        "People corrected machine labels, and what they said counted as the truth. What is found",
        "with these weights is **not label-free**, and is not to be reported as such.",
        "",
        "| pictures | people | pixels | sha256 of what was said |",
        "|---|---|---|---|",
    ]
    keys = ("pictures", "people", "pixels", "sha256")
    lines += ["| " + " | ".join(str(one.get(key, "")) for key in keys) + " |" for one in behind]
    return "\n".join([*lines, ""])
