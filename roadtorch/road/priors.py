"""Where road is likely before seeing the picture: location priors, which are floors as well."""

import torch
from torch import Tensor

APEX = 0.45
"""Where the triangle of ``prior_triangle`` begins, in heights from the top: a usual horizon."""

BASE = 1.16
"""Width of its base on the bottom edge, in widths: the road leaves the picture at the sides."""


def prior_uniform(height: int, width: int) -> Tensor:
    """0.5 everywhere, float32 (H,W): every pixel may be road (the uniform prior of P2)."""
    return torch.full((height, width), 0.5)


def prior_rows(height: int, width: int) -> Tensor:
    """Row / height, float32 (H,W), pixel centres: the lower, the more likely road."""
    rows = (torch.arange(height, dtype=torch.float32) + 0.5) / height
    return rows[:, None].expand(height, width).contiguous()


def prior_triangle(height: int, width: int) -> Tensor:
    """1 in a triangle with its base on the bottom edge, 0 elsewhere: float32 (H,W).

    A straight road ahead, ours: apex in the middle at ``APEX``, base ``BASE``. MaxF on the
    development drives 0001TP, 0006R0 and 0016E5 of CamVid: 0.750, 0.842, 0.863; IDD: 0.811.
    """
    rows = (torch.arange(height, dtype=torch.float32)[:, None] + 0.5) / height
    columns = (torch.arange(width, dtype=torch.float32) + 0.5) / width
    reach = BASE / 2 * (rows - APEX) / (1 - APEX)
    return ((columns - 0.5).abs() <= reach).to(torch.float32)
