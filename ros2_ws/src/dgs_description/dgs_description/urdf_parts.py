"""The parts that the URDFs are put together from: UR3 arm, hand, and what stands around them.

The sources of all numbers stand in docs/hand.md and docs/cell.md.
"""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description import joints as names
from dgs_description.arm_kinematics import DH_A, arm_kinematics
from dgs_description.cell import CELL
from dgs_description.frames import (
    BASE_LINK,
    CAMERA_LINK,
    HAND_BASE,
    HAND_TCP,
    T_CAMERA_LINK_OPTICAL,
    TOOL0,
    inverse,
)
from dgs_description.hand import HAND
from dgs_description.hand_file import LINKS
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_description.urdf_writer import Box, CapsuleShape, Cylinder, Joint, Limit, Link, Mimic, Robot, Vector

HAND_MOUNT = "hand_mount"

_GREY, _BLUE, _DARK = (0.75, 0.75, 0.78), (0.35, 0.55, 0.75), (0.2, 0.2, 0.22)
_WOOD, _STEEL, _BIN = (0.72, 0.6, 0.45), (0.5, 0.5, 0.52), (0.3, 0.45, 0.35)
_LEG = 0.06
"""Width of the legs of table and bin [m]."""


def vector(values: NDArray[np.float64]) -> Vector:
    """Three plain floats of a (3,) array."""
    x, y, z = (float(value) for value in values)
    return (x, y, z)


def _origin(T_parent_child: NDArray[np.float64]) -> tuple[Vector, Vector]:
    """xyz [m] and fixed-axis rpy [rad] of a (4, 4) transform."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a part at right angles: any of its angles will do
        turn = Rotation.from_matrix(T_parent_child[:3, :3]).as_euler("xyz")
    return vector(T_parent_child[:3, 3]), vector(turn)


def arm() -> Robot:
    """UR3 (CB3) from `base_link` to `tool0`.

    The joints' frames follow the maker's description: z is the joint axis, `wrist_3_link` coincides with `tool0`.
    """
    links = (Link(BASE_LINK), *_arm_links(), Link(TOOL0))
    joints = [Joint("base_link_base_fixed", BASE_LINK, "base_link_inertia", rpy=(0, 0, np.pi))]
    for k, (name, T_parent_joint) in enumerate(zip(names.ARM_JOINTS, arm_kinematics().origins, strict=True)):
        limit = Limit(names.ARM_LOWER[k], names.ARM_UPPER[k], names.ARM_EFFORT[k], names.ARM_VELOCITY[k])
        joints.append(
            Joint(name, links[k + 1].name, links[k + 2].name, *_origin(T_parent_joint), (0, 0, 1), limit)
        )
    joints.append(Joint("tool0_fixed", "wrist_3_link", TOOL0))
    return Robot("ur3", links, tuple(joints))


def _arm_links() -> tuple[Link, ...]:
    """Links of the UR3 with cylinders around the outer extents of its joint housings and tubes."""
    _, a2, a3, *_ = DH_A  # x of the elbow in the upper arm's, of the wrist in the forearm's frame
    upper, fore = 0.1198, 0.0275  # z of the upper arm's and the forearm's tube in their link frames
    shoulder = _housing("z", 0.046, -0.066, 0.057), _housing("y", 0.046, -0.054, 0.0)
    upper_arm = (
        _housing("z", 0.046, 0.054, 0.177),
        CapsuleShape(0.041, (0.0, 0.0, upper), (a2, 0.0, upper)),
        _housing("z", 0.039, 0.069, 0.177, x=a2),
    )
    forearm = (
        _housing("z", 0.038, -0.001, 0.078),
        CapsuleShape(0.031, (0.0, 0.0, fore), (a3, 0.0, fore)),
        _housing("z", 0.032, -0.019, 0.070, x=a3),
    )
    wrist_1 = _housing("z", 0.033, -0.046, 0.030), _housing("y", 0.033, -0.042, 0.046)
    wrist_2 = _housing("z", 0.033, -0.046, 0.030), _housing("y", 0.033, -0.048, 0.041)
    return (
        Link("base_link_inertia", (_housing("z", 0.064, 0.0, 0.086),), 2.0, colour=_GREY),
        Link("shoulder_link", shoulder, 2.0, (0.0, 0.0, -0.02), _BLUE),
        Link("upper_arm_link", upper_arm, 3.42, (-0.11365, 0.0, 0.1157), _GREY),
        Link("forearm_link", forearm, 1.26, (-0.16325, 0.0, 0.0238), _GREY),
        Link("wrist_1_link", wrist_1, 0.8, (0.0, -0.01, 0.0), _BLUE),
        Link("wrist_2_link", wrist_2, 0.8, (0.0, 0.01, 0.0), _BLUE),
        Link("wrist_3_link", (_housing("z", 0.033, -0.041, -0.001),), 0.35, (0.0, 0.0, -0.02), _GREY),
    )


def _housing(axis: str, radius: float, low: float, high: float, x: float = 0.0) -> Cylinder:
    """Cylinder along the link's y or z from `low` to `high` on that axis, shifted by `x` [m]."""
    middle = (low + high) / 2
    if axis == "z":
        return Cylinder(radius, high - low, (x, 0.0, middle))
    return Cylinder(radius, high - low, (x, middle, 0.0), (np.pi / 2, 0.0, 0.0))


def palm_link() -> Link:
    """`hand_base` with the palm's boxes."""
    boxes = tuple(
        Box((x1 - x0, y1 - y0, z1 - z0), ((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2))
        for x0, x1, y0, y1, z0, z1 in HAND.palm_boxes.tolist()
    )
    return Link(HAND_BASE, boxes, HAND.palm.mass, HAND.palm.centre_of_mass, _DARK)


def phalanx_shapes() -> list[list[CapsuleShape]]:
    """Per finger the capsules of its proximal, middle and distal link, in the link's frame."""
    return [
        [CapsuleShape(c.radius, (0, c.start, c.height), (0, c.end, c.height)) for c in capsules]
        for capsules in HAND.capsules
    ]


def fingers() -> Robot:
    """The fingers on `hand_base`: links, all joints, and the fingertip frames. A locked joint has a play of 1 mrad."""
    links: list[Link] = []
    joints: list[Joint] = []
    capsules = phalanx_shapes()
    for f, finger in enumerate(HAND.fingers):
        parent = HAND_BASE
        for k, name in enumerate(LINKS):
            link = f"{finger}_{name}"
            shapes = (capsules[f][k - 1],) if k > 0 else ()
            facts, row = HAND.links[k], f * JOINTS_PER_FINGER + k
            links.append(Link(link, shapes, facts.mass, facts.centre_of_mass, _GREY if k < 3 else _DARK))
            xyz, rpy = _origin(HAND.bases[f]) if k == 0 else (vector(HAND.steps[f, k - 1]), (0.0, 0.0, 0.0))
            upper = HAND.upper[row] + (1e-3 if HAND.locked[row] else 0.0)
            limit = Limit(float(HAND.lower[row]), float(upper), float(HAND.effort[row]), HAND.speed)
            source = HAND.source[row]
            mimic = None if source == row else Mimic(HAND.joints[source], float(HAND.ratio[row]))
            axis, dynamics = vector(HAND.axes[f, k]), (HAND.damping, HAND.friction)
            joints.append(Joint(HAND.joints[row], parent, link, xyz, rpy, axis, limit, *dynamics, mimic))
            parent = link
        links.append(Link(f"{finger}_tip"))
        tip = vector(HAND.steps[f, -1])
        joints.append(Joint(f"{finger}_tip_fixed", parent, f"{finger}_tip", tip))
    return Robot("fingers", tuple(links), tuple(joints))


def hand() -> Robot:
    """The hand with root `hand_mount`, the flange face that sits on the arm's `tool0`."""
    base = Joint("hand_base_fixed", HAND_MOUNT, HAND_BASE, *_origin(HAND.T_mount_base))
    tcp = Joint("hand_tcp_fixed", HAND_BASE, HAND_TCP, *_origin(HAND.T_base_tcp))
    return Robot("dexhand", (Link(HAND_MOUNT), palm_link(), Link(HAND_TCP)), (base, tcp)) + fingers()


def floating_hand() -> Robot:
    """The hand with root `hand_tcp`, for simulations that move the hand by its TCP."""
    joint = Joint("hand_base_fixed", HAND_TCP, HAND_BASE, *_origin(inverse(HAND.T_base_tcp)))
    return Robot("floating_hand", (Link(HAND_TCP), palm_link()), (joint,)) + fingers()


def surroundings() -> Robot:
    """Table, pedestal, bin and camera on its stand, fixed to `base_link` (root, without shape of its own)."""
    links = [Link(BASE_LINK), *_furniture(), *_camera()]
    joints = [Joint(f"{link.name}_fixed", BASE_LINK, link.name) for link in links[1:-2]]
    joints += [
        Joint("camera_link_fixed", BASE_LINK, CAMERA_LINK, *_origin(CELL.T_base_camera_link)),
        Joint("camera_depth_optical_fixed", CAMERA_LINK, CELL.optical_frame, *_origin(T_CAMERA_LINK_OPTICAL)),
    ]
    return Robot("surroundings", tuple(links), tuple(joints))


def _furniture() -> list[Link]:
    """Table, pedestal and bin; their link frames coincide with `base_link`."""
    top, floor = CELL.table_height, CELL.floor_height
    (x, y), (length, width, thickness) = CELL.table_centre, CELL.table_size
    leg, under = (_LEG, _LEG, top - thickness - floor), (top - thickness + floor) / 2
    corners = [
        (x + i * (length - _LEG) / 2, y + j * (width - _LEG) / 2, under) for i in (-1, 1) for j in (-1, 1)
    ]
    board = Box(CELL.table_size, (x, y, top - thickness / 2))
    table = Link("table", (board, *(Box(leg, corner) for corner in corners)), 20.0, colour=_WOOD)
    column = Cylinder(CELL.pedestal_radius, -floor, (0, 0, floor / 2))
    pedestal = Link("pedestal", (column,), 20.0, colour=_STEEL)
    (x, y), (length, width, depth), wall = CELL.bin_centre, CELL.bin_size, CELL.bin_wall
    middle = top + depth / 2
    stand = Box((_LEG, _LEG, top - floor), (x, y, (top + floor) / 2))
    sides = (
        Box((length, width, wall), (x, y, top + wall / 2)),
        Box((wall, width, depth), (x - (length - wall) / 2, y, middle)),
        Box((wall, width, depth), (x + (length - wall) / 2, y, middle)),
        Box((length, wall, depth), (x, y - (width - wall) / 2, middle)),
        Box((length, wall, depth), (x, y + (width - wall) / 2, middle)),
    )
    return [table, pedestal, Link("bin", (*sides, stand), 1.0, colour=_BIN)]


def _camera() -> list[Link]:
    """Camera stand (frame = `base_link`), D455 body at `camera_link`, and the optical frame.

    How a camera stands whose pose was measured nobody has said: it has a body, but no stand.
    """
    x, y, z = CELL.T_base_camera_optical[:3, 3].tolist()
    # The pole stands behind the camera as the workspace sees it, outside the view and off the table.
    y_body = y + 0.0475
    pole_x = max(x + 0.07, CELL.table_centre[0] + CELL.table_size[0] / 2 + 0.03)
    corner = (pole_x, y_body, z + 0.02)
    pole = CapsuleShape(0.015, (pole_x, y_body, CELL.floor_height), corner)
    arm = CapsuleShape(0.010, (x + 0.02, y_body, z + 0.02), corner)
    measured = CELL.camera_position is not None
    stand = Link("camera_stand", () if measured else (pole, arm), 3.0, colour=_STEEL)
    # 124 x 29 x 26 mm body; camera_link is the left imager on the front face, 47.5 mm left of the body's centre.
    body = Box((0.026, 0.124, 0.029), (-0.013, -0.0475, 0.0))
    return [stand, Link(CAMERA_LINK, (body,), 0.38, colour=_DARK), Link(CELL.optical_frame)]
