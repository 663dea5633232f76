"""roadtorch label, from real files to real files."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from roadtorch.base.image import read_image
from roadtorch.layout.labeller import LabellerSettings, label_layout
from roadtorch.testing.scenes import render_scene, write_picture
from tests.command import Call


@pytest.mark.parametrize(
    ("support", "values"), [("margin", {0, 1, 2, 255}), ("maximum", {0, 1, 2})]
)
def test_labels_are_one_byte_a_pixel(
    call: Call, tmp_path: Path, out: Path, support: str, values: set[int]
) -> None:
    street = tmp_path / "in" / "sub" / "street.png"
    write_picture(street, render_scene(1, 96, 128))

    result = call(
        "label", tmp_path / "in", "--out", out, "--set", f"support={support}", "--overlay"
    )

    assert (result.exit_code, result.stderr) == (0, f"roadtorch: 1 done; results in {out}\n")
    settings = LabellerSettings.model_validate({"support": support})
    labels = label_layout(read_image(street), settings).labels
    with Image.open(out / "sub" / "street.png") as written:
        assert written.mode == "L"
        assert np.array_equal(np.asarray(written), labels.numpy())
    assert set(labels.unique().tolist()) <= values
    assert read_image(out / "sub" / "street.overlay.jpg").shape == (3, 96, 128)


def test_labels_never_replace_the_pictures(call: Call, footage: Path) -> None:
    before = (footage / "b.png").read_bytes()

    result = call("label", footage, "--out", footage)

    assert result.exit_code == 2
    assert "b.png: is one of the pictures" in result.stderr
    assert (footage / "b.png").read_bytes() == before
