"""A dictionary of patches learned from one image by K-means (P1, section II.B).

Patches are rows of matrices (n,d): n = one for every place, by rows of the image;
d = side·side·3, in the order of ``torch.nn.functional.unfold`` (channel, row, column).
"""

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings

BLOCK = 2048
"""Patches that are compared with all bases at a time: the products stay in the cache."""

NOISE = 0.1
"""Standard deviation of the bases from which K-means starts."""


class DictionarySettings(Settings):
    """Patches, whitening and K-means."""

    side: int = Field(default=6, ge=2, le=16, description="side of the patches, pixels")
    contrast: float = Field(
        default=10 / 255**2, gt=0, le=1, description="added to a patch's variance (range 0 to 1)"
    )
    whitening: float = Field(
        default=0.1, gt=0, le=100, description="added to the eigenvalues before whitening"
    )
    bases: int = Field(default=200, ge=1, le=1024, description="K, the bases of the dictionary")
    rounds: int = Field(default=10, ge=0, le=1000, description="updates of K-means")
    start: Literal["noise", "patches"] = Field(
        default="noise", description="what K-means starts from: small noise, or random patches"
    )
    random_seed: int = Field(
        default=0, ge=0, le=2**31, description="of the generator behind the start"
    )


def extract_patches(image: Tensor, side: int) -> Tensor:
    """Every patch (n,d) of an image (3,H,W); n = (H-side+1)·(W-side+1)."""
    windows = image.unfold(1, side, 1).unfold(2, side, 1)  # (3,rows,columns,side,side), a view
    return windows.permute(1, 2, 0, 3, 4).reshape(-1, len(image) * side**2)


def normalise_contrast(patches: Tensor, epsilon: float) -> Tensor:
    """Patches (n,d) less their mean, over sqrt(variance + epsilon); flat ones become 0.

    Mean and variance (d - 1) over all values of a patch, its three channels together
    (Coates et al. 2011, to which P1 refers).
    """
    values = patches.shape[1]
    share = (values - 1) / values  # layer_norm, which does it in one pass, divides by d
    scale = patches.new_full((values,), share**0.5)
    return F.layer_norm(patches, (values,), scale, eps=epsilon * share)


def zca_whitening(patches: Tensor, epsilon: float) -> tuple[Tensor, Tensor]:
    """ZCA whitening: the mean (d,) and the symmetric matrix (d,d) to apply behind it.

    V (D + epsilon)^-1/2 V^T with the eigenvalues D and eigenvectors V of the covariance
    (n - 1). The matrix is found in float64: a small thing, and it feeds everything else.
    """
    mean = patches.mean(0)
    centred = patches - mean
    covariance = (centred.T @ centred).double() / max(1, len(patches) - 1)
    values, vectors = torch.linalg.eigh(covariance)
    scale = (values.clamp_min(0) + epsilon).rsqrt()
    return mean, ((vectors * scale) @ vectors.T).to(patches)


def white_patches(image: Tensor, settings: DictionarySettings) -> Tensor:
    """Every patch (n,d) of an equalised image (3,H,W), contrast-normalised and whitened."""
    patches = normalise_contrast(extract_patches(image, settings.side), settings.contrast)
    mean, matrix = zca_whitening(patches, settings.whitening)
    return torch.addmm(-(mean @ matrix), patches, matrix)


def start_dictionary(patches: Tensor, settings: DictionarySettings) -> Tensor:
    """Bases (K,d) to start K-means from; the same ones for the same random seed."""
    generator = torch.Generator().manual_seed(settings.random_seed)
    if settings.start == "patches":
        drawn = torch.randint(len(patches), (settings.bases,), generator=generator)
        return patches[drawn.to(patches.device)]
    shape = (settings.bases, patches.shape[1])
    noise = torch.randn(shape, generator=generator, dtype=torch.float64)
    return (NOISE * noise).to(patches)


def assign(patches: Tensor, dictionary: Tensor) -> Tensor:
    """The nearest base of every patch, int64 (n,); of several, the first.

    The nearest base has the greatest x·c - c·c/2, so that one matrix product finds it.
    """
    half = dictionary.square().sum(1) / -2
    products = patches.new_empty(min(BLOCK, len(patches)), len(dictionary))  # the same for all
    blocks = []
    for block in patches.split(BLOCK):
        likeness = torch.mm(block, dictionary.T, out=products[: len(block)])
        likeness.add_(half)  # addmm would first write half everywhere
        blocks.append(torch.from_numpy(likeness.cpu().numpy().argmax(1)))  # seven times as fast
    return torch.cat(blocks).to(patches.device)


def update(patches: Tensor, dictionary: Tensor) -> tuple[Tensor, Tensor]:
    """Move each base to the mean of the patches nearest to it; to zero where it has none.

    One round of K-means: the new bases (K,d), and how many patches each had, int64 (K,).
    Zero bases stay in the game, as in the authors' program: they stand for patches
    without contrast.
    """
    nearest = assign(patches, dictionary)
    sums = torch.zeros_like(dictionary).index_add_(0, nearest, patches)
    counts = torch.bincount(nearest, minlength=len(dictionary))
    return sums / counts.clamp_min(1)[:, None], counts


def learn_dictionary(patches: Tensor, settings: DictionarySettings) -> Tensor:
    """The dictionary (K,d) of white patches (n,d), by the rounds of K-means (Lloyd)."""
    dictionary = start_dictionary(patches, settings)
    for _ in range(settings.rounds):
        dictionary, _ = update(patches, dictionary)
    return dictionary
