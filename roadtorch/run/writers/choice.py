"""Which writers ``infer`` and ``grid`` have for a source, and whether it is a bag."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from roadtorch.base.errors import RoadtorchError, fault
from roadtorch.camera.calibration import lens_of_info
from roadtorch.camera.mounting import Pitch, Placing, median_pitch
from roadtorch.detectors.detection import Detection
from roadtorch.inputs.bags import camera_info, image_topic, is_bag
from roadtorch.inputs.item import Source
from roadtorch.run.loop import Inference, detect_frames
from roadtorch.run.plan import Output, Writer, Writers
from roadtorch.run.workers import Workers
from roadtorch.run.writers.bag import BagWriter
from roadtorch.run.writers.grid import Grids
from roadtorch.run.writers.maps import CUE_SUFFIXES, SUFFIXES, Maps
from roadtorch.run.writers.video import VideoWriter

OF_IMAGES, OF_FOOTAGE, OF_BAGS = (
    ("likelihood", "mask", "overlay"),
    ("overlay",),
    ("overlay", "bag"),
)
"""What is written where nothing is asked for."""

CAMERA_FRAME = "camera"
"""The frame of reference in bags of footage that tells none."""

MEDIAN_FRAMES = 9
"""Frames whose median is the pitch of a source; ours: a few wrong ones do not move it."""


def mask_pixels(detection: Detection) -> np.ndarray:
    """The mask as grey, road 255."""
    return detection.mask.numpy().astype(np.uint8) * 255


def likelihood_pixels(detection: Detection) -> np.ndarray:
    """The likelihood as grey, 1 being 255."""
    return detection.likelihood.mul(255).round().byte().numpy()


class Overlay:
    """The overlay of a detection, drawn once for all that show it."""

    def __init__(self) -> None:
        self._last: tuple[Detection, np.ndarray] | None = None

    def __call__(self, detection: Detection) -> np.ndarray:
        """Pixels uint8 (H,W,3) RGB."""
        if self._last is None or self._last[0] is not detection:
            self._last = detection, detection.overlay()
        return self._last[1]


VIDEOS = {
    "overlay": ".overlay.mp4",
    "mask-video": ".mask.mp4",
    "likelihood-video": ".likelihood.mp4",
}
"""The results that are videos: how their names end."""


def is_from_bag(source: Source) -> bool:
    """Whether the frames of a source are those of a bag."""
    return not source.live and is_bag(source.origin)


def bag_suffix(source: Source, suffix: str) -> str:
    """How the name of the bag ends: of ROS 1 where the source is such a bag, else of ROS 2."""
    path = Path(source.origin)
    is_ros1 = is_from_bag(source) and path.suffix == ".bag" and path.is_file()
    return f"{suffix}.bag" if is_ros1 else suffix


@dataclass(frozen=True)
class MapOutput:
    """What ``infer`` writes of a source: videos, bags, and files for each frame.

    maps: of an image. asked: the kinds of ``--save``, None where it is not given: of a
    source ``overlay`` is a video and ``overlay-frames`` are images. topic: of the images in
    bags; None where they have one. view: what else gets the frames of sources.
    """

    maps: Maps
    asked: tuple[str, ...] | None
    topic: str | None = None
    view: Writer | None = None

    def __call__(self, source: Source) -> Output:
        """What is written of that source."""
        usual = OF_BAGS if is_from_bag(source) else OF_FOOTAGE
        kinds = usual if self.asked is None else self.asked
        of_frames = set(kinds)
        suffixes = {**VIDEOS, "bag": bag_suffix(source, ".road")}
        own = {kind: suffixes[kind] for kind in kinds if kind in suffixes}
        of_frames -= suffixes.keys()
        if "overlay-frames" in kinds:
            of_frames = of_frames - {"overlay-frames"} | {"overlay"}
        maps = replace(self.maps, kinds=frozenset(of_frames))
        suffixes_of_frames = [SUFFIXES.get(kind, f".{kind}") for kind in of_frames]
        cues = not of_frames.isdisjoint(CUE_SUFFIXES)
        opened = partial(self._open, source, maps, own)
        return Output(kinds, [*own.values()], suffixes_of_frames, opened, cues)

    @contextmanager
    def _open(self, source: Source, maps: Maps, own: dict[str, str]) -> Iterator[Writers]:
        """However the block ends, videos and bags are finished with the frames that they have."""
        stem, overlay = maps.folder / source.name, Overlay()
        draws: dict[str, Callable[[Detection], np.ndarray]] = {"overlay": overlay}
        draws |= {"mask-video": mask_pixels, "likelihood-video": likelihood_pixels}
        with ExitStack() as stack:
            streams = [self.view] if self.view else []
            for kind in sorted(own, key=[*VIDEOS, "bag"].index):
                path = stem.with_name(stem.name + own[kind])
                if kind == "bag":
                    frame_id = CAMERA_FRAME
                    if is_from_bag(source):
                        frame_id = image_topic(source.origin, self.topic).frame_id
                    writer = BagWriter(path, frame_id, maps.threshold, overlay)
                else:
                    writer = VideoWriter(path, draws[kind], source.rate)
                streams.append(stack.enter_context(closing(writer)))
            yield Writers(maps, streams)


@dataclass(frozen=True)
class GridOutput:
    """What ``grid`` writes of a source: a grid a frame, in bags also as messages; one pitch.

    grids: of an image. infer: what finds the road. topic: of bags.
    """

    grids: Grids
    infer: Inference
    topic: str | None = None

    def __call__(self, source: Source) -> Output:
        """What is written of that source."""
        kinds, suffixes = tuple(self.grids.kinds), list[str]()
        if is_from_bag(source):
            kinds, suffixes = (*kinds, "bag"), [bag_suffix(source, ".grid")]
        opened = partial(self._open, source, suffixes)
        return Output(kinds, suffixes, self.grids.suffixes, opened)

    @contextmanager
    def _open(self, source: Source, suffixes: list[str]) -> Iterator[Writers]:
        """The pitch is found first. However the block ends, the bag has the frames until then."""
        placing, bag = self.grids.placing, None
        if placing.lacks_lens:
            info = camera_info(source.origin, self.topic)
            matrix, bent = info.matrix.ravel().tolist(), info.distortion.tolist()
            size = (info.width, info.height)
            placing = placing.through(lens_of_info(source.origin, size, matrix, bent, info.model))
        if placing.asks_images:
            placing = steadied(placing, self.infer, source)
        if suffixes:
            stem = self.grids.folder / source.name
            path, threshold = stem.with_name(stem.name + suffixes[0]), self.grids.settings.threshold
            bag = BagWriter(path, self.grids.frame_id, threshold)
        with closing(replace(self.grids, placing=placing, bag=bag)) as grids:
            yield Writers(grids)


def steadied(placing: Placing, infer: Inference, source: Source) -> Placing:
    """The placing with one pitch for a whole source: the median of what some frames tell.

    InputError when no frame tells it.
    """
    pitches: list[Pitch] = []
    error: RoadtorchError | None = None
    with closing(detect_frames(source.sampled(MEDIAN_FRAMES), infer, Workers())) as frames:
        for frame in frames:
            try:
                detection = frame.detection()
                image, layout = detection.image, detection.cues.get("layout")
                assert image is not None
                pitches.append(placing(image, layout)[1])
            except RoadtorchError as raised:
                error = raised
    if pitches:
        return replace(placing, pitch=median_pitch(pitches))
    if error is None:
        return placing
    raise fault(source.origin, error)
