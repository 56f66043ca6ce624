"""Where the object is let go: hand poses above the bin."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.situation import Load
from dgs_description.frames import CELL, Array, transform

_YAWS = np.deg2rad(np.arange(0, 360, 30))
_LEAST_BELOW, _MOST_BELOW = 0.06, 0.18
"""The fingertips reach 5 cm beyond the TCP; no more than 18 cm of object is believed [m]."""
_ASIDE = 0.10
"""The hand itself stays so near to the bin's middle [m]."""
_HALF = 0.07
"""Things are let go so far from the bin's middle, along its longer side, as they fit: not all on one pile [m]."""
_WALL = 0.02
"""Between a thing and the bin's outside [m]."""


def release_states(ik: ArmIK, load: Load | None, near: Array, settings: PickSettings) -> Array:
    """(K, 6) arm joints with fingers down and the object over the bin, in every direction, on every branch.

    What lay at larger y than the workspace's middle comes to the bin's half at larger x.

    Args:
        load: the TCP is as much higher as the object hangs down, and as much aside as it is held off its middle.
        near: (6,) joints are turned next to these, and the nearest state comes first [rad].
        settings: the clearance between its rim and the object.
    """
    carried = None if load is None else load.box
    below = np.clip(0.0 if carried is None else carried.below_tcp, _LEAST_BELOW, _MOST_BELOW)
    rim = CELL.table_height + CELL.bin_size[2]
    down = (Rotation.from_euler("x", np.pi) * Rotation.from_rotvec(np.outer(_YAWS, (0, 0, 1)))).as_matrix()
    away = np.zeros((len(down), 2))
    if load is not None and carried is not None:
        reach = np.abs(down @ carried.T_tcp_box[:3, :3])[:, 0] @ carried.size / 2
        room = np.clip(CELL.bin_size[0] / 2 - _WALL - reach, 0.0, _HALF)
        away[:, 0] = np.sign(load.grasp.reference_point[1] - CELL.workspace_centre[1]) * room
        away -= (down @ carried.T_tcp_box[:3, 3])[:, :2]
        away *= np.minimum(1.0, _ASIDE / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9))
    height = np.full(len(down), rim + settings.release_clearance + below)
    states = ik.states(transform(down, np.column_stack([CELL.bin_centre + away, height])), near)
    return states[np.argsort(np.abs(states - near).max(axis=1), kind="stable")]
