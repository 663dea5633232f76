"""Files of grids, read back as map_server reads them."""

from pathlib import Path

import cv2
import numpy as np
import torch
import yaml

from roadtorch.camera.ground_grid import Grid
from roadtorch.run.writers.grid import write_grid

CELLS = torch.tensor([[0, 100, -1], [-1, -1, 0]], dtype=torch.int8)
GRID = Grid(CELLS, torch.zeros(2, 3), 0.25, (0.5, -1.0))


def loaded(path: Path) -> tuple[np.ndarray, dict]:
    """nav2_map_server's loader in trinary mode: int8 by y and x, and the YAML."""
    values = yaml.safe_load(path.read_text())
    grey = cv2.imread(str(path.parent / values["image"]), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    taken = np.float32(1) - grey.astype(np.float32) / np.float32(255)
    cells = np.full(grey.shape, -1, np.int8)
    cells[taken >= values["occupied_thresh"]] = 100
    cells[taken <= values["free_thresh"]] = 0
    return cells[::-1], values


def test_map_server_reads_the_same_three_values(tmp_path: Path) -> None:
    write_grid(tmp_path / "it's: a #1", GRID, "pitch 2 degrees")

    cells, values = loaded(tmp_path / "it's: a #1.grid.yaml")

    assert cells.tolist() == CELLS.tolist()
    assert (values["mode"], values["resolution"], values["negate"]) == ("trinary", 0.25, 0)
    assert values["origin"] == [0.5, -1, 0]


def test_pictures_have_y_upwards_and_numpy_has_the_rows_from_the_right(tmp_path: Path) -> None:
    write_grid(str(tmp_path / "a"), GRID)

    picture, cells = (tmp_path / "a.grid.pgm").read_bytes(), np.load(tmp_path / "a.grid.npy")

    assert picture == b"P5\n3 2\n255\n" + bytes([205, 205, 254, 254, 0, 205])
    assert cells.dtype == np.int8
    assert cells.tolist() == CELLS.tolist()
    assert len(list(tmp_path.iterdir())) == 3
