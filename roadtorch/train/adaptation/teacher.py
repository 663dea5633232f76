"""The teacher: a larger detector's prediction for each frame, averaged over neighbouring frames.

The teacher's predictions waver from frame to frame, and a place that ten frames show is predicted
ten times, from near and from far. So log odds of road are carried there and back along the motion
of the picture (``road.steady``). Pictures that are not consecutive keep their own predictions.
Ours.
"""

from pathlib import Path
from signal import SIGTERM, Signals

from roadtorch.base.signals import stop_on_signals
from roadtorch.imaging.motion import flow_picture
from roadtorch.layout.classes import CLASSES
from roadtorch.road.fusion import log_odds
from roadtorch.road.steady import SteadySettings, smoothed
from roadtorch.run.memo import keep, kept, read_arrays
from roadtorch.train.adaptation.frames import KeptFrames
from roadtorch.train.config import PictureTraining
from roadtorch.train.pictures import PictureRecipe
from roadtorch.train.prepared import from_bytes, to_bytes
from roadtorch.train.run import made_ready

MOTION = SteadySettings(miss=2.0, slack=0.1, contrast=0.1)
"""Stricter than for video: a second apart, ways back close by chance, and places look alike."""


def write_taught(
    frames: KeptFrames, looks: Path, prepared: Path, training: PictureTraining, quiet: bool = False
) -> Signals | None:
    """Write what training needs of all frames into the folder ``prepared``.

    looks: the folder of the teacher's predictions; what is in either, of these
    frames and settings, is kept. Gives the signal that cut
    it short. Memory is linear in the frames, 0.5 MB each.
    """
    pictures = frames.pictures()
    with stop_on_signals() as stop:
        recipe = PictureRecipe(training)
        made = made_ready(recipe, pictures, looks, stop, quiet)
        if stop.asked:
            return stop.signal or SIGTERM
    files = {
        item.file: picture
        for picture, item in zip(pictures, made, strict=True)
        if item.file is not None
    }
    taught = {look: prepared / look.relative_to(looks) for look in files}
    keys = [recipe.key(picture) for picture in files.values()]
    if all(kept(file, key) for file, key in zip(taught.values(), keys, strict=True)):
        return None
    greys = [flow_picture(picture.read(), MOTION.width) for picture in files.values()]
    roads = (from_bytes(read_arrays(look, "maps")["maps"][CLASSES]) for look in files)
    smooth = smoothed(greys, [log_odds(road) for road in roads], MOTION)
    for (look, file), key, odds in zip(taught.items(), keys, smooth, strict=True):
        arrays = read_arrays(look)
        arrays["maps"][CLASSES] = to_bytes(odds.sigmoid())
        keep(file, key, arrays)
    return None
