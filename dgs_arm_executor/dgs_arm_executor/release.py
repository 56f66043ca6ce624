"""Where the object is let go: hand poses above the bin."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.obstacle_cloud import CarriedBox
from dgs_arm_executor.pick_plan import PickSettings
from dgs_description.frames import CELL, Array, apply, transform

_YAWS = np.deg2rad(np.arange(0, 360, 30))
_LEAST_BELOW, _MOST_BELOW = 0.06, 0.18
"""The fingertips reach 5 cm beyond the TCP; no more than 18 cm of object is believed [m]."""
_ASIDE = 0.10
"""The hand itself stays so near to the bin's middle [m]."""
_DEEP, _BESIDE = 0.05, 0.015
"""What hangs down is lowered so far into the bin, between walls that are no nearer than the second [m]: standing on its
end it would fall over the rim."""
_WORTH_IT = 0.03
"""By less nothing is lowered [m]."""
_CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))


def release_states(ik: ArmIK, carried: CarriedBox | None, near: Array, settings: PickSettings) -> Array:
    """(K, 6) arm joints with fingers down and the object over the bin's middle, in every direction, on every branch.

    Args:
        carried: the object; the TCP is as much higher as it hangs down, and as much aside as it is held off its middle.
        near: (6,) joints are turned next to these, and the nearest state comes first [rad].
        settings: the clearance between its rim and the object.
    """
    below = _believed_below(carried)
    rim = CELL.table_height + CELL.bin_size[2]
    down = (Rotation.from_euler("x", np.pi) * Rotation.from_rotvec(np.outer(_YAWS, (0, 0, 1)))).as_matrix()
    middle = np.zeros(3) if carried is None else carried.T_tcp_box[:3, 3]
    aside = (down @ middle)[:, :2]
    aside *= min(1.0, _ASIDE / max(float(np.linalg.norm(middle[:2])), 1e-9))
    height = np.full(len(down), rim + settings.release_clearance + below)
    states = ik.states(transform(down, np.column_stack([CELL.bin_centre - aside, height])), near)
    return states[np.argsort(np.abs(states - near).max(axis=1), kind="stable")]


def lowering(T_base_tcp: Array, carried: CarriedBox | None, settings: PickSettings) -> Array:
    """(K,) how far what hangs down may go down into the bin from (K, 4, 4) poses of `release_states` [m].

    0 where that is not worth it, or it would come near to the walls. The fingers stay above the rim.
    """
    if carried is None:
        return np.zeros(len(T_base_tcp))
    below = _believed_below(carried)
    deepest = settings.release_clearance + _DEEP - (carried.below_tcp - below)
    way = max(min(below - _LEAST_BELOW, deepest), 0.0)
    corners = np.array([apply(T @ carried.T_tcp_box, _CORNERS * carried.size) for T in T_base_tcp])
    room = np.array(CELL.bin_size[:2]) / 2 - CELL.bin_wall - _BESIDE
    fits = (np.abs(corners[..., :2] - CELL.bin_centre) < room).all(axis=(1, 2))
    return np.where(fits & (way > _WORTH_IT), way, 0.0)


def _believed_below(carried: CarriedBox | None) -> float:
    """How far the object hangs below the TCP, or the fingers where that is farther [m]."""
    return float(np.clip(0.0 if carried is None else carried.below_tcp, _LEAST_BELOW, _MOST_BELOW))
