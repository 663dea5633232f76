"""Likelihoods of footage steadied over time: log odds carried along the motion of the image.

A detector looks at each frame by itself; its likelihood wavers with noise and light. What the
frames before said about the same place of the street is carried there along dense flow and
averaged with what this frame says, in log odds: recursive Bayes, with the past raised to a power
so that all frames together count as one. A plain sum of log odds would take the same mistake of
a detector, made frame by frame, for ever stronger evidence. (Ours; averaging carried estimates:
Nilsson and Sminchisescu, Semantic Video Segmentation by Gated Recurrent Flow Propagation, CVPR
2018; the weights: a Kalman filter of a constant whose memory fades.)

Where the flow there and back does not agree, or the image looks other than where it came from,
the past is believed less, down to not at all: turns and the edges of cars stay sharp.

An ego car stands still in the image. What a frame alone takes for one, a shadow close to the
camera for instance, hides nothing: there what was known before is carried on.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.base.settings import Settings
from roadtorch.imaging.motion import FAST, dense_flow, flow_image, forward_backward_error, warp
from roadtorch.imaging.resize import resized, size_of
from roadtorch.road.fusion import log_odds

AROUND = 5  # pixels at the flow's size over which differences of the image are averaged


class SteadySettings(Settings):
    """How much a frame is told by those before it."""

    memory: float = Field(
        default=8.0, ge=0, le=1000, description="frames that the past counts as at the most"
    )
    width: int = Field(
        default=320, ge=32, le=4096, description="pixels: how wide images are for the flow"
    )
    miss: float = Field(
        default=4.0, gt=0, le=100, description="pixels at that width by which a round trip may miss"
    )
    slack: float = Field(
        default=0.2, ge=0, le=10, description="share of the motion by which it may miss besides"
    )
    contrast: float = Field(
        default=0.2, gt=0, le=10, description="share of white by which a place may look different"
    )
    cut: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="share of the image to be found again, else the scene was cut",
    )
    standing: float = Field(
        default=30.0,
        ge=1,
        le=10_000,
        description="frames, in half of which at the least an ego car is found at the same pixel",
    )


class Past(NamedTuple):
    """What is known after a frame.

    grey: the frame, uint8 (h,w). odds: log odds of road, float32 (H,W). frames: how many frames
    they rest on, float32 (h,w).
    """

    grey: Tensor
    odds: Tensor
    frames: Tensor


class Standing(NamedTuple):
    """In what share of the last frames a pixel of the image was hidden, (H,W), and their count.

    What moves with the street stands nowhere for long.
    """

    share: Tensor
    frames: float

    @property
    def hidden(self) -> Tensor:
        """What an ego car hides, bool (H,W)."""
        return self.share >= 0.5


class Steady:
    """The steadied likelihoods of one source, frame by frame, in their order."""

    def __init__(self, settings: SteadySettings) -> None:
        self.settings = settings
        self._past: Past | None = None
        self._standing: Standing | None = None

    @property
    def hidden(self) -> Tensor | None:
        """What the ego car hides, as the frames so far agree: bool (H,W); None before the first."""
        return None if self._standing is None else self._standing.hidden

    def __call__(self, image: Tensor, likelihood: Tensor, hidden: Tensor | None = None) -> Tensor:
        """The likelihood (H,W) of the next frame (3,H,W), both in [0,1], with what is known.

        hidden: where the frame says nothing about the street, bool (H,W): the ego car as it was
        found. Where the frames agree on it, the likelihood becomes 0. The first frame's stays as
        it is; so does that of a frame of another size, which begins anew.
        """
        if hidden is None:
            hidden = torch.zeros(likelihood.shape, dtype=torch.bool)
        self._standing = stood(self._standing, hidden, self.settings.standing)
        grey, unseen = flow_image(image, self.settings.width), hidden | self._standing.hidden
        self._past = recalled(self._past, grey, log_odds(likelihood), unseen, self.settings)
        return self._past.odds.sigmoid().masked_fill(self._standing.hidden, 0.0)


def stood(before: Standing | None, hidden: Tensor, most: float) -> Standing:
    """What stands still in the image after one more frame hides bool (H,W)."""
    now = hidden.to(torch.float32)
    if before is None or before.share.shape != now.shape:
        return Standing(now, 1.0)
    frames = min(before.frames + 1, most)
    return Standing(before.share + (now - before.share) / frames, frames)


def recalled(
    past: Past | None, grey: Tensor, odds: Tensor, hidden: Tensor, settings: SteadySettings
) -> Past:
    """What is known after a frame, from what was known before it.

    grey: the frame, uint8 (h,w); odds: its log odds (H,W); hidden: what it hides, bool (H,W).
    """
    height, width = grey.shape
    covered = hidden.to(torch.float32).numpy()
    fresh = 1 - torch.from_numpy(cv2.resize(covered, (width, height), interpolation=cv2.INTER_AREA))
    begun = Past(grey, odds, fresh)
    if past is None or past.odds.shape != odds.shape or past.grey.shape != grey.shape:
        return begun
    flow = dense_flow(grey, past.grey, FAST)
    belief = flow_confidence(past.grey, grey, flow, settings)
    if belief.mean() < settings.cut:
        return begun
    weight = warp(past.frames, flow).clamp_max(settings.memory) * belief
    before = warp(past.odds, flow)
    now = odds.where(~hidden, before)
    # The mean of both, which count as so many frames.
    share = (weight / (weight + fresh).clamp_min(1e-6)).numpy()
    larger = cv2.resize(share, now.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return Past(grey, now + torch.from_numpy(larger) * (before - now), weight + fresh)


def smoothed(
    greys: Sequence[Tensor], odds: Sequence[Tensor], settings: SteadySettings
) -> list[Tensor]:
    """Log odds (H,W) of road of each frame of footage by all frames, before and after it.

    greys: the frames in order, uint8 (h,w); odds: what each says by itself. Two filters, one from
    either end, meet at every frame, whose own odds both hold and count once (Fraser and Potter,
    The optimum linear smoother as a combination of two optimum linear filters, 1969).
    """
    before = _filtered(greys, odds, settings)
    after = _filtered(greys[::-1], odds[::-1], settings)[::-1]
    return [
        (past.frames * past.odds + future.frames * future.odds - own)
        / (past.frames + future.frames - 1).clamp_min(1.0)
        for past, future, own in zip(before, after, odds, strict=True)
    ]


def _filtered(
    greys: Sequence[Tensor], odds: Sequence[Tensor], settings: SteadySettings
) -> list[Past]:
    """What is known after each frame, its ``frames`` at the size of the odds."""
    past, known = None, list[Past]()
    for grey, own in zip(greys, odds, strict=True):
        past = recalled(past, grey, own, torch.zeros_like(own, dtype=torch.bool), settings)
        known.append(past._replace(frames=resized(past.frames[None], size_of(own))[0]))
    return known


def flow_confidence(before: Tensor, grey: Tensor, flow: Tensor, settings: SteadySettings) -> Tensor:
    """How far the past can be believed, float32 (h,w) in [0,1], for a flow from ``grey`` to it.

    before, grey: uint8 (h,w). 1 where the round trip closes and the place looks the same; outside
    the image before 0. Round trips may miss by more where motion is fast (Sundaram et al., ECCV
    2010, eq. 5). A change of light all over the image is no difference.
    """
    allowed = settings.miss + settings.slack * torch.hypot(flow[..., 0], flow[..., 1])
    missed = forward_backward_error(flow, dense_flow(before, grey, FAST)) / allowed
    change = grey.to(torch.float32) - warp(before.to(torch.float32), flow)
    change = np.abs((change - change.median()).numpy()) / 255
    around = torch.from_numpy(cv2.blur(change, (AROUND, AROUND))) / settings.contrast
    return (-(missed.square() + around.square())).exp()
