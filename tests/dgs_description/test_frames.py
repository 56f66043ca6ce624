"""Rigid transforms, and that the cell's parts stand clear of each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from dgs_description import frames
from dgs_description.cell import CELL

quaternions = st.tuples(*(st.floats(-1, 1) for _ in range(4))).filter(lambda q: np.linalg.norm(q) > 0.1)
positions = st.tuples(*(st.floats(-2, 2) for _ in range(3)))


@given(positions, quaternions)
def test_quaternion_round_trip_and_inverse(
    position: tuple[float, ...], quaternion: tuple[float, ...]
) -> None:
    T_a_b = frames.from_quaternion(position, quaternion)
    back = frames.from_quaternion(*frames.to_quaternion(T_a_b))
    np.testing.assert_allclose(back, T_a_b, atol=1e-9)
    np.testing.assert_allclose(frames.inverse(T_a_b) @ T_a_b, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(frames.inverse(np.stack([T_a_b, np.eye(4)]))[0], frames.inverse(T_a_b))


def test_apply_moves_points_from_b_to_a() -> None:
    T_a_b = frames.transform(Rotation.from_euler("z", 90, degrees=True).as_matrix(), (1, 2, 3))
    np.testing.assert_allclose(
        frames.apply(T_a_b, np.array([[1.0, 0, 0], [0, 1, 0]])), [[1, 3, 3], [0, 2, 3]]
    )


def test_rpy_is_urdfs_fixed_axis_convention() -> None:
    roll, pitch, yaw = 0.3, -0.4, 1.2
    expected = (
        Rotation.from_rotvec([0, 0, yaw])
        * Rotation.from_rotvec([0, pitch, 0])
        * Rotation.from_rotvec([roll, 0, 0])
    )
    np.testing.assert_allclose(
        frames.from_rpy((0, 0, 0), (roll, pitch, yaw))[:3, :3], expected.as_matrix(), atol=1e-12
    )


def test_look_at_sees_the_target_in_the_image_centre() -> None:
    T = frames.look_at((1, 2, 3), (0.2, -0.1, 0.5))
    target = frames.apply(frames.inverse(T), np.array([[0.2, -0.1, 0.5]]))[0]
    np.testing.assert_allclose(target[:2], 0, atol=1e-12)
    assert target[2] > 0
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    # Up in the world is up in the image, which is -y of the optical frame.
    assert T[2, 1] < 0


def test_camera_looks_at_the_workspace_from_its_distance() -> None:
    centre = CELL.T_base_table[:3, 3]
    in_camera = frames.apply(frames.inverse(CELL.T_base_camera_optical), centre[None])[0]
    np.testing.assert_allclose(in_camera, [0, 0, CELL.camera_distance], atol=1e-12)


def test_workspace_lies_on_the_table_and_clear_of_pedestal_and_bin() -> None:
    low, high = CELL.workspace_bounds
    table_low = np.array(CELL.table_centre) - np.array(CELL.table_size[:2]) / 2
    table_high = table_low + CELL.table_size[:2]
    assert (low[:2] >= table_low).all() and (high[:2] <= table_high).all()
    assert low[0] > CELL.pedestal_radius
    bin_high_x = CELL.bin_centre[0] + CELL.bin_size[0] / 2
    assert bin_high_x < low[0]
    assert (
        np.linalg.norm(np.maximum(np.abs(CELL.bin_centre) - np.array(CELL.bin_size[:2]) / 2, 0))
        > CELL.pedestal_radius
    )


def test_clouds_fit_into_the_cameras_view_and_reach_over_the_table() -> None:
    """At 87 x 58 degrees all of the table that clouds are cut to is in the picture."""
    low, high = CELL.cloud_bounds
    table = np.array(CELL.table_centre) + np.array(CELL.table_size[:2]) / 2
    assert (high[:2] < table).all() and low[1] > -table[1] and low[0] < CELL.table_edge
    corners = np.array([[x, y, CELL.table_height] for x in (low[0], high[0]) for y in (low[1], high[1])])
    seen = frames.apply(frames.inverse(CELL.T_base_camera_optical), corners)
    angles = np.rad2deg(np.arctan2(np.abs(seen[:, :2]), seen[:, 2:]))
    assert (angles[:, 0] < 87 / 2).all() and (angles[:, 1] < 58 / 2).all()
