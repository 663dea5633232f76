"""What the authors' program gave on two frames, where it lies beside the repository."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from roadtorch.io.image import read_image

GOLDEN = Path(__file__).resolve().parents[3] / "shared" / "golden" / "ufl"
MAP = (115, 155)


class Golden:
    """The stored stages of one frame; patches in the order of ``unfold``, float64."""

    def __init__(self, name: str) -> None:
        self.arrays: Mapping[str, Any] = np.load(GOLDEN / f"{name}.npz")
        self.image = read_image(GOLDEN / f"{name}_160x120.png").double()
        self.picture = read_image(GOLDEN / f"{name}_480x360.png")
        self.order = self.arrays["unfold_from_program"].astype(int)
        rows, columns = self.arrays["patch_rows_rc"].astype(int).T
        self.rows = torch.from_numpy(rows * MAP[1] + columns)

    def __getitem__(self, key: str) -> Tensor:
        """A stored array as float64, int64 or bool."""
        values = self.arrays[key]
        kind = {"f": np.float64, "b": np.bool_}.get(values.dtype.kind, np.int64)
        return torch.from_numpy(values.astype(kind))

    def patches(self, key: str) -> Tensor:
        """Stored patches or bases (…,108)."""
        return self[key][..., self.order]


@pytest.fixture(scope="session")
def golden_root() -> Path:
    if not GOLDEN.is_dir():
        pytest.skip("the authors' results are not beside the repository (../shared/golden/ufl)")
    return GOLDEN


@pytest.fixture(scope="session", params=["0016E5_08149", "0016E5_08049"])
def golden(request: pytest.FixtureRequest, golden_root: Path) -> Golden:
    return Golden(request.param)
