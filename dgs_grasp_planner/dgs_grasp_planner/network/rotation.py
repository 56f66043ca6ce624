"""The 6D rotation representation (Zhou et al., 2019) and well-spread rotations to start the hypotheses from."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor


def orthonormal_6d(sixd: Tensor) -> Tensor:
    """(..., 6) vectors of which both halves are made orthonormal by Gram-Schmidt."""
    a, b = sixd[..., :3], sixd[..., 3:]
    x = F.normalize(a, dim=-1, eps=1e-6)
    return torch.cat([x, F.normalize(b - (x * b).sum(-1, keepdim=True) * x, dim=-1, eps=1e-6)], dim=-1)


def matrix_from_6d(sixd: Tensor) -> Tensor:
    """(..., 3, 3) rotation matrices of (..., 6) vectors: the first two columns, made orthonormal."""
    x, y = orthonormal_6d(sixd).split(3, dim=-1)
    return torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def sixd_from_matrix(matrix: Tensor) -> Tensor:
    """(..., 6): first and second column of (..., 3, 3) rotation matrices, one after the other."""
    return torch.cat([matrix[..., 0], matrix[..., 1]], dim=-1)


def spread_rotations(count: int, frame: str) -> Tensor:
    """(count, 6) rotations of `hand_tcp` that approach the table, their in-plane angles spread over 360 degrees.

    In the frame `table` they approach downwards, in the frame `camera` along the view; every second one leans by
    30 degrees towards its palm side, so that tilted grasps have a start as well.
    """
    out, inward = [], torch.tensor([0.0, 0.0, -1.0 if frame == "table" else 1.0])
    for k in range(count):
        angle, lean = 2 * math.pi * k / count, math.radians(30.0) if k % 2 else 0.0
        side = torch.tensor([math.cos(angle), math.sin(angle), 0.0])
        z = inward * math.cos(lean) + side * math.sin(lean)
        x = side * math.cos(lean) - inward * math.sin(lean)
        out.append(torch.cat([x, torch.linalg.cross(z, x)]))
    return torch.stack(out)
