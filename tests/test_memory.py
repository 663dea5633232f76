"""The memory of a large picture: linear in its pixels."""

import json
import subprocess
import sys

DETECT = """
import json, resource, torch
from roadtorch import load_detector
from roadtorch.scenes.street import render_scene
small, height = render_scene(0, 240, 320).image, {height}
width = height * 4 // 3
rows, columns = torch.arange(height) * 240 // height, torch.arange(width) * 320 // width
image = torch.empty(3, height, width)
for plane, values in zip(image, small):
    for row, place in zip(plane, rows):
        row.copy_(values[place][columns])
load_detector("fusion").detect(image)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
print(json.dumps([height * width, peak]))
"""


def test_the_memory_of_a_large_picture_stays_below_24_bytes_a_pixel() -> None:
    """Of the image itself 12, of likelihood and mask 5: the rest is made on the way."""
    (few, small), (many, large) = (
        json.loads(subprocess.check_output([sys.executable, "-c", DETECT.format(height=height)]))
        for height in (612, 2208)
    )

    assert (large - small) / (many - few) < 24
