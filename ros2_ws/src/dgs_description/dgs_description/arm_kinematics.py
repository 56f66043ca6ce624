"""Where the arm's joints are: by the maker's table, or as `ur_calibration` has read it from one robot.

One setting for all processes: the environment variable `DGS_ARM_KINEMATICS` names the file that
`ur_calibration` (Universal_Robots_ROS2_Driver) writes; unset = the table.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.yaml_text import load_yaml

DH_A = (0.0, -0.24365, -0.21325, 0.0, 0.0, 0.0)
DH_D = (0.1519, 0.0, 0.0, 0.11235, 0.08535, 0.0819)
DH_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
"""Standard DH parameters of the UR3, CB3 series (the UR3e differs in d1, a2, a3, d4 and d6)."""

CHOICE = "DGS_ARM_KINEMATICS"
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_VALUES = ("x", "y", "z", "roll", "pitch", "yaw")

_FARTHEST, _WIDEST = 0.01, 0.05
"""So far may a UR3's joint frame lie from the table's, [m] and [rad]; a UR3e's wrist is 19 mm off."""


@dataclass(frozen=True)
class ArmKinematics:
    """The arm's chain of joints.

    Attributes:
        name: `nominal`, or the file's `hash`.
        origins: (6, 4, 4) pose of each joint's frame, whose z is the axis, in the one before it, all joints at 0;
            the first in `base_link_inertia`, the last is `tool0`.
    """

    name: str
    origins: Array


def nominal() -> ArmKinematics:
    """The chain of the DH table: row k's d turns with joint k, its a and alpha lead to joint k + 1."""
    a, alpha = np.roll(DH_A, 1), np.roll(DH_ALPHA, 1)
    turns = Rotation.from_euler("x", alpha[:, None]).as_matrix()
    places = np.stack([a, -np.sin(alpha) * DH_D, np.cos(alpha) * DH_D], axis=-1)
    return ArmKinematics("nominal", transform(turns, places))


@cache
def arm_kinematics() -> ArmKinematics:
    """The arm of this process.

    Raises:
        DgsError: the file cannot be used, or is not of a UR3 (CB3).
    """
    chosen = os.environ.get(CHOICE)
    return of_ur3(read_kinematics(Path(chosen)), chosen) if chosen else nominal()


def read_kinematics(path: Path) -> ArmKinematics:
    """The chain that a file of `ur_calibration` states.

    Its roll, pitch and yaw turn about x, then the new y, then the new z, as the writer has them. A URDF takes such
    angles about fixed axes; with the robots of the writer's own tests that moves the TCP by up to 0.04 mm.

    Raises:
        DgsError: DESCRIPTION_MISSING, there is no such file; PARAMETER_INVALID, it is not what `ur_calibration` writes.
    """
    try:
        links = load_yaml(path.read_text(encoding="utf-8"))["kinematics"]
        table = np.array([[float(links[link][value]) for value in _VALUES] for link in LINKS])
        name = str(links["hash"])
    except (FileNotFoundError, NotADirectoryError) as error:
        cure = f"name the file of ur_calibration in {CHOICE}, or unset it"
        raise DgsError(ErrorCode.DESCRIPTION_MISSING, f"no arm kinematics at {path}: {cure}") from error
    except (yaml.YAMLError, OSError, KeyError, TypeError, ValueError, OverflowError) as error:
        wanted = f"needed are kinematics: {', '.join(LINKS)}, each with {', '.join(_VALUES)}, and hash"
        raise _refuse(f"{path} cannot be read ({type(error).__name__}: {error}); {wanted}") from error
    if not np.isfinite(table).all():
        raise _refuse(f"{path} holds numbers that are not finite; extract the calibration once more")
    turns = Rotation.from_euler("XYZ", table[:, 3:]).as_matrix()
    return ArmKinematics(name, transform(turns, table[:, :3]))


def of_ur3(kinematics: ArmKinematics, source: str) -> ArmKinematics:
    """The same; raises DgsError PARAMETER_INVALID where it is too far from the table to be a UR3's (CB3)."""
    expected = nominal().origins
    way = np.linalg.norm(kinematics.origins[:, :3, 3] - expected[:, :3, 3], axis=1)
    turn = Rotation.from_matrix(
        np.swapaxes(expected[:, :3, :3], 1, 2) @ kinematics.origins[:, :3, :3]
    ).magnitude()
    worst = int(np.argmax(np.maximum(way / _FARTHEST, turn / _WIDEST)))
    if way[worst] > _FARTHEST or turn[worst] > _WIDEST:
        off = f"{LINKS[worst]} is {way[worst] * 1e3:.1f} mm and {turn[worst]:.3f} rad off the UR3's (CB3)"
        raise _refuse(f"{source} is of another robot: {off}; take the file of this arm")
    return kinematics


def _refuse(sentence: str) -> DgsError:
    return DgsError(ErrorCode.PARAMETER_INVALID, sentence)
