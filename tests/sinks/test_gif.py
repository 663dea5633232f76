from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.sinks.video import GifSink
from tests.videos import street_pixels


def test_a_stretch_is_small_and_ten_a_second(tmp_path: Path) -> None:
    sink = GifSink(tmp_path / "x.gif", 1.0, 2.0)
    for number in range(90):
        sink.write(np.tile(street_pixels(number // 3 % 3), (10, 10, 1)), number / 30)
    sink.close()

    with Image.open(tmp_path / "x.gif") as gif:
        assert gif.size == (480, 360)
        assert gif.n_frames == 10  # pyright: ignore[reportAttributeAccessIssue]
        assert gif.info["duration"] == pytest.approx(100, abs=10)
        assert gif.info["loop"] == 0


def test_a_stretch_without_frames_gives_no_file(tmp_path: Path) -> None:
    sink = GifSink(tmp_path / "x.gif", 5.0, 6.0)
    sink.write(street_pixels(0), 1.0)
    sink.close()

    assert list(tmp_path.iterdir()) == []
