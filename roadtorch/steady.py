"""Likelihoods of footage steadied over time: log odds carried along the motion of the picture.

A detector looks at each frame by itself; its likelihood wavers with noise and light. What the
frames before said about the same place of the street is carried there along dense flow and
averaged with what this frame says, in log odds: recursive Bayes, with the past raised to a power
so that all frames together count as one. A plain sum of log odds would take the same mistake of
a detector, made frame by frame, for ever stronger evidence. (Ours; averaging carried estimates:
Nilsson and Sminchisescu, Semantic Video Segmentation by Gated Recurrent Flow Propagation, CVPR
2018; the weights: a Kalman filter of a constant whose memory fades.)

Where the flow there and back does not agree, or the picture looks other than where it came from,
the past is believed less, down to not at all: turns and the edges of cars stay sharp.
"""

from typing import NamedTuple

import cv2
import torch
from pydantic import Field
from torch import Tensor

from roadtorch.fusion import log_odds
from roadtorch.motion import carried, dense_flow, round_trip, small_grey
from roadtorch.settings import Settings

AROUND = 5  # pixels at the flow's size over which differences of the picture are averaged


class SteadySettings(Settings):
    """How much a frame is told by those before it."""

    memory: float = Field(
        default=8.0, ge=0, le=1000, description="frames that the past counts as at the most"
    )
    width: int = Field(
        default=240, ge=16, le=4096, description="pixels: how wide pictures are for the flow"
    )
    agreement: float = Field(
        default=1.0, gt=0, le=100, description="pixels at that width by which a round trip may miss"
    )
    contrast: float = Field(
        default=0.1, gt=0, le=10, description="share of white by which a place may look different"
    )
    cut: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="share of the picture to be found again, else the scene was cut",
    )


class Past(NamedTuple):
    """What is known after a frame.

    grey: the frame, uint8 (h,w). odds: log odds of road, float32 (H,W). frames: how many frames
    they rest on, float32 (h,w).
    """

    grey: Tensor
    odds: Tensor
    frames: Tensor


class Steady:
    """The steadied likelihoods of one source, frame by frame, in their order."""

    def __init__(self, settings: SteadySettings) -> None:
        self.settings = settings
        self._past: Past | None = None

    def __call__(self, image: Tensor, likelihood: Tensor) -> Tensor:
        """The likelihood (H,W) of the next frame (3,H,W), both in [0,1], with what is known.

        The first frame's stays as it is; so does one of another size, which begins anew.
        """
        now = Past(small_grey(image, self.settings.width), log_odds(likelihood), torch.empty(0))
        self._past = recalled(self._past, now.grey, now.odds, self.settings)
        return self._past.odds.sigmoid()


def recalled(past: Past | None, grey: Tensor, odds: Tensor, settings: SteadySettings) -> Past:
    """What is known after a frame: grey uint8 (h,w) and log odds (H,W), after ``past``."""
    if past is None or past.odds.shape != odds.shape or past.grey.shape != grey.shape:
        return Past(grey, odds, torch.ones(grey.shape))
    flow = dense_flow(grey, past.grey)
    belief = believed(past.grey, grey, flow, settings)
    if belief.mean() < settings.cut:
        return Past(grey, odds, torch.ones(grey.shape))
    weight = carried(past.frames, flow).clamp_max(settings.memory) * belief
    return Past(grey, blended(carried(past.odds, flow), odds, weight), weight + 1)


def believed(before: Tensor, grey: Tensor, flow: Tensor, settings: SteadySettings) -> Tensor:
    """How far the past can be believed, float32 (h,w) in [0,1], for a flow from ``grey`` to it.

    before, grey: uint8 (h,w). 1 where the round trip closes and the place looks the same; outside
    the picture before 0. A change of light all over the picture is no difference.
    """
    missed = round_trip(flow, dense_flow(before, grey)) / settings.agreement
    change = grey.to(torch.float32) - carried(before.to(torch.float32), flow)
    change = (change - change.median()).abs() / 255
    around = torch.from_numpy(cv2.blur(change.numpy(), (AROUND, AROUND))) / settings.contrast
    return (-(missed.square() + around.square())).exp()


def blended(before: Tensor, now: Tensor, weight: Tensor) -> Tensor:
    """The mean of log odds (H,W), those before counting as ``weight`` (h,w) frames, these as one.

    The weight is brought to their size as a share.
    """
    height, width = now.shape
    share = (weight / (weight + 1)).numpy()
    larger = cv2.resize(share, (width, height), interpolation=cv2.INTER_LINEAR)
    return now + torch.from_numpy(larger) * (before - now)
