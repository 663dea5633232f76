"""The memory of a large picture: linear in its pixels."""

import json
import subprocess
import sys

DETECT = """
import json, resource, torch
from roadtorch import load_detector
from roadtorch.testing.scenes import render_scene
detector, small, peaks = load_detector("fusion"), render_scene(0, 240, 320).image, []
for height in (480, 1200):
    width = height * 4 // 3
    rows, columns = torch.arange(height) * 240 // height, torch.arange(width) * 320 // width
    image = torch.empty(3, height, width)
    for plane, values in zip(image, small):
        for row, place in zip(plane, rows):
            row.copy_(values[place][columns])
    detector.detect(image)
    peaks.append((height * width, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024))
print(json.dumps(peaks))
"""


def test_the_memory_of_a_large_picture_stays_below_24_bytes_a_pixel() -> None:
    """Of the image itself 12, of likelihood and mask 5: the rest is made on the way."""
    (few, small), (many, large) = json.loads(
        subprocess.check_output([sys.executable, "-c", DETECT])
    )

    assert (large - small) / (many - few) < 24
