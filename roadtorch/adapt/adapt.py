"""A whole adaptation: frames, camera, two networks from the halves, their mean, a verdict. Ours.

Each half of the footage teaches a network of its own and says how bold that should be; it is judged
on the half that it has not seen. The network that comes out is the mean of both: networks that
begin alike and learn a little lie in one valley (Wortsman et al., Model soups, ICML 2022).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from roadtorch.adapt.frames import HALVES, KeptFrames, keep_frames
from roadtorch.adapt.teacher import write_taught
from roadtorch.adapt.verdict import Verdict, fitted_bias, judged_half, unknown, verdict_of
from roadtorch.camera.footage import StillError, camera_of
from roadtorch.errors import InputError
from roadtorch.io.atomic import write_text
from roadtorch.layout.picture_network import ROAD
from roadtorch.layout.weights import (
    WholePictureNetwork,
    load_network,
    read_origin,
    save_network,
    weights_path,
)
from roadtorch.sources.frame import spread
from roadtorch.train.config import PictureTraining
from roadtorch.train.corrections import card_of, corrections_behind
from roadtorch.train.folder import CHECKPOINT, WEIGHTS, RunFolder
from roadtorch.train.recordings import MAX_FRAMES
from roadtorch.train.run import Outcome, Request, train

CAMERA, FRAMES, LOOKS, PREPARED = "camera.toml", "frames", "looks", "prepared"
CALIBRATED = "calibrated.safetensors"
"""Of each half: what it learned, as bold as the teacher."""


@dataclass(frozen=True)
class Adapted:
    """What an adaptation came to.

    outcome: the weights, or the signal that cut it short. camera: its file, None where there is
    none. missing: what could not be had of the footage, and why, a line each.
    """

    outcome: Outcome
    frames: KeptFrames
    camera: Path | None
    missing: tuple[str, ...]
    verdict: Verdict | None = None

    @property
    def prepared(self) -> Path:
        """The folder of the frames made ready."""
        return self.frames.folder.with_name(PREPARED)


def adapt(
    inputs: Sequence[str], out: Path, training: PictureTraining, most: int, quiet: bool = False
) -> Adapted:
    """Adapt the network that ``training`` starts from to footage; results in the folder ``out``.

    A run that was cut short goes on. Raises InputError for footage with fewer than two frames,
    ConfigError where ``out`` holds another run.
    """
    with RunFolder(out).held():
        return _adapt(inputs, out, training, most, quiet)


def _adapt(
    inputs: Sequence[str], out: Path, training: PictureTraining, most: int, quiet: bool
) -> Adapted:
    """The same in a folder that is held."""
    frames = keep_frames(inputs, out / FRAMES, most, quiet)
    problem = _camera_problem(frames, out / CAMERA, inputs[0])
    camera = None if problem else out / CAMERA
    missing = [f"no {CAMERA}: {problem.where} {problem.what}"] if problem else []
    if not frames.moving:
        missing.append("pictures have no times: they are taken in the order of their names")
    if stopped := write_taught(frames, out / LOOKS, out / PREPARED, training, quiet):
        return Adapted(Outcome(None, stopped, 0), frames, camera, tuple(missing))
    outcomes = []
    for half in HALVES:
        folder = out / half
        resume = (folder / CHECKPOINT).exists()
        request = Request(frames.glob(half), folder, resume, out / PREPARED, quiet)
        outcomes.append(train(training, request))
        if outcomes[-1].interrupted:
            return Adapted(outcomes[-1], frames, camera, tuple(missing))
    files = [out / half / CALIBRATED for half in HALVES]
    for half, file in zip(HALVES, files, strict=True):
        learned = file.with_name(WEIGHTS)
        bias = fitted_bias(frames.pictures(half), learned, out / PREPARED, training, quiet)
        write_shifted(learned, file, bias)
    mean_network(files, out / WEIGHTS, {**read_origin(files[0]), "pictures": frames.count})
    if behind := corrections_behind(training):
        write_text((out / WEIGHTS).with_suffix(".md"), card_of(behind))
    rows = [
        {**row, "round": at + 1}
        for at, half in enumerate(HALVES)
        for row in RunFolder(out / half).read_log()
    ]
    RunFolder(out).write_log(rows)
    before = weights_path(training.start)
    outcome = Outcome(out / WEIGHTS, None, sum(each.skipped for each in outcomes))
    if isinstance(problem, StillError):
        verdict = unknown("the footage stands still: both halves show the same", frames.count)
        return Adapted(outcome, frames, camera, tuple(missing), verdict)
    judged = []
    for half, other in zip(HALVES, reversed(files), strict=True):
        weights = (before, other, out / WEIGHTS)
        pictures = frames.pictures(half)
        judged.append(judged_half(pictures, weights, out / PREPARED, training, quiet))
    return Adapted(outcome, frames, camera, tuple(missing), verdict_of(judged))


def mean_network(files: Sequence[Path], path: Path, origin: Mapping[str, Any]) -> None:
    """Write the network whose weights are the means of those of files of one kind."""
    networks = [load_network(file) for file in files]
    mean = {
        name: torch.stack([one.state_dict()[name].float() for one in networks]).mean(0).to(value)
        for name, value in networks[0].state_dict().items()
    }
    networks[0].load_state_dict(mean)
    save_network(path, networks[0], origin)


def write_shifted(learned: Path, file: Path, bias: float) -> None:
    """Write a network with so much more log odds of road everywhere."""
    network = load_network(learned)
    assert isinstance(network, WholePictureNetwork)
    with torch.no_grad():
        for layer in network.last_layers():
            assert layer.bias is not None
            layer.bias[ROAD] += bias
    save_network(file, network, read_origin(learned))


def _camera_problem(frames: KeptFrames, file: Path, where: str) -> InputError | None:
    """Write the file of the camera; why there is none, where there is none."""
    some = spread(frames.pictures(), MAX_FRAMES)
    try:
        camera_of((one.read() for one in some), where).write(file)
    except InputError as problem:
        return problem
    return None
