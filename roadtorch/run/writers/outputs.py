"""The outputs of ``infer`` for a source: which writers it gets, and their files."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from roadtorch.base.errors import RoadtorchError, to_input_error
from roadtorch.camera.mounting import MEDIAN_FRAMES, CameraPlacement, Pitch, median_pitch
from roadtorch.detectors.detection import Detection
from roadtorch.detectors.stream import detect_frames
from roadtorch.inputs.bags import camera_info, image_topic, is_bag
from roadtorch.inputs.item import Source
from roadtorch.run.loop import Inference
from roadtorch.run.plan import Output, Writer, Writers
from roadtorch.run.writers.bag import BagWriter
from roadtorch.run.writers.grid import GridWriter
from roadtorch.run.writers.maps import CUE_SUFFIXES, MapWriter
from roadtorch.run.writers.video import VideoWriter

DEFAULT_IMAGE_KINDS = ("likelihood", "mask", "overlay")
DEFAULT_FOOTAGE_KINDS, DEFAULT_BAG_KINDS = ("overlay",), ("overlay", "bag")
"""Kinds of results without ``--save``, for images, footage and bags."""

CAMERA_FRAME = "camera"  # frame_id in bags written from footage, which has none


VIDEOS = {
    "overlay": ".overlay.mp4",
    "mask-video": ".mask.mp4",
    "likelihood-video": ".likelihood.mp4",
}
"""Suffixes of the kinds of results that are videos."""


def is_from_bag(source: Source) -> bool:
    """Return whether a source is a bag."""
    return source.path is not None and is_bag(source.origin)


@dataclass(frozen=True)
class MapOutput:
    """The outputs of ``infer`` for a source: videos, bags, and files of each frame."""

    maps: MapWriter  # writer of single images
    infer: Inference
    # Of ``--save``, None for the defaults; ``overlay`` is a video, ``overlay-frames`` are images.
    kinds: tuple[str, ...] | None
    topic: str | None = None  # image topic in bags, None for the only one
    viewer: Writer | None = None  # a further writer of the frames

    def __call__(self, source: Source) -> Output:
        """Return the outputs for a source."""
        defaults = DEFAULT_BAG_KINDS if is_from_bag(source) else DEFAULT_FOOTAGE_KINDS
        kinds = defaults if self.kinds is None else self.kinds
        path = source.path
        is_ros1 = path is not None and path.suffix == ".bag" and path.is_file()
        suffixes = {**VIDEOS, "bag": ".road.bag" if is_ros1 else ".road"}
        streams = {kind: suffixes[kind] for kind in kinds if kind in suffixes}
        frame_kinds = set(kinds) - suffixes.keys()
        if "overlay-frames" in kinds:
            frame_kinds = frame_kinds - {"overlay-frames"} | {"overlay"}
        maps = replace(self.maps, kinds=frozenset(frame_kinds))
        cues = not frame_kinds.isdisjoint(CUE_SUFFIXES)
        open_writers = partial(self._open, source, maps, streams)
        return Output(kinds, [*streams.values()], maps.suffixes, open_writers, cues)

    @contextmanager
    def _open(self, source: Source, maps: MapWriter, suffixes: dict[str, str]) -> Iterator[Writers]:
        """Open the writers; videos and bags are finished however the block ends."""
        stem, grids = maps.folder / source.name, self._fit_grids(source)
        overlay = lru_cache(maxsize=1)(Detection.overlay)  # drawn once for all writers
        draws: dict[str, Callable[[Detection], np.ndarray]] = {
            "overlay": overlay,
            "mask-video": lambda result: result.mask.numpy().astype(np.uint8) * 255,
            "likelihood-video": lambda result: result.likelihood.mul(255).round().byte().numpy(),
        }
        with ExitStack() as stack:
            streams = [self.viewer] if self.viewer else []
            for kind in sorted(suffixes, key=[*VIDEOS, "bag"].index):
                path = stem.with_name(stem.name + suffixes[kind])
                if kind == "bag":
                    frame_id = CAMERA_FRAME
                    if is_from_bag(source):
                        frame_id = image_topic(source.origin, self.topic).frame_id
                    writer = BagWriter(path, frame_id, maps.threshold, overlay)
                    grids = replace(grids, bag=writer) if grids else None
                else:
                    writer = VideoWriter(path, draws[kind], source.rate)
                streams.append(stack.enter_context(closing(writer)))
            yield Writers(replace(maps, grids=grids), streams)

    def _fit_grids(self, source: Source) -> GridWriter | None:
        """Return the writer of grids, if any, with the lens and one pitch of the source."""
        if self.maps.grids is None:
            return None
        placement = self.maps.grids.placement
        if placement.needs_lens:
            placement = placement.with_lens(camera_info(source.origin, self.topic))
        if placement.needs_layout:
            placement = fix_pitch(placement, self.infer, source)
        return replace(self.maps.grids, placement=placement)


def fix_pitch(placement: CameraPlacement, infer: Inference, source: Source) -> CameraPlacement:
    """Set one pitch for a source, the median of some frames' estimates; InputError without any."""
    pitches: list[Pitch] = []
    error: RoadtorchError | None = None
    frames = detect_frames(source.subsample(MEDIAN_FRAMES), infer)
    with warnings.catch_warnings(), closing(frames):
        warnings.simplefilter("ignore")  # of its clock: reported when all frames are read
        for frame in frames:
            try:
                detection = frame.detection()
                image, layout = detection.image, detection.cues.get("layout")
                assert image is not None
                pitches.append(placement(image, layout)[1])
            except RoadtorchError as raised:
                error = raised
    if pitches:
        return replace(placement, pitch=median_pitch(pitches))
    if error is None:
        return placement
    raise to_input_error(source.origin, error)
