"""Dictionary of patches learned from one image by K-means (P1, section II.B).

Patches are the rows of matrices (n, d): one for each position, in row-major order, with d =
side·side·3 values in the order of ``torch.nn.functional.unfold`` (channel, row, column).
"""

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.base.settings import Settings

PATCH_BLOCK = 2048
"""Patches compared with all bases at a time: the products stay in the CPU's cache."""

INITIAL_NOISE = 0.1  # standard deviation of the initial bases of K-means


class DictionarySettings(Settings):
    """Settings of patches, whitening and K-means."""

    side: int = Field(default=6, ge=2, le=16, description="side of a patch, pixels")
    contrast: float = Field(
        default=10 / 255**2, gt=0, le=1, description="added to a patch's variance (levels 0 to 1)"
    )
    whitening: float = Field(
        default=0.1, gt=0, le=100, description="constant added to the eigenvalues in whitening"
    )
    bases: int = Field(default=200, ge=1, le=1024, description="K, the number of bases")
    rounds: int = Field(default=10, ge=0, le=1000, description="rounds of K-means")
    random_seed: int = Field(default=0, ge=0, le=2**31, description="seed of the initial bases")


def extract_patches(image: Tensor, side: int) -> Tensor:
    """Return all patches (n, d) of an image (3, H, W); n = (H - side + 1)·(W - side + 1)."""
    windows = image.unfold(1, side, 1).unfold(2, side, 1)  # (3,rows,columns,side,side), a view
    return windows.permute(1, 2, 0, 3, 4).reshape(-1, len(image) * side**2)


def normalise_contrast(patches: Tensor, epsilon: float) -> Tensor:
    """Return patches (n, d) minus their mean, over sqrt(variance + epsilon); flat ones are 0.

    Mean and variance (divisor d - 1) are over all values of a patch, its three channels together
    (Coates et al. 2011, to which P1 refers).
    """
    values = patches.shape[1]
    ratio = (values - 1) / values  # layer_norm, which needs one pass, divides by d
    scale = patches.new_full((values,), ratio**0.5)
    return F.layer_norm(patches, (values,), scale, eps=epsilon * ratio)


def zca_whitening(patches: Tensor, epsilon: float) -> tuple[Tensor, Tensor]:
    """Return the mean (d,) and the symmetric matrix (d, d) of ZCA whitening of patches (n, d).

    V (D + epsilon)^-1/2 V^T, with eigenvalues D and eigenvectors V of the covariance (divisor n-1).
    In float64: it is small, and everything else depends on it.
    """
    mean = patches.mean(0)
    centred = patches - mean
    covariance = (centred.T @ centred).double() / max(1, len(patches) - 1)
    values, vectors = torch.linalg.eigh(covariance)
    scale = (values.clamp_min(0) + epsilon).rsqrt()
    return mean, ((vectors * scale) @ vectors.T).to(patches)


def whiten_patches(image: Tensor, settings: DictionarySettings) -> Tensor:
    """Return all patches (n, d) of an equalised image (3, H, W), normalised and whitened."""
    patches = normalise_contrast(extract_patches(image, settings.side), settings.contrast)
    mean, matrix = zca_whitening(patches, settings.whitening)
    return torch.addmm(-(mean @ matrix), patches, matrix)


def initial_dictionary(patches: Tensor, settings: DictionarySettings) -> Tensor:
    """Return initial bases (K, d) for K-means; equal seeds give equal bases."""
    generator = torch.Generator().manual_seed(settings.random_seed)
    shape = (settings.bases, patches.shape[1])
    noise = torch.randn(shape, generator=generator, dtype=torch.float64)
    return (INITIAL_NOISE * noise).to(patches)


def assign_patches(patches: Tensor, dictionary: Tensor) -> Tensor:
    """Return the nearest base of each patch, int64 (n,); of equally near ones the first.

    The nearest base maximises x·c - c·c/2, so that one matrix product finds it.
    """
    half = dictionary.square().sum(1) / -2
    products = patches.new_empty(min(PATCH_BLOCK, len(patches)), len(dictionary))  # reused
    blocks = []
    for block in patches.split(PATCH_BLOCK):
        likeness = torch.mm(block, dictionary.T, out=products[: len(block)])
        likeness.add_(half)  # addmm would write ``half`` first
        blocks.append(torch.from_numpy(likeness.cpu().numpy().argmax(1)))  # 7 times faster
    return torch.cat(blocks).to(patches.device)


def update_dictionary(patches: Tensor, dictionary: Tensor) -> tuple[Tensor, Tensor]:
    """Run one round of K-means: return the means (K, d) of each base's patches, and their counts.

    Bases without patches become zero and stay, as in the authors' program: they represent patches
    without contrast.
    """
    nearest = assign_patches(patches, dictionary)
    sums = torch.zeros_like(dictionary).index_add_(0, nearest, patches)
    counts = torch.bincount(nearest, minlength=len(dictionary))
    return sums / counts.clamp_min(1)[:, None], counts


def learn_dictionary(patches: Tensor, settings: DictionarySettings) -> Tensor:
    """Learn the dictionary (K, d) of white patches (n, d) by K-means (Lloyd)."""
    dictionary = initial_dictionary(patches, settings)
    for _ in range(settings.rounds):
        dictionary, _ = update_dictionary(patches, dictionary)
    return dictionary
