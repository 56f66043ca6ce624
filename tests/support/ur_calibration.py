"""Writes what `ur_calibration` writes: a calibrated DH table as a file of six joint frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dgs_description.arm_kinematics import DH_A, DH_ALPHA, DH_D, LINKS
from dgs_description.frames import Array, inverse, transform

# Errors of the size that arms leave the factory with (UR10e, test of ur_calibration), but for the two lengths
# that its fit trades against each other over hundreds of metres: those would fit no other arm.
_D = (-1.4e-4, 2e-4, -3e-4, 4e-4, -4.5e-5, -8.7e-4)
_A = (1.1e-4, 3e-4, -2e-4, 2.6e-5, 4e-6, 0.0)
_THETA = (1.6e-7, -2e-3, 3e-3, 1e-3, -1.6e-6, 9.2e-8)
_ALPHA = (-4.4e-4, -1.6e-3, 6.3e-3, -1.7e-3, 7.6e-4, 0.0)


def dh_chain(d: ArrayLike, a: ArrayLike, theta: ArrayLike, alpha: ArrayLike) -> Array:
    """(6, 4, 4) joint frames of a table [m, rad]: d and theta turn with the joint, a and alpha lead to the next one."""
    rolls = Rotation.from_euler("x", np.roll(np.asarray(alpha), 1)[:, None]).as_matrix()
    turns = Rotation.from_euler("z", np.asarray(theta)[:, None]).as_matrix()
    lead = transform(rolls, np.stack([np.roll(np.asarray(a), 1), np.zeros(6), np.zeros(6)], axis=1))
    return lead @ transform(turns, np.stack([np.zeros(6), np.zeros(6), d], axis=1))


def drawn_in(chain: Array) -> Array:
    """The same arm with the frames of joints 2 and 3 moved along their axes and turned about them.

    The first shift puts upper_arm's origin into the shoulder, the next ones forearm into upper_arm's plane z = 0; the
    turns lay each next axis on -x. A frame's shift along its own axis changes no motion.
    """
    out = chain.copy()
    # A table's frame of joint 2 lies d along the axis from where it should be.
    _move(out, 1, float(-out[1][:3, 3] @ out[1][:3, 2]), 0.0)
    for k in (1, 2):
        place, axis = out[k + 1][:3, 3], out[k + 1][:3, 2]
        along = float(-place[2] / axis[2])
        x, y = (place + along * axis)[:2]
        if k == 1:
            _move(out, 2, along, 0.0)
        _move(out, k, 0.0, float(np.arctan2(-y, -x)))
    return out


def _move(chain: Array, k: int, along: float, turn: float) -> None:
    shift = transform(Rotation.from_euler("z", turn).as_matrix(), (0.0, 0.0, along))
    chain[k] = chain[k] @ shift
    chain[k + 1] = inverse(shift) @ chain[k + 1]


def write(path: Path, chain: Array, name: str = "calib_test") -> Path:
    """The file of a chain (6, 4, 4)."""
    angles = Rotation.from_matrix(chain[:, :3, :3]).as_euler("XYZ")
    values = np.concatenate([chain[:, :3, 3], angles], axis=1).tolist()
    keys = ("x", "y", "z", "roll", "pitch", "yaw")
    links: dict[str, object] = {
        link: dict(zip(keys, row, strict=True)) for link, row in zip(LINKS, values, strict=True)
    }
    path.write_text(yaml.safe_dump({"kinematics": {**links, "hash": name}}, sort_keys=False))
    return path


def a_ur3() -> Array:
    """(6, 4, 4) chain of a UR3 as it might leave the factory; its TCP is a few millimetres off the table's."""
    table = (np.add(DH_D, _D), np.add(DH_A, _A), np.array(_THETA), np.add(DH_ALPHA, _ALPHA))
    return drawn_in(dh_chain(*table))
