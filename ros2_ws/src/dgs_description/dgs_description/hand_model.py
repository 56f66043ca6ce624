"""Kinematics (forward, closed-form inverse) and shape (spheres, boxes) of the DexHand Pro, right hand.

Frames: `hand_base` has x out of the palm, y towards the thumb's side, z towards the fingertips. `hand_tcp` has the
same axes and sits at `TCP_IN_BASE`. The finger base frame F_i has x = flexion axis, y = distal, z = palmar, so yaw
turns about its z and pitch, middle and distal about its x. Lengths in metres, angles in radians. Sources: docs/hand.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array, transform
from dgs_description.joints import FINGER_LOWER, FINGER_UPPER

LINK_LENGTHS = (0.055, 0.025, 0.025)
"""Joint 2 to joint 3, joint 3 to joint 4, joint 4 to the fingertip point."""

TCP_IN_BASE = np.array([0.050, 0.005, 0.160])
BASE_IN_MOUNT = np.array([0.0, 0.0, 0.0122])
"""hand_base in hand_mount, the flange face that sits on the arm's tool0."""

_ORIGINS = np.array(
    [
        (0.06217593, 0.044372912, 0.078734808),
        (-0.002529881, 0.03680013, 0.107783545),
        (-0.0037, 0.01, 0.117783545),
        (-0.002529881, -0.01680013, 0.11258354),
        (0.000971571, -0.0433963, 0.093583545),
    ]
)
_FAN = np.deg2rad([0.0, -5.0, 0.0, 5.0, 10.0])
_DISTAL = np.array([(0.429052, 0.187171, 0.883675)] + [(0.0, 0.0, 1.0)] * 4)
_PALMAR = np.array([(-0.699872, -0.549586, 0.456218)] + [(np.cos(a), np.sin(a), 0.0) for a in _FAN[1:]])

YAW_SPREAD = _FAN
"""Yaw per finger at which neighbours stay clear of each other [rad]: index -5, middle 0, ring 5, little 10 deg."""


def _finger_bases() -> Array:
    y = _DISTAL / np.linalg.norm(_DISTAL, axis=1, keepdims=True)
    z = _PALMAR - (_PALMAR * y).sum(1, keepdims=True) * y
    z /= np.linalg.norm(z, axis=1, keepdims=True)
    bases = np.tile(np.eye(4), (5, 1, 1))
    bases[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=-1)
    bases[:, :3, 3] = _ORIGINS
    return bases


FINGER_BASES = _finger_bases()
"""(5, 4, 4) pose of every finger base frame F_i in `hand_base`."""

FINGER_BASES_TCP = FINGER_BASES.copy()
FINGER_BASES_TCP[:, :3, 3] -= TCP_IN_BASE
"""(5, 4, 4) pose of every F_i in `hand_tcp`."""


@dataclass(frozen=True)
class Capsule:
    """A capsule in the y-z plane of a finger link's frame: axis from (0, start, height) to (0, end, height)."""

    radius: float
    start: float
    end: float
    height: float


PHALANX_CAPSULES = (
    Capsule(0.014, 0.005, 0.050, -0.003),
    Capsule(0.012, 0.000, 0.025, -0.0005),
    Capsule(0.011, 0.000, 0.0156, -0.0007),
)
"""Collision shape of the proximal, middle and distal phalanx of every finger."""

BALL_RADIUS = PHALANX_CAPSULES[2].radius

PALM_BOXES = 1e-3 * np.array(
    [
        (-34, 36, -46, 0, 0, 88),
        (-26, 28, -61, -46, 15, 100),
        (-34, 29, -46, 52, 86, 106),
        (-33, 16, -29, 50, 106, 118),
        (-34, 45, 0, 50, 0, 88),
        (45, 83, 10, 62, 12, 80),
    ]
)
"""(6, 6) x0 x1 y0 y1 z0 z1 of the palm's collision boxes in `hand_base` [m]."""

# Spheres along the capsules: never outside of them, and their union misses the surface by 2.2 mm at most (tested).
_SPHERE_ROWS = [
    (k, capsule.radius, y, capsule.height)
    for k, (capsule, count) in enumerate(zip(PHALANX_CAPSULES, (4, 3, 3), strict=True))
    for y in np.linspace(capsule.start, capsule.end, count)
]
SPHERES_PER_FINGER = len(_SPHERE_ROWS)
SPHERE_PHALANX = np.array([row[0] for row in _SPHERE_ROWS])
"""(10,) phalanx (0 proximal, 1 middle, 2 distal) of every sphere of a finger."""
SPHERE_RADII = np.array([row[1] for row in _SPHERE_ROWS])
"""(10,) radius of every sphere of a finger [m]."""


def _split(joints: Array) -> Array:
    joints = np.asarray(joints, dtype=np.float64)
    return joints.reshape(*joints.shape[:-1], 5, 4) if joints.shape[-1] == 20 else joints


def finger_points(joints: Array, local: list[tuple[int, float, float]]) -> Array:
    """Points that are fixed to finger links, in `hand_tcp`.

    Args:
        joints: (..., 20) or (..., 5, 4) hand joints [rad].
        local: per point (phalanx, y, z): phalanx 0..2 and the coordinates in that link's frame (x = 0) [m].

    Returns:
        (..., 5, len(local), 3) positions [m].
    """
    q = _split(joints)
    yaw, pitch = q[..., 0], q[..., 1]
    angle, origin_y, origin_z = pitch, np.zeros_like(yaw), np.zeros_like(yaw)
    frames = []
    for k, length in enumerate(LINK_LENGTHS):
        frames.append((np.cos(angle), np.sin(angle), origin_y, origin_z))
        origin_y = origin_y + length * np.cos(angle)
        origin_z = origin_z + length * np.sin(angle)
        if k < 2:
            angle = angle + q[..., 2 + k]
    planar = []
    for phalanx, y, z in local:
        cos, sin, oy, oz = frames[phalanx]
        planar.append(np.stack([oy + y * cos - z * sin, oz + y * sin + z * cos], -1))
    yz = np.stack(planar, axis=-2)
    sin, cos, flat = np.sin(yaw)[..., None], np.cos(yaw)[..., None], yz[..., 0]
    points = np.stack([-sin * flat, cos * flat, yz[..., 1]], -1)
    return points @ FINGER_BASES_TCP[:, :3, :3].transpose(0, 2, 1) + FINGER_BASES_TCP[:, None, :3, 3]


def fingertips(joints: Array) -> Array:
    """Fingertip points (..., 5, 3) in `hand_tcp` [m] of (..., 20) or (..., 5, 4) joints [rad]."""
    return finger_points(joints, [(2, LINK_LENGTHS[2], 0.0)])[..., 0, :]


def end_balls(joints: Array) -> Array:
    """Centres (..., 5, 3) in `hand_tcp` of the balls that end the fingers [m]; their radius is `BALL_RADIUS`.

    The fingertip point lies nearly on a ball's surface, 9 mm from its centre: what touches a flat table is the ball.
    """
    return finger_points(joints, [(2, PHALANX_CAPSULES[2].end, PHALANX_CAPSULES[2].height)])[..., 0, :]


def end_ball_jacobian(joints: Array, step: float = 1e-5) -> Array:
    """(..., 5, 3, 3) change of the end balls' centres by yaw, pitch, and middle with distal, by differences [m/rad]."""
    q = _split(joints)
    moves = step * np.array([(1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 1)])
    return np.stack([(end_balls(q + m) - end_balls(q - m)) / (2 * step) for m in moves], axis=-1)


def finger_spheres(joints: Array) -> Array:
    """Centres (..., 5, 10, 3) in `hand_tcp` [m] of the spheres that stand for the fingers; radii in `SPHERE_RADII`."""
    return finger_points(joints, [(k, y, z) for k, _, y, z in _SPHERE_ROWS])


def link_frames(joints: Array) -> Array:
    """Poses (5, 4, 4, 4) in `hand_tcp` of every finger's knuckle, proximal, middle, distal link, for (20,) joints."""
    frames = [FINGER_BASES_TCP]
    for axis, along, angles in zip("zxxx", (0.0, 0.0, *LINK_LENGTHS[:2]), _split(joints).T, strict=True):
        turn = Rotation.from_euler(axis, angles[:, None]).as_matrix()
        frames.append(frames[-1] @ transform(turn, (0.0, along, 0.0)))
    return np.stack(frames[1:], axis=1)


def inverse_kinematics(targets: Array, last: float = LINK_LENGTHS[2]) -> Array:
    """Joint angles that bring the fingertips to given points, clipped to the limits.

    With theta4 = theta3 = m the distance r from joint 2 to the tip depends on m alone and is a quadratic in c = cos m:
    r^2 = L1^2 + L2^2 + L3^2 + 2 L2 (L1 + L3) c + 2 L1 L3 (2 c^2 - 1).

    Args:
        targets: (..., 5, 3) wanted fingertip points in `hand_tcp` [m].
        last: distance of the point from joint 4, along the distal phalanx [m].

    Returns:
        (..., 5, 4) yaw, pitch, theta3, theta4 [rad]; exact to rounding where the target is reachable within the limits.
    """
    l1, l2, _ = LINK_LENGTHS
    local = np.einsum("fji,...fj->...fi", FINGER_BASES_TCP[:, :3, :3], targets - FINGER_BASES_TCP[:, :3, 3])
    distal = np.where(np.abs(local[..., 1]) < 1e-4, 1e-4, local[..., 1])
    yaw = np.clip(np.arctan(-local[..., 0] / distal), FINGER_LOWER[0], FINGER_UPPER[0])
    a = -np.sin(yaw) * local[..., 0] + np.cos(yaw) * local[..., 1]
    b = local[..., 2]
    quadratic, linear = 4 * l1 * last, 2 * l2 * (l1 + last)
    constant = l1 * l1 + l2 * l2 + last * last - 2 * l1 * last - (a * a + b * b)
    root = np.sqrt(np.maximum(linear * linear - 4 * quadratic * constant, 0.0))
    cos = np.clip((root - linear) / (2 * quadratic), -1.0, 1.0)
    middle = np.clip(np.arccos(cos), FINGER_LOWER[2], FINGER_UPPER[2])
    across = l2 * np.sin(middle) + last * np.sin(2 * middle)
    along = l1 + l2 * np.cos(middle) + last * np.cos(2 * middle)
    pitch = np.clip(np.arctan2(b, a) - np.arctan2(across, along), FINGER_LOWER[1], FINGER_UPPER[1])
    return np.stack([yaw, pitch, middle, middle], axis=-1)


def reach_with_balls(targets: Array) -> Array:
    """Joint angles that bring the fingers' end balls to given points, within the limits.

    Args:
        targets: (..., 5, 3) wanted centres in `hand_tcp` [m].

    Returns:
        (..., 5, 4) yaw, pitch, theta3, theta4 [rad]; within 0.1 mm where the target is reachable (tested).
    """
    end, aim = PHALANX_CAPSULES[2].end, targets
    for _ in range(3):  # the balls' centres lie beside the axis by 0.7 mm
        joints = inverse_kinematics(aim, end)
        aim = aim + np.clip(targets - end_balls(joints), -0.001, 0.001)
    return inverse_kinematics(aim, end)


def palm_points(step: float = 0.010) -> Array:
    """Points (P, 3) on the palm boxes' surfaces in `hand_tcp`, about `step` apart [m]."""
    points = []
    for box in PALM_BOXES.reshape(-1, 3, 2):
        axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in box]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        shell = np.ones(grid.shape[:3], dtype=bool)
        shell[1:-1, 1:-1, 1:-1] = False
        points.append(grid[shell])
    return np.unique(np.round(np.concatenate(points) - TCP_IN_BASE, 5), axis=0)


PRE_GRASP_SCALE = np.array([1.0, 0.6, 0.2, 0.2])
"""Share of yaw, pitch, middle, distal that the pre-grasp keeps (paper, equation 9)."""


def pre_grasp(joints: Array, active: NDArray[np.bool_] | None = None) -> Array:
    """Pre-grasp of a final grasp by equation (9): scaled joints for the active fingers, unchanged for the idle ones.

    Args:
        joints: (..., 20) or (..., 5, 4) final joints [rad].
        active: (5,) or (..., 5) which fingers take part; None = all.

    Returns:
        joints of the same shape as given [rad].
    """
    q = _split(joints)
    scaled = q * PRE_GRASP_SCALE
    if active is not None:
        scaled = np.where(np.asarray(active)[..., None], scaled, q)
    return scaled.reshape(np.shape(joints))
