"""Exact symmetries of the procedural families: a validated grasp turned by one is as valid, and not simulated."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array
from dgs_sim_bridge.render.object_model import ObjectModel

TURNS_ABOUT_Z = {
    "can": 18, "bottle": 18, "jar": 18, "paper_cup": 18, "rod": 14, "ball": 18, "apple": 18, "bowl": 14, "pot": 14,
    "torch": 14, "screwdriver": 4, "hammer": 2, "tapered_tub": 2,
}  # fmt: skip
"""Families that are unchanged by a turn of 360/n degrees about z."""
FLIPPED_FAMILIES = frozenset({"can", "rod", "ball"})
"""Of those, the families that are also unchanged when turned upside down."""
BOX_FAMILIES = frozenset({"carton", "block", "soft_pack", "bar", "egg", "soap", "remote"})
"""Families that are unchanged by half turns about x, y and z."""
EXACT = 1e-5
"""Distance within which a turned corner has to meet another one [m]; those of the families do within 0.002 mm."""


def symmetries(family: str) -> Array:
    """(M, 3, 3) rotations, the identity first, that map an object of the family onto itself."""
    if sectors := TURNS_ABOUT_Z.get(family):
        angles = 2 * np.pi * np.arange(sectors) / sectors
        turns = Rotation.from_euler("z", angles[:, None]).as_matrix()
        upside_down = turns @ np.diag([1.0, -1.0, -1.0])
        return np.concatenate([turns, upside_down]) if family in FLIPPED_FAMILIES else turns
    if family in BOX_FAMILIES:
        signs = ((1.0, 1.0, 1.0), (1.0, -1.0, -1.0), (-1.0, 1.0, -1.0), (-1.0, -1.0, 1.0))
        return np.array([np.diag(diagonal) for diagonal in signs])
    return np.eye(3)[None]


def symmetries_of(model: ObjectModel) -> Array:
    """Those of its family, or the identity alone where the object is not what its family's name says: an imported one.

    Returns:
        (M, 3, 3) as `symmetries`.
    """
    turns = symmetries(model.family)
    corners = np.concatenate([model.vertices, *model.parts])
    distance, _ = cKDTree(corners).query(corners @ turns.transpose(0, 2, 1))
    return turns if distance.max() < EXACT else turns[:1]
