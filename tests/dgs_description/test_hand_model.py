"""Hand kinematics against the makers' parameter sheet, its inverse, and the shapes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dgs_description import hand_model
from dgs_description.hand import HAND
from dgs_description.hand_ik import inverse_kinematics

# The sheet's own numbers, in its own finger frames (x distal, z palmar): origin [m], rpy [rad].
SHEET = {
    "thumb": ((0.062176, 0.044373, 0.078735), (0.225810, -1.083656, 0.411355)),
    "index": ((-0.002530, 0.036800, 0.107784), (3.054326, -np.pi / 2, 0.0)),
    "middle": ((-0.003700, 0.010000, 0.117784), (np.pi, -np.pi / 2, 0.0)),
    "ring": ((-0.002530, -0.016800, 0.112584), (-3.054326, -np.pi / 2, 0.0)),
    "little": ((0.000972, -0.043396, 0.093584), (-2.967060, -np.pi / 2, 0.0)),
}
STRAIGHT_TIPS_MM = {
    "thumb": (107.2, 64.0, 171.5),
    "index": (-2.5, 36.8, 212.8),
    "middle": (-3.7, 10.0, 222.8),
    "ring": (-2.5, -16.8, 217.6),
    "little": (1.0, -43.4, 198.6),
}
TOLERANCE = 1e-5  # 0.01 mm


def sheet_tip(finger: str, angles: np.ndarray) -> np.ndarray:
    """Fingertip in hand_base by the sheet: yaw about z, the three flexions about -y of its frame."""
    origin, rpy = SHEET[finger]
    turn = Rotation.from_euler("xyz", rpy)
    yaw, pitch, middle, distal = angles
    frame = turn * Rotation.from_rotvec([0, 0, yaw])
    point = np.array(origin)
    for angle, length in ((pitch, 0.055), (middle, 0.025), (distal, 0.025)):
        frame = frame * Rotation.from_rotvec([0, -angle, 0])
        point = point + frame.apply([length, 0, 0])
    return point


def random_hands(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(HAND.lower, HAND.upper, (count, 20))


def test_straight_fingertips_are_those_of_the_table() -> None:
    tips = HAND.fingertips(np.zeros(20)) + HAND.T_base_tcp[:3, 3]
    for finger, tip in zip(HAND.fingers, tips, strict=True):
        # The table is rounded to 0.1 mm.
        np.testing.assert_allclose(tip * 1e3, STRAIGHT_TIPS_MM[finger], atol=0.051)


def test_fingertips_follow_the_sheet_within_a_hundredth_of_a_millimetre() -> None:
    hands = random_hands(100)
    tips = HAND.fingertips(hands) + HAND.T_base_tcp[:3, 3]
    for hand, row in zip(HAND.split(hands), tips, strict=True):
        for finger, angles, tip in zip(HAND.fingers, hand, row, strict=True):
            assert np.linalg.norm(tip - sheet_tip(finger, angles)) < TOLERANCE


def test_finger_planes_fan_out_as_the_sheet_says() -> None:
    palmar = HAND.bases[1:, :3, 2]
    np.testing.assert_allclose(np.rad2deg(np.arctan2(palmar[:, 1], palmar[:, 0])), [-5, 0, 5, 10], atol=1e-9)


@pytest.mark.parametrize("shape", [(20,), (7, 20), (2, 3, 20), (5, 4), (6, 5, 4)])
def test_any_number_of_hands_at_once(shape: tuple[int, ...]) -> None:
    q = np.random.default_rng(2).uniform(0, 1, shape)
    batch = shape[:-1] if shape[-1] == 20 else shape[:-2]
    assert HAND.fingertips(q).shape == (*batch, 5, 3)
    assert HAND.finger_spheres(q).shape == (*batch, 5, len(HAND.sphere_radii), 3)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(*(st.floats(0.0, 1.0) for _ in range(3))), min_size=5, max_size=5))
def test_inverse_kinematics_finds_the_way_back(shares: list[tuple[float, float, float]]) -> None:
    lower, upper = HAND.lower[:4], HAND.upper[:4]
    active = lower[:3] + np.array(shares) * (upper - lower)[:3]
    q = np.concatenate([active, active[:, 2:]], axis=1)
    tips = HAND.fingertips(q)
    found = inverse_kinematics(HAND, tips)
    assert (found >= lower - 1e-9).all() and (found <= upper + 1e-9).all()
    np.testing.assert_array_equal(found[:, 2], found[:, 3])
    # Where a fingertip comes to lie on its own yaw axis, any yaw gives the same point.
    np.testing.assert_allclose(HAND.fingertips(found), tips, atol=2e-4)
    off_axis = np.linalg.norm(_in_finger_base(tips)[:, :2], axis=1) > 1e-3
    np.testing.assert_allclose(HAND.fingertips(found)[off_axis], tips[off_axis], atol=1e-6)


def _in_finger_base(tips: np.ndarray) -> np.ndarray:
    bases = HAND.base_poses
    return np.einsum("fji,fj->fi", bases[:, :3, :3], tips - bases[:, :3, 3])


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(*(st.floats(-0.5, 0.5) for _ in range(3))), min_size=5, max_size=5))
def test_inverse_kinematics_of_any_point_stays_within_the_limits(
    targets: list[tuple[float, float, float]],
) -> None:
    found = inverse_kinematics(HAND, np.array(targets))
    assert np.isfinite(found).all()
    assert (found >= HAND.lower[:4]).all() and (found <= HAND.upper[:4]).all()


def _distance_to_capsule_axis(points: np.ndarray, capsule: hand_model.Capsule) -> np.ndarray:
    start, end = np.array([0, capsule.start, capsule.height]), np.array([0, capsule.end, capsule.height])
    along = np.clip((points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * (end - start), axis=1)


@pytest.mark.parametrize("phalanx", [0, 1, 2])
def test_spheres_fill_the_capsules_and_never_leave_them(phalanx: int) -> None:
    capsule = HAND.capsules[0][phalanx]
    own = phalanx == HAND.sphere_phalanx
    # Sphere centres of a straight middle finger, whose finger frame is axis-aligned, in the phalanx' frame.
    T_tcp_link = HAND.link_frames(np.zeros(20))[2, phalanx + 1]
    centres = HAND.finger_spheres(np.zeros(20))[2][own]
    local = (centres - T_tcp_link[:3, 3]) @ T_tcp_link[:3, :3]
    radii = HAND.sphere_radii[own]
    assert (_distance_to_capsule_axis(local, capsule) + radii <= capsule.radius + 1e-12).all()
    # The first and last sphere are the capsule's round ends; between them the surface is a tube along y.
    np.testing.assert_allclose(local[[0, -1], 1], [capsule.start, capsule.end], atol=1e-12)
    y, angle = np.meshgrid(np.linspace(capsule.start, capsule.end, 200), np.linspace(0, 2 * np.pi, 24))
    x, z = capsule.radius * np.cos(angle), capsule.height + capsule.radius * np.sin(angle)
    surface = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    missed = (np.linalg.norm(surface[:, None] - local, axis=2) - radii).min(axis=1)
    assert missed.max() < 0.0022


def test_palm_points_lie_on_the_boxes_surfaces() -> None:
    points = HAND.palm_points(0.01) + HAND.T_base_tcp[:3, 3]
    inside = np.zeros(len(points), dtype=bool)
    on = np.zeros(len(points), dtype=bool)
    for x0, x1, y0, y1, z0, z1 in HAND.palm_boxes:
        low, high = np.array([x0, y0, z0]), np.array([x1, y1, z1])
        margin = np.minimum(points - low, high - points).min(axis=1)
        inside |= margin > 1e-4
        on |= np.abs(margin) < 1e-4
    assert on.all()
    assert inside.mean() < 0.5


def test_pre_grasp_scales_active_fingers_only() -> None:
    q = np.tile([0.2, 1.0, 0.5, 0.5], 5)
    everything = HAND.split(HAND.pre_grasp(q))
    np.testing.assert_allclose(everything, np.tile([0.2, 0.6, 0.1, 0.1], (5, 1)))
    some = HAND.split(HAND.pre_grasp(q, np.array([True, True, False, False, False])))
    np.testing.assert_allclose(some[:2], everything[:2])
    np.testing.assert_allclose(some[2:], HAND.split(q)[2:])
