"""What teaches: a larger look at each frame, and what the frames around say of the same places.

The larger look is a detector's, from outside what learns. It wavers from frame to frame; a place
that is seen in ten frames is looked at ten times, from near and from far. So log odds of road are
carried there and back along the motion of the picture (``road.steady``). Where pictures do not
follow one another nothing is carried, and the look stays as it is. Ours.
"""

from pathlib import Path
from signal import SIGTERM, Signals

from roadtorch.adapt.frames import KeptFrames
from roadtorch.imaging.motion import flow_picture
from roadtorch.io.atomic import make_folder
from roadtorch.layout.classes import CLASSES
from roadtorch.road.fusion import log_odds
from roadtorch.road.steady import SteadySettings, smoothed
from roadtorch.runtime.signals import stop_on_signals
from roadtorch.train.config import PictureTraining
from roadtorch.train.pictures import PictureRecipe
from roadtorch.train.prepared import from_bytes, read_arrays, to_bytes, write_arrays
from roadtorch.train.processes import join_processes
from roadtorch.train.run import made_ready

MOTION = SteadySettings(miss=2.0, slack=0.1, contrast=0.1)
"""Stricter than for video: a second apart, ways back close by chance, and places look alike."""


def write_taught(
    frames: KeptFrames, looks: Path, prepared: Path, training: PictureTraining, quiet: bool = False
) -> Signals | None:
    """Write what training needs of all frames into the folder ``prepared``.

    looks: the folder of the larger looks; what is in either is kept. Gives the signal that cut
    it short. Memory is linear in the frames, 0.5 MB each.
    """
    recipe, pictures = PictureRecipe(training), frames.pictures()
    with stop_on_signals() as stop, join_processes(stop, quiet) as processes:
        made = made_ready(recipe, pictures, looks, processes)
        if processes.stopped():
            return stop.signal or SIGTERM
    seen = [
        (picture, item.file, prepared / item.file.relative_to(looks))
        for picture, item in zip(pictures, made, strict=True)
        if item.file is not None
    ]
    if all(file.exists() for _, _, file in seen):
        return None
    greys = [flow_picture(picture.read(), MOTION.width) for picture, _, _ in seen]
    roads = (from_bytes(read_arrays(look, "maps")["maps"][CLASSES]) for _, look, _ in seen)
    said = smoothed(greys, [log_odds(road) for road in roads], MOTION)
    for (_, look, file), odds in zip(seen, said, strict=True):
        arrays = read_arrays(look)
        arrays["maps"][CLASSES] = to_bytes(odds.sigmoid())
        make_folder(file.parent)
        write_arrays(file, arrays)
    return None
