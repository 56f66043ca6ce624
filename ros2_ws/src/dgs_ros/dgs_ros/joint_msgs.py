"""sensor_msgs/JointState <-> numpy, by joint name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.joints import reorder


def positions_of(msg: JointState, wanted: Sequence[str]) -> NDArray[np.float64]:
    """Positions (len(wanted),) [rad] of the wanted joints; the message may hold more, in any order.

    Raises:
        JointNameError: a wanted joint is missing, a joint comes twice, or names and positions differ in number.
        DgsError: JOINT_VALUES if a position is not finite.
    """
    return _finite(reorder(msg.name, msg.position, wanted), wanted, "position")


def efforts_of(msg: JointState, wanted: Sequence[str]) -> NDArray[np.float64]:
    """Torques (len(wanted),) [Nm], errors as in `positions_of`."""
    return _finite(reorder(msg.name, msg.effort, wanted), wanted, "effort")


def has_joints(msg: JointState, wanted: Sequence[str]) -> bool:
    """Whether the message names all wanted joints: other publishers share `/joint_states`."""
    return set(wanted) <= set(msg.name)


def to_joint_state(
    names: Sequence[str],
    positions: ArrayLike,
    velocities: ArrayLike | None = None,
    efforts: ArrayLike | None = None,
    stamp: Time | None = None,
) -> JointState:
    """A joint state of (N,) positions [rad] and, if given, velocities [rad/s] and torques [Nm].

    Raises JointNameError if the numbers of names and values differ.
    """
    q, dq, tau = ([] if values is None else reorder(names, np.ravel(values).tolist(), names).tolist()
                  for values in (positions, velocities, efforts))  # fmt: skip
    header = Header(stamp=Time() if stamp is None else stamp)
    return JointState(header=header, name=list(names), position=q, velocity=dq, effort=tau)


def _finite(values: NDArray[np.float64], names: Sequence[str], what: str) -> NDArray[np.float64]:
    bad = [name for name, value in zip(names, values, strict=True) if not np.isfinite(value)]
    if bad:
        raise DgsError(ErrorCode.JOINT_VALUES, f"{what} of {', '.join(bad)} is not a finite number")
    return values
