"""Temporal smoothing of likelihoods: log odds warped along optical flow and averaged.

A detector analyses each frame by itself, so its likelihood flickers with noise and light. The log
odds of the frames before are warped along dense optical flow and averaged with those of this
frame; a sum would count a mistake repeated in every frame as ever stronger evidence. (Ours;
averaging warped estimates: Nilsson and Sminchisescu, Semantic Video Segmentation by Gated Recurrent
Flow Propagation, CVPR 2018; the weights: a Kalman filter of a constant with fading memory.)

Where forward and backward flow disagree, or the image changes along the flow, the past counts less,
down to nothing. An ego car is static in the image: where less than half of the last frames have it,
such as at a shadow close to the camera, the warped log odds of the past are kept.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import Tensor

from roadtorch.imaging.motion import dense_flow, flow_image, forward_backward_error, warp
from roadtorch.imaging.resize import resize_maps, spatial_size
from roadtorch.road.bayes import log_odds

BLUR_SIDE = 5  # pixels at the flow's size over which differences of the image are averaged


class TemporalFilterSettings(NamedTuple):
    """Settings of temporal smoothing."""

    memory: float = 8.0  # largest weight of the past, in frames
    width: int = 320  # width in pixels at which optical flow is computed
    flow_error: float = 4.0  # tolerated forward-backward flow error, pixels
    relative_flow_error: float = 0.2  # further tolerated error, as a fraction of the motion
    contrast: float = 0.2  # tolerated change of brightness, 1 being white
    min_confidence: float = 0.25  # mean flow confidence below which a cut is assumed
    ego_frames: float = 30.0  # frames over which the ego car is averaged


class Motion(NamedTuple):
    """Motion of a frame, which needs neither the likelihood nor earlier frames.

    previous, grey: the frame before and the frame, uint8 (h, w). flow: from the frame to the one
    before, float32 (h, w, 2). confidence: in the flow, see ``flow_confidence``, float32 (h, w).
    """

    previous: Tensor
    grey: Tensor
    flow: Tensor
    confidence: Tensor


class FilterState(NamedTuple):
    """State of the filter after a frame.

    grey: the frame, uint8 (h, w). odds: smoothed log odds of road, float32 (H, W). frames: weight
    of ``odds`` as a number of frames, float32 (h, w).
    """

    grey: Tensor
    odds: Tensor
    frames: Tensor


class EgoHistory(NamedTuple):
    """Fraction of the last frames in which the ego car hid each pixel, (H, W), and their count."""

    fraction: Tensor
    frames: float

    @property
    def hidden(self) -> Tensor:
        """Pixels hidden by the ego car, bool (H, W)."""
        return self.fraction >= 0.5


class TemporalFilter:
    """Temporal filter of the likelihoods of one source, called frame by frame in order."""

    def __init__(self, settings: TemporalFilterSettings) -> None:
        self.settings = settings
        self._state: FilterState | None = None
        self._ego: EgoHistory | None = None

    @property
    def hidden(self) -> Tensor | None:
        """Ego car in half of the frames so far, bool (H, W); None before the first frame."""
        return None if self._ego is None else self._ego.hidden

    def __call__(
        self,
        image: Tensor,
        likelihood: Tensor,
        hidden: Tensor | None = None,
        motion: Motion | None = None,
    ) -> Tensor:
        """Return the smoothed likelihood (H, W) of the next frame, an image (3, H, W) in [0, 1].

        likelihood: of this frame alone, (H, W). hidden: its ego car, bool (H, W); the result is 0
        where half of the last frames have one. A frame of another size restarts the filter.
        motion: see ``update_state``.
        """
        if hidden is None:
            hidden = torch.zeros(likelihood.shape, dtype=torch.bool)
        self._ego = update_ego(self._ego, hidden, self.settings.ego_frames)
        grey = flow_image(image, self.settings.width) if motion is None else motion.grey
        odds, ego = log_odds(likelihood), self._ego.hidden
        self._state = update_state(self._state, grey, odds, hidden | ego, self.settings, motion)
        return self._state.odds.sigmoid().masked_fill_(ego, 0.0)


def update_ego(history: EgoHistory | None, hidden: Tensor, max_frames: float) -> EgoHistory:
    """Update the running mean of the ego car by one more frame's, bool (H, W)."""
    current = hidden.to(torch.float32)
    if history is None or history.fraction.shape != current.shape:
        return EgoHistory(current, 1.0)
    frames = min(history.frames + 1, max_frames)
    current.sub_(history.fraction).div_(frames).add_(history.fraction)  # its running mean
    return EgoHistory(current, frames)


def update_state(
    past: FilterState | None,
    grey: Tensor,
    odds: Tensor,
    hidden: Tensor,
    settings: TemporalFilterSettings,
    motion: Motion | None = None,
) -> FilterState:
    """Update the state of the filter by a frame, grey uint8 (h, w), with its log odds (H, W).

    hidden: pixels without evidence, bool (H, W). A cut or another size starts anew. motion: of the
    frame, by ``estimate_motion``; estimated here where it starts at a frame other than the past's.
    """
    height, width = grey.shape
    covered = hidden.to(torch.float32).numpy()
    fresh = 1 - torch.from_numpy(cv2.resize(covered, (width, height), interpolation=cv2.INTER_AREA))
    initial = FilterState(grey, odds, fresh)
    if past is None or past.odds.shape != odds.shape or past.grey.shape != grey.shape:
        return initial
    if motion is None or not torch.equal(motion.previous, past.grey):
        motion = estimate_motion(past.grey, grey, settings)
    flow, confidence = motion.flow, motion.confidence
    if confidence.mean() < settings.min_confidence:
        return initial
    weight = warp(past.frames, flow).clamp_max(settings.memory) * confidence
    warped = warp(past.odds, flow)
    current = warped.where(hidden, odds)
    # Mean of both, weighted by their numbers of frames.
    ratio = (weight / (weight + fresh).clamp_min(1e-6)).numpy()
    larger = cv2.resize(ratio, current.shape[::-1], interpolation=cv2.INTER_LINEAR)
    smooth = warped.sub_(current).mul_(torch.from_numpy(larger)).add_(current)
    return FilterState(grey, smooth, weight + fresh)


def smooth_log_odds(
    greys: Sequence[Tensor], odds: Sequence[Tensor], settings: TemporalFilterSettings
) -> list[Tensor]:
    """Smooth the log odds (H, W) of frames, uint8 (h, w), by the frames before and after each.

    A forward and a backward filter are averaged at every frame; its log odds, which are in both,
    count once (Fraser and Potter, The optimum linear smoother as a combination of two optimum
    linear filters, 1969).
    """
    forward = _filter_states(greys, odds, settings)
    backward = _filter_states(greys[::-1], odds[::-1], settings)[::-1]
    return [
        (past.frames * past.odds + future.frames * future.odds - frame)
        / (past.frames + future.frames - 1).clamp_min(1.0)
        for past, future, frame in zip(forward, backward, odds, strict=True)
    ]


def _filter_states(
    greys: Sequence[Tensor], odds: Sequence[Tensor], settings: TemporalFilterSettings
) -> list[FilterState]:
    """Return the filter's state after each frame, its ``frames`` at the size of the odds."""
    state, states = None, list[FilterState]()
    for grey, frame in zip(greys, odds, strict=True):
        hidden = torch.zeros_like(frame, dtype=torch.bool)
        state = update_state(state, grey, frame, hidden, settings)
        frames = resize_maps(state.frames[None], spatial_size(frame))[0]
        states.append(state._replace(frames=frames))
    return states


def estimate_motion(previous: Tensor, grey: Tensor, settings: TemporalFilterSettings) -> Motion:
    """Estimate the motion from a frame to the previous one, both uint8 (h, w), with confidence."""
    flow = dense_flow(grey, previous)
    return Motion(previous, grey, flow, flow_confidence(previous, grey, flow, settings))


def flow_confidence(
    previous: Tensor, grey: Tensor, flow: Tensor, settings: TemporalFilterSettings
) -> Tensor:
    """Compute the confidence, float32 (h, w) in [0, 1], in a flow from a frame to the previous one.

    1 where forward and backward flow agree and the brightness is unchanged but for its median, 0
    outside the previous frame. The tolerance grows with the motion (Sundaram et al., ECCV 2010,
    eq. 5). Frames: uint8 (h, w).
    """
    motion = torch.hypot(flow[..., 0], flow[..., 1])
    tolerance = settings.flow_error + settings.relative_flow_error * motion
    error = forward_backward_error(flow, dense_flow(previous, grey)) / tolerance
    change = grey.to(torch.float32) - warp(previous.to(torch.float32), flow)
    change = np.abs((change - change.median()).numpy()) / 255
    blurred = torch.from_numpy(cv2.blur(change, (BLUR_SIDE, BLUR_SIDE))) / settings.contrast
    return (-(error.square() + blurred.square())).exp()
