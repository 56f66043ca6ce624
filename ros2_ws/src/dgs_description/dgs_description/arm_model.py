"""UR3 (CB3) kinematics from the maker's DH table: the reference that the URDF is tested against."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array

DH_A = (0.0, -0.24365, -0.21325, 0.0, 0.0, 0.0)
DH_D = (0.1519, 0.0, 0.0, 0.11235, 0.08535, 0.0819)
DH_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
"""Standard DH parameters of the UR3, CB3 series (the UR3e differs in d1, a2, a3, d4 and d6)."""


def forward_kinematics(q: ArrayLike) -> Array:
    """Pose of `tool0` in `base_link`.

    Args:
        q: (6,) arm joints, order of `joints.ARM_JOINTS` [rad].

    Returns:
        (4, 4) T_base_tool0. `base_link` is turned by pi about z against the DH base, as in the maker's description.
    """
    T_base_i = np.diag([-1.0, -1.0, 1.0, 1.0])
    for theta, a, d, alpha in zip(np.asarray(q, float), DH_A, DH_D, DH_ALPHA, strict=True):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T_base_i = T_base_i @ np.array(
            [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return T_base_i
