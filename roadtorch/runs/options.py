"""What a user may say of a run: which detector, on which frames, computed with what."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roadtorch.camera.camera import Camera
    from roadtorch.detector import Detector
    from roadtorch.settings import Settings

DEFAULT_DETECTOR = "fusion"


@dataclass(frozen=True)
class DetectorOptions:
    """Which detector, and its settings.

    detector: its name. assignments: KEY=VALUE each. config: a TOML file.
    """

    detector: str | None = None
    assignments: tuple[str, ...] = ()
    config: Path | None = None

    def named(self, threshold: float | None = None) -> tuple[str, dict[str, Any]]:
        """The detector's name and the values of its settings.

        The file's values yield to the assignments, and those to ``threshold``. The file may name
        the detector under ``detector``. Raises ConfigError for what is no setting or no file.
        """
        from roadtorch.errors import ConfigError
        from roadtorch.settings import merge, parse_assignments, read_settings_file

        values = read_settings_file(self.config) if self.config else {}
        named = values.pop("detector", DEFAULT_DETECTOR)
        if not isinstance(named, str):
            raise ConfigError("detector", f"{named!r} was given", "give a name in quotes")
        values = merge(values, parse_assignments(self.assignments))
        if threshold is not None:
            values["threshold"] = threshold
        return self.detector or named, values

    def loaded(
        self, camera: Path | None = None, threshold: float | None = None
    ) -> "tuple[Detector, Camera | None]":
        """The detector, and the camera that a file describes, which its settings then know.

        Raises what ``named``, ``Camera.read`` and ``load_detector`` raise.
        """
        from roadtorch.camera.camera import Camera
        from roadtorch.detectors.catalogue import load_detector

        name, values = self.named(threshold)
        known = None if camera is None else Camera.read(camera)
        return load_detector(name, camera=known, **values), known


def as_toml(detector: str, settings: "Settings") -> str:
    """A file for ``--config`` that gives this detector with these settings."""
    from roadtorch.settings import toml_lines

    return "\n".join([f"detector = {json.dumps(detector)}", *toml_lines(settings.model_dump())])


@dataclass(frozen=True)
class FrameSelection:
    """Which frames and pictures of the inputs are looked at.

    every, start, end, limit: see ``roadtorch.sources.frame.Selection``. topic: of bags. patience:
    seconds within which a stream has to answer.
    """

    every: int
    start: float
    end: float | None
    limit: int | None
    topic: str | None
    patience: float


@dataclass(frozen=True)
class ComputeOptions:
    """With what the pictures of a run are worked on.

    jobs: pictures at a time on this machine; None for one a processor. engine: ``local`` or
    ``ray``. address: of a Ray cluster; None for one of this machine. workers: actors. threads: of
    torch and OpenCV within a picture. device: of torch. fail_fast: end at the first failure.
    """

    jobs: int | None
    engine: str
    address: str | None
    workers: int
    threads: int
    device: str
    fail_fast: bool


@dataclass(frozen=True)
class RunOptions:
    """How a run goes: pictures or frames at a time, redo what is done, no progress on stderr.

    fail_fast: end at the first picture that fails.
    """

    jobs: int = 1
    overwrite: bool = False
    quiet: bool = False
    fail_fast: bool = False
