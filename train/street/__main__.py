"""Learn the networks of `fusion` on one GPU, in minutes: the recipes one after another.

    python -m train.street learn PACK --out RUNS --minutes 5.5
    python -m train.street learn PACK --out RUNS --device cpu --steps 900 --batch 32 --only streets
    python -m train.street mean 1:backbone-free 1:RUNS/tall.safetensors --size 224 256 --out MEAN

PACK is of ``train.street.pack``. After each run its weights, the losses and the scores of worlds
that no run learns from are written, so that a stopped command leaves finished runs.
"""

import argparse
import csv
import random
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.compute import keep_freed_memory
from roadtorch.layout.backbone_network import BackboneNetwork
from roadtorch.layout.classes import VERTICAL
from roadtorch.layout.weights import load_network, read_origin, save_network, weights_path
from roadtorch.train.config import Descent, HeadWeights
from roadtorch.train.teachers import TARGET_PLANES, Targets
from roadtorch.train.training_loop import MovingAverage
from roadtorch.train.whole_images import target_loss
from train.street.batches import Batch, Sampler
from train.street.pack import Pack, read_pack
from train.street.recipes import RECIPES, Recipe
from train.street.scores import KindScores, score_held_worlds

HEADS = HeadWeights(road=1.0, ego=2.0)

WARM_UP = 0.03
"""Fraction of a run over which the learning rate rises."""

EMA = 0.995
"""Decay of the moving average of the weights."""

LOG_STEPS = 20
"""Steps between two rows of losses, at which the program waits for the device."""


class Loss(NamedTuple):
    """Mean loss of the last steps of a run, after so many seconds and visits to an image."""

    seconds: float
    visits: int
    loss: float


# --- learning ---------------------------------------------------------------------------


def street_loss(network: BackboneNetwork, batch: Batch, recipe: Recipe) -> Tensor:
    """Compute the mean loss of a batch, of each head by itself."""
    features = network.backbone(batch.images)
    targets = Targets(*F.avg_pool2d(batch.planes, recipe.stride).split(TARGET_PLANES, 1))
    if recipe.border:
        vertical = targets.layout[:, VERTICAL : VERTICAL + 1] * targets.layout_weight
        nearby = [F.max_pool2d(mask, 3, 1, 1) for mask in (targets.road, vertical)]
        border = nearby[0] * nearby[1]
        gain = 1 + border * torch.where(batch.exact > 0, recipe.border, -1.0)
        targets = targets._replace(
            road_weight=targets.road_weight * gain, layout_weight=targets.layout_weight * gain
        )
    losses = []
    for head in network.heads:
        scores = F.interpolate(head(features).float(), targets.road.shape[-2:], mode="bilinear")
        losses.append(target_loss(scores, targets, HEADS) / len(scores))
    return torch.stack(losses).mean()


def learn_network(
    recipe: Recipe, sampler: Sampler, seconds: float, steps: int
) -> tuple[BackboneNetwork, list[Loss]]:
    """Train a network by a recipe for some seconds, or some steps if not 0.

    Returns the network with its averaged weights, and the losses.
    """
    network, choice = load_backbone(recipe.initial, sampler.device), random.Random(recipe.seed)
    network.to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    if recipe.frozen:
        for part in (network.backbone.stem, *network.backbone.blocks[: recipe.frozen]):
            part.requires_grad_(False)
    weights = [weight for weight in network.parameters() if weight.requires_grad]
    optimiser = torch.optim.AdamW(weights, weight_decay=0)
    for size in sorted(set(recipe.sizes)):  # kernels are chosen before the clock starts
        optimise(network, sampler.sample(size), recipe, optimiser, 0.0)
    average, losses = MovingAverage(network, EMA), list[Loss]()
    descent = Descent(learning_rate=recipe.learning_rate, schedule="cosine")
    recent, step, progress, start = list[Tensor](), 0, 0.0, time.monotonic()
    while progress < 1:
        batch = sampler.sample(choice.choice(recipe.sizes))
        rate = descent.learning_rate_at(progress) * min(1.0, (progress + 1e-3) / WARM_UP)
        recent.append(optimise(network, batch, recipe, optimiser, rate))
        step += 1
        average.update(network, step)
        if step % LOG_STEPS == 0 or steps:
            loss = float(torch.stack(recent).mean())
            seen = round(time.monotonic() - start, 2)
            losses.append(Loss(seen, step * sampler.batch, round(loss, 5)))
            recent.clear()
        progress = step / steps if steps else (time.monotonic() - start) / seconds
    learned = average.network.eval()
    learned.settings = learned.settings.model_copy(update={"upper_rows": recipe.upper[0]})
    return learned, losses


def load_backbone(name: str, device: torch.device) -> BackboneNetwork:
    """Load a backbone network, of a file or shipped, on a device."""
    network = load_network(weights_path(name))
    assert isinstance(network, BackboneNetwork)
    return network.to(device)


def optimise(
    network: BackboneNetwork,
    batch: Batch,
    recipe: Recipe,
    optimiser: torch.optim.Optimizer,
    rate: float,
) -> Tensor:
    """Take one step down the loss of a batch; return the loss."""
    for group in optimiser.param_groups:
        group["lr"] = rate
    optimiser.zero_grad()
    images = batch.images.contiguous(memory_format=torch.channels_last)
    is_cuda = images.is_cuda  # on a CPU a step in bfloat16 takes longer
    with torch.autocast(images.device.type, torch.bfloat16, enabled=is_cuda):
        loss = street_loss(network, batch._replace(images=images), recipe)
    loss.backward()
    optimiser.step()
    return loss.detach()


# --- commands ---------------------------------------------------------------------------


def write_rows(path: Path, run: str, rows: Sequence[Loss] | Sequence[KindScores]) -> None:
    """Append a run's rows to a CSV."""
    is_new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(["run", *rows[0]._fields])
        writer.writerows([run, *row] for row in rows)


def find_recipe(text: str) -> Recipe:
    """Return the recipe of NAME, or with another seed, and named so, of NAME-SEED."""
    name, _, seed = text.partition("-")
    recipe = next(recipe for recipe in RECIPES if recipe.name == name)
    return replace(recipe, name=text, seed=int(seed)) if seed else recipe


def learn(options: argparse.Namespace) -> None:
    """Run the recipes within the time, and write each one's weights, losses and scores."""
    keep_freed_memory()  # on a CPU two thirds of the time
    end, device = time.monotonic() + 60 * options.minutes, torch.device(options.device)
    torch.backends.cudnn.benchmark = True
    torch.set_float32_matmul_precision("high")
    pack = read_pack(options.pack)
    tensors = [maps.to(device) for maps in (pack.images, pack.maps, pack.known)]
    pack = Pack(pack.groups, pack.names, *tensors)
    print(len(pack.names), "images,", round(end - time.monotonic()), "seconds left", flush=True)
    options.out.mkdir(parents=True, exist_ok=True)
    held, recipes = options.out / "held.csv", options.only or RECIPES
    for initial in dict.fromkeys(recipe.initial for recipe in recipes):
        write_rows(held, initial, score_held_worlds(load_backbone(initial, device), pack))
    for number, recipe in enumerate(recipes):
        seconds = (end - time.monotonic()) / (len(recipes) - number) - options.reserve
        sampler = Sampler(pack, recipe, options.batch)
        network, losses = learn_network(recipe, sampler, seconds, options.steps)
        scores = score_held_worlds(network, pack)
        origin = {"recipe": asdict(recipe), "images": len(pack.names), **losses[-1]._asdict()}
        save_network(options.out / f"{recipe.name}.safetensors", network.cpu(), origin)
        write_rows(options.out / "losses.csv", recipe.name, losses)
        write_rows(held, recipe.name, scores)
        kinds = " ".join(f"{row.kind} {row.f:.3f}" for row in scores)
        print(recipe.name, losses[0].loss, losses[-1], kinds, flush=True)


def mean(options: argparse.Namespace) -> None:
    """Write the weighted mean of networks, of WEIGHT:FILE each, for inputs of a size and rows."""
    device, total, state = torch.device("cpu"), 0.0, dict[str, Tensor]()
    origin = dict[str, Any]()
    for part in options.parts:
        weight, _, file = part.partition(":")
        network, total = load_backbone(file, device), total + float(weight)
        origin[part] = read_origin(weights_path(file)).get("recipe", "at the commit before")
        for key, value in network.state_dict().items():
            state[key] = state.get(key, torch.zeros(())) + float(weight) * value.double()
    first = load_backbone(options.parts[0].partition(":")[2], device)
    first.load_state_dict({key: value / total for key, value in state.items()})
    update = {"height": options.size[0], "width": options.size[1], "upper_rows": options.upper_rows}
    first.settings = first.settings.model_copy(update=update)
    save_network(options.out, first, {"mean": origin})


def main() -> None:
    """Run a command of this script."""
    parser = argparse.ArgumentParser(description="Learn the networks of fusion on one GPU.")
    commands = parser.add_subparsers(required=True)
    learning = commands.add_parser("learn")
    learning.add_argument("pack", type=Path)
    learning.add_argument("--out", type=Path, required=True)
    learning.add_argument("--minutes", type=float, default=5.5, help="of all runs together")
    learning.add_argument("--reserve", type=float, default=6.0, help="seconds beside each run")
    learning.add_argument("--steps", type=int, default=0, help="of each run, in place of the time")
    learning.add_argument("--batch", type=int, default=128)
    learning.add_argument("--device", default="cuda")
    learning.add_argument("--only", nargs="*", type=find_recipe, metavar="NAME[-SEED]")
    learning.set_defaults(run=learn)
    averaging = commands.add_parser("mean")
    averaging.add_argument("parts", nargs="+", metavar="WEIGHT:FILE")
    averaging.add_argument("--size", type=int, nargs=2, required=True, metavar=("HEIGHT", "WIDTH"))
    averaging.add_argument("--upper-rows", type=float, default=0.0)
    averaging.add_argument("--out", type=Path, required=True)
    averaging.set_defaults(run=mean)
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
