"""Texture orientation by Gabor filters: which way the texture of each pixel runs (Kong et al.).

Kong, Audibert, Ponce, "General road detection from a single image", IEEE TIP 19(8), 2010, which
P1 compares itself with. Angles are in degrees from 0 to 180, from the columns' axis towards the
rows' (clockwise in the picture): 0 runs along a row, 90 down a column.
"""

import math

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional as F

from roadtorch.settings import Settings

OCTAVES = 2.2
"""c of Kong et al.: waves in the envelope; 2.2 is a spatial bandwidth of 1.7 octaves."""

MARGIN = 24
"""Pixels of mirrored picture on each side, so that one edge does not answer to the other."""

FIRST, LAST = 4, 15
"""The responses, by falling size, whose mean is held against the greatest one."""

MIN_RESPONSE = 1e-6
"""The least squared response, of a grey from 0 to 1: below it there is only rounding."""


class GaborBank(Settings):
    """The filters. Kong et al. write of five scales of the frequencies 2.1·2^k.

    We take 2.1/2^k, waves of 3, 6 and 12 pixels: the others would be shorter than a pixel; and of
    24 and 48 pixels, whose responses are so great that they alone would decide.
    """

    orientations: int = Field(default=36, ge=16, le=180, description="evenly spread over 180°")
    scales: int = Field(default=3, ge=1, le=8, description="each of twice the wavelength before")
    frequency: float = Field(
        default=2.1, gt=0, le=math.pi, description="of the finest scale, radians a pixel"
    )


def filter_spectrum(size: tuple[int, int], angle: float, frequency: float) -> Tensor:
    """The Fourier transform (H,W) of the Gabor filter whose waves run at an angle in degrees.

    Kong et al.: w/(sqrt(2 pi) c) exp(-w²(4a² + b²)/(8c²)) (exp(iwa) - exp(-c²/2)), with a
    along the waves and b across; it is real, and 0 where the frequency is 0.
    """
    down = 2 * math.pi * torch.fft.fftfreq(size[0])[:, None]
    right = 2 * math.pi * torch.fft.fftfreq(size[1])
    turn = math.radians(angle)
    along = right * math.cos(turn) + down * math.sin(turn)
    across = down * math.cos(turn) - right * math.sin(turn)
    width = OCTAVES / frequency
    wave = (-((width * (along - frequency)) ** 2) / 2).exp()
    level = (-((width * along) ** 2 + OCTAVES**2) / 2).exp()
    gain = 2 * math.sqrt(2 * math.pi) * width
    return gain * (-((2 * width * across) ** 2) / 2).exp() * (wave - level)


def gabor_responses(grey: Tensor, bank: GaborBank) -> Tensor:
    """Squared magnitudes of the responses, mean over the scales: (orientations,H,W).

    grey: (H,W). The i-th is that of texture that runs at i·180/orientations degrees.
    """
    height, width = grey.shape
    margin = min(MARGIN, height - 1, width - 1)
    padded = F.pad(grey[None, None], (margin,) * 4, mode="reflect")[0, 0]
    spectrum = torch.fft.fft2(padded)
    size = (padded.shape[0], padded.shape[1])
    responses = []
    for step in range(bank.orientations):
        waves = 180 * step / bank.orientations + 90  # they run across the texture
        power = torch.zeros_like(padded)
        for scale in range(bank.scales):
            gabor = filter_spectrum(size, waves, bank.frequency / 2**scale).to(padded)
            power += torch.fft.ifft2(spectrum * gabor).abs().square()
        responses.append(power[margin : margin + height, margin : margin + width] / bank.scales)
    return torch.stack(responses)


def dominant_orientation(responses: Tensor) -> tuple[Tensor, Tensor]:
    """The orientation (H,W) in degrees of the greatest response, and its confidence in [0,1].

    Confidence: 1 - mean(r5 … r15)/r1 of the responses by falling size (Kong et al.),
    scaled so that it spans [0,1] in the picture; 0 throughout where there is no texture.
    """
    falling = responses.sort(0, descending=True).values
    top = falling[0].clamp_min(torch.finfo(falling.dtype).tiny)
    sure = (1 - falling[FIRST:LAST].mean(0) / top).where(falling[0] > MIN_RESPONSE, 0)
    low, high = sure.aminmax()
    angle = responses.argmax(0) * (180 / len(responses))
    return angle.to(responses), (sure - low) / torch.where(high > low, high - low, 1)
