"""Whole pictures with machine-made maps, varied in light and frame; training in rounds. Ours."""

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F
from tqdm import tqdm

from roadtorch.detector import Detector
from roadtorch.detectors.catalogue import load_detector
from roadtorch.errors import ConfigError
from roadtorch.files import make_folder
from roadtorch.layout.classes import CLASSES
from roadtorch.layout.normalisation import Normalisation, normalise
from roadtorch.layout.picture_network import OUTPUTS, PictureNetwork, potentials_of
from roadtorch.train.config import Light, PictureTraining, Rounds, Shift, Teacher
from roadtorch.train.draws import generator_at, uniform
from roadtorch.train.prepared import (
    Arrays,
    Workshop,
    from_bytes,
    read_arrays,
    to_bytes,
    write_arrays,
)
from roadtorch.train.samples import Batch
from roadtorch.train.team import Team
from roadtorch.working_size import resized

ORDER, VARIATION = 3, 4
"""What is drawn; the numbers go on from those of patches."""

DARKEST = 1e-4
"""Pixels count as at least this bright: a power of 0 has no slope."""


# --- from pictures to maps ------------------------------------------------------------------


def prepare_picture(
    image: Tensor, teachers: Sequence[Detector], training: PictureTraining
) -> Arrays:
    """What training needs of an image (3,H,W), at the network's size.

    image: uint8 (3,h,w). maps: uint8 (4,h,w), what the teacher says: sky, vertical,
    horizontal, road, as 255ths. Raises ConfigError for a teacher without a layout.
    """
    size = (training.network.height, training.network.width)
    maps = teacher_maps(image, teachers, training.teacher.views)
    return {
        "image": to_bytes(resized(image, size).clamp(0, 1)),
        "maps": to_bytes(resized(maps, size).clamp(0, 1)),
    }


def load_teachers(teacher: Teacher) -> list[Detector]:
    """The detectors that make the labels together: one, or one for each size.

    Raises ConfigError for a wrong name or a detector without a working size.
    """
    sizes = [teacher.working.pixels]
    if teacher.views == "scaled":
        sizes.append(teacher.working.pixels // 2)
    own: dict[str, Any] = {"weights": {"file": teacher.weights}} if teacher.weights else {}
    return [load_detector(teacher.detector, working={"pixels": size}, **own) for size in sizes]


def teacher_maps(image: Tensor, teachers: Sequence[Detector], views: str = "one") -> Tensor:
    """Layout and road (4,H,W) in [0,1] of an image (3,H,W): the mean over all teachers.

    views: "one", or another word for the mean with the mirror image.
    """
    found = [_look(teacher, image) for teacher in teachers]
    if views != "one":
        found += [_look(teacher, image.flip(-1)).flip(-1) for teacher in teachers]
    return torch.stack(found).mean(0)


def _look(teacher: Detector, image: Tensor) -> Tensor:
    found = teacher.detect(image)
    if "layout" not in found.cues:
        what = f"{teacher.name} has no layout among its cues"
        raise ConfigError("teacher.detector", what, "use fusion or labeller")
    return torch.cat([found.cues["layout"], found.likelihood[None]])


def label_again(
    files: Sequence[Path], folder: Path, network: PictureNetwork, workshop: Workshop
) -> list[Path]:
    """What a network says of prepared pictures, the mean with their mirror images, on disk.

    One file a picture, in the order of ``files``; those that exist are kept. Stops early
    when asked to.
    """
    team = workshop.team
    names = [folder / f"{number:06d}.npz" for number in range(len(files))]
    make_folder(folder)
    pairs = team.share(list(zip(files, names, strict=True)))
    hidden = team.hides_bar(workshop.quiet)
    for file, name in tqdm(pairs, "labels again", unit="image", disable=hidden, file=sys.stderr):
        if workshop.stop.asked:
            break
        if not name.exists():
            image = from_bytes(read_arrays(file, "image")["image"])
            write_arrays(name, {"maps": to_bytes(both_ways(network, image))})
    team.gather(None)  # nobody reads before all have written
    return names


@torch.no_grad()
def both_ways(network: PictureNetwork, image: Tensor) -> Tensor:
    """Potentials (4,h,w) of a picture at the network's size: mean with its mirror image."""
    pixels = normalise(image, network.settings.normalisation).pixels
    found = potentials_of(network(torch.stack([pixels, pixels.flip(-1)])))
    return (found[0] + found[1].flip(-1)) / 2


# --- targets --------------------------------------------------------------------------------


class Goals(NamedTuple):
    """What a network should say, and where it counts. In [0,1].

    layout: (B,3,H,W); layout_weight, road, road_weight: (B,1,H,W).
    """

    layout: Tensor
    layout_weight: Tensor
    road: Tensor
    road_weight: Tensor


def goals_of(teacher: Tensor, network: Tensor | None, settings: Teacher, rounds: Rounds) -> Goals:
    """Goals from the maps (B,4,H,W) of the teacher and, from round 2 on, of the last network.

    The road's likelihood is moved so that ``road_threshold`` becomes 0.5. A pixel counts where
    the best class leads by ``margin``; with agreement, only where both name the same class, or
    both say road, or both say no road.
    """
    layout, road = teacher[:, :CLASSES], centred(teacher[:, CLASSES:], settings.road_threshold)
    agree = agree_road = torch.ones_like(road)
    if network is not None:
        other, other_road = network[:, :CLASSES], network[:, CLASSES:]
        if rounds.combine == "agreement":
            agree = (layout.argmax(1, True) == other.argmax(1, True)).to(road)
            agree_road = ((road >= 0.5) == (other_road >= 0.5)).to(road)
        own = {"network": 0.0, "teacher": 1.0}.get(rounds.combine, 0.5)
        layout, road = torch.lerp(other, layout, own), torch.lerp(other_road, road, own)
    best = layout.topk(2, dim=1).values
    sure = (best[:, :1] - best[:, 1:] >= settings.margin).to(road)
    sure_road = ((2 * road - 1).abs() >= settings.road_margin).to(road)
    return Goals(layout, sure * agree, road, sure_road * agree_road)


def centred(likelihood: Tensor, threshold: float) -> Tensor:
    """Likelihoods in [0,1] whose odds are divided by those of the threshold."""
    yes, no = likelihood * (1 - threshold), (1 - likelihood) * threshold
    return yes / (yes + no)


def goal_error(scores: Tensor, goals: Goals, road_weight: float) -> Tensor:
    """Cross-entropy of scores (B,4,H,W), summed over pictures, mean over all their pixels."""
    layout = -(goals.layout * scores[:, :CLASSES].log_softmax(1)).sum(1, keepdim=True)
    road = F.binary_cross_entropy_with_logits(scores[:, CLASSES:], goals.road, reduction="none")
    error = layout * goals.layout_weight + road_weight * road * goals.road_weight
    return error.mean((1, 2, 3)).sum()


# --- variation ------------------------------------------------------------------------------


def draw_frames(count: int, size: tuple[int, int], shift: Shift, at: torch.Generator) -> Tensor:
    """Affine maps (n,2,3) from a varied frame to the picture's, both from -1 to 1."""
    mirror = torch.randint(2, (count,), generator=at) * 2 - 1
    zoom = torch.exp(uniform(at, count, -shift.scale, shift.scale))
    width = zoom * torch.exp(uniform(at, count, -shift.stretch, shift.stretch))
    angle = uniform(at, count, -shift.rotation, shift.rotation) * (math.pi / 180)
    move = [uniform(at, count, -2 * shift.move, 2 * shift.move) for _ in range(2)]
    cos, sin, aspect = angle.cos(), angle.sin(), size[1] / size[0]
    across = torch.stack([mirror * cos / width, -sin / (zoom * aspect), move[0]], 1)
    down = torch.stack([mirror * sin * aspect / width, cos / zoom, move[1]], 1)
    return torch.stack([across, down], 1)


def reframed(maps: Tensor, frames: Tensor, outside: str) -> Tensor:
    """Maps (n,C,H,W) seen in other frames (n,2,3); outside: "border" or "zeros"."""
    grid = F.affine_grid(frames, list(maps.shape), align_corners=False)
    return F.grid_sample(maps, grid, padding_mode=outside, align_corners=False)


def relit(images: Tensor, light: Light, at: torch.Generator) -> Tensor:
    """Images (n,3,H,W) in [0,1] in another light, as another sensor would see them."""
    count = len(images)
    exponent = torch.exp(uniform(at, count, -light.gamma, light.gamma))
    gain = torch.exp(uniform(at, count, -light.gain, light.gain))
    tint = torch.exp(uniform(at, 3 * count, -light.tint, light.tint)).reshape(count, 3)
    colour = uniform(at, count, 1 - light.saturation, 1 + light.saturation)
    noise = uniform(at, count, 0, light.noise / 255)
    each = (count, 1, 1, 1)
    varied = images.clamp_min(DARKEST).pow(exponent.reshape(each))
    varied = torch.lerp(varied.mean(1, keepdim=True), varied, colour.reshape(each))
    varied = varied * (gain[:, None] * tint)[:, :, None, None]
    grain = torch.randn(images.shape, generator=at) * noise.reshape(each)
    return (varied + grain).clamp(0, 1)


def normalised(images: Tensor, normalisation: Normalisation) -> Tensor:
    """Images (n,3,H,W), each normalised as the network does it."""
    return torch.stack([normalise(image, normalisation).pixels for image in images])


# --- samples --------------------------------------------------------------------------------


class PictureSamples:
    """Prepared pictures in varied batches; a chunk is one batch.

    files: image and teacher's maps; again: the last network's maps, from round 2 on.
    """

    def __init__(
        self,
        files: Sequence[Path],
        again: Sequence[Path],
        number: int,
        training: PictureTraining,
        team: Team,
    ) -> None:
        self._files, self._again, self._round = files, again, number
        self._training, self._team = training, team

    @property
    def chunks(self) -> int:
        """Batches of one epoch."""
        return max(1, round(len(self._files) / self._training.descent.batch))

    def batches(self, epoch: int, chunk: int) -> Iterator[Batch]:
        """This process's pictures of one batch. Targets are the ``Goals``, six planes.

        All processes draw the variation of all pictures, and each takes its own.
        """
        training, place = self._training, (self._round, epoch)
        order = torch.randperm(
            len(self._files), generator=generator_at(training.seed, ORDER, *place)
        )
        members = order.tensor_split(self.chunks)[chunk].tolist()
        size = (training.network.height, training.network.width)
        generator = generator_at(training.seed, VARIATION, *place, chunk)
        frames = draw_frames(len(members), size, training.shift, generator)
        seeds = torch.randint(2**62, (len(members),), generator=generator).tolist()
        mine = self._team.share(range(len(members)))
        parts = [self._one(members[i], frames[i : i + 1], seeds[i]) for i in mine]
        if parts:
            images, goals = (torch.cat(maps) for maps in zip(*parts, strict=True))
        else:
            images, goals = torch.empty(0, 3, *size), torch.empty(0, OUTPUTS + 2, *size)
        yield Batch(images, goals, torch.ones(len(images)), len(members))

    def _one(self, member: int, frame: Tensor, seed: int) -> tuple[Tensor, Tensor]:
        """One varied picture (1,3,H,W), normalised, and its goals (1,6,H,W)."""
        training = self._training
        arrays = read_arrays(self._files[member], "image", "maps")
        arrays = {name: from_bytes(values)[None] for name, values in arrays.items()}
        network = None
        if self._again:
            network = from_bytes(read_arrays(self._again[member], "maps")["maps"])[None]
        goals = goals_of(arrays["maps"], network, training.teacher, training.rounds)
        seen = reframed(torch.cat(goals, 1), frame, "zeros")
        image = reframed(arrays["image"], frame, "border")
        image = relit(image, training.light, torch.Generator().manual_seed(seed))
        return normalised(image, training.network.normalisation), seen


class PictureError:
    """The error function of one training: goals as they are, or hardened to one class."""

    def __init__(self, training: PictureTraining) -> None:
        self._targets = training.teacher.targets
        self._road_weight = training.road_weight

    def __call__(self, network: nn.Module, batch: Batch) -> Tensor:
        """Sum over the batch's pictures of their mean error."""
        goals = Goals(*batch.targets.split([CLASSES, 1, 1, 1], 1))
        if self._targets == "hard":
            best = F.one_hot(goals.layout.argmax(1), CLASSES).permute(0, 3, 1, 2)
            road = (goals.road >= 0.5).to(goals.road)
            goals = goals._replace(layout=best.to(goals.layout), road=road)
        return goal_error(network(batch.inputs), goals, self._road_weight)
