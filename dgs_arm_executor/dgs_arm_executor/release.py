"""Where the object is let go: hand poses above the bin."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.pick_plan import PickSettings
from dgs_description.cell import CELL
from dgs_description.frames import Array, transform

_YAWS = np.deg2rad(np.arange(0, 360, 30))
_LEAST_BELOW, _MOST_BELOW = 0.06, 0.18
"""The fingertips reach 5 cm beyond the TCP; no more than 18 cm of object is believed [m]."""
_ASIDE = 0.10
"""The hand itself stays so near to the bin's middle [m]."""


def release_states(ik: ArmIK, carried: CarriedBox | None, near: Array, settings: PickSettings) -> Array:
    """(K, 6) arm joints with fingers down and the object over the bin's middle, in every direction, on every branch.

    Args:
        carried: the object; the TCP is as much higher as it hangs down, and as much aside as it is held off its middle.
        near: (6,) joints are turned next to these, and the nearest state comes first [rad].
        settings: the clearance between its rim and the object.
    """
    below = np.clip(0.0 if carried is None else carried.below_tcp, _LEAST_BELOW, _MOST_BELOW)
    rim = CELL.table_height + CELL.bin_size[2]
    down = (Rotation.from_euler("x", np.pi) * Rotation.from_rotvec(np.outer(_YAWS, (0, 0, 1)))).as_matrix()
    middle = np.zeros(3) if carried is None else carried.T_tcp_box[:3, 3]
    aside = (down @ middle)[:, :2]
    aside *= min(1.0, _ASIDE / max(float(np.linalg.norm(middle[:2])), 1e-9))
    height = np.full(len(down), rim + settings.release_clearance + below)
    states = ik.states(transform(down, np.column_stack([CELL.bin_centre - aside, height])), near)
    return states[np.argsort(np.abs(states - near).max(axis=1), kind="stable")]
