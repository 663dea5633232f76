"""Maps made elsewhere: found, read, checked, each mistake with its file."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from roadtorch.data.maps import map_likelihood, parse_maps
from roadtorch.errors import ConfigError, InputError

SIZE = [(4, 6)]
RAMP = np.linspace(0, 1, 24).reshape(4, 6)


def test_8_and_16_bit_pictures_and_numpy_files_are_read_alike(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.round(RAMP * 255).astype(np.uint8))
    cv2.imwrite(str(tmp_path / "b.likelihood.png"), np.round(RAMP * 65535).astype(np.uint16))
    np.save(tmp_path / "c.npy", RAMP)

    for name, step in (("a", 1 / 255), ("b", 1 / 65535), ("c", 1e-7)):
        found = map_likelihood(tmp_path, ["none", name], SIZE)
        assert found.dtype == torch.float32
        assert np.abs(found.numpy() - RAMP).max() <= step / 2 + 1e-7


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        (np.where(RAMP > 0.9, np.nan, RAMP), r"m\.npy: has values from nan to nan"),
        (RAMP * 1.5, r"m\.npy: has values from 0 to 1\.5"),
        (RAMP - 0.1, r"m\.npy: has values from -0\.1"),
        (RAMP * 1e300, r"m\.npy: has values from 0 to inf"),
        (RAMP[:3], r"m\.npy: is 6 by 3 pixels \(it should be 6 by 4\)"),
        ((RAMP * 255).astype(np.uint8), r"m\.npy: holds uint8 of shape \(4, 6\)"),
        (RAMP[None], r"m\.npy: holds float64 of shape \(1, 4, 6\)"),
        (np.array(["x"], dtype=object), r"m\.npy: cannot be read"),
    ],
)
def test_each_mistake_names_the_file(tmp_path, values, complaint):
    np.save(tmp_path / "m.npy", values, allow_pickle=True)

    with pytest.raises(InputError, match=complaint):
        map_likelihood(tmp_path, ["m"], SIZE)


def test_colour_and_missing_and_empty_files_and_archives(tmp_path):
    cv2.imwrite(
        str(tmp_path / "c.png"), np.dstack([np.full((4, 6), v, np.uint8) for v in (1, 2, 3)])
    )
    (tmp_path / "e.npy").write_bytes(b"")

    with pytest.raises(InputError, match=r"c\.png: is a colour picture"):
        map_likelihood(tmp_path, ["c"], SIZE)
    with pytest.raises(InputError, match=r"d\.png: is missing"):
        map_likelihood(tmp_path, ["d"], SIZE)
    with pytest.raises(InputError, match=r"e\.npy: cannot be read"):
        map_likelihood(tmp_path, ["e"], SIZE)
    with (tmp_path / "a.npy").open("wb") as file:
        np.savez(file, a=RAMP)
    with pytest.raises(InputError, match=r"a\.npy: is an archive of arrays"):
        map_likelihood(tmp_path, ["a"], SIZE)


def test_a_folder_may_have_a_name_of_its_own(tmp_path):
    for name in ("theirs", "other/theirs"):
        (tmp_path / name).mkdir(parents=True)
    one, two = str(tmp_path / "theirs"), str(tmp_path / "other/theirs")

    assert parse_maps([one, f"net={two}"]) == {"theirs": Path(one), "net": Path(two)}
    with pytest.raises(ConfigError, match="nothing: is not a folder"):
        parse_maps(["net=nothing"])
    with pytest.raises(ConfigError, match="two folders one name"):
        parse_maps([one, two])


@pytest.mark.parametrize("name", ["x/y", "a/../../ESC", "..", ".", "", "a\\b", "a\nb"])
def test_names_that_are_no_file_names_are_refused(tmp_path, name):
    with pytest.raises(ConfigError, match="cannot be that of a file"):
        parse_maps([f"{name}={tmp_path}"])
