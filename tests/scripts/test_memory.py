"""The memory that many pictures take: that it is watched, and told by count."""

import subprocess
import sys

import pytest

from scripts import memory


@pytest.mark.skipif(sys.platform != "linux", reason="the resident set is read from /proc")
def test_each_count_has_a_row_with_its_memory() -> None:
    words = [sys.executable, memory.__file__, "--counts", "10", "20"]

    done = subprocess.run(words, capture_output=True, text=True, timeout=120)

    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    assert [row[0] for row in rows] == ["10", "20"]
    for row in rows:
        early, late, peak = map(float, row[2:])
        assert 20 < early <= peak
        assert 20 < late <= peak
