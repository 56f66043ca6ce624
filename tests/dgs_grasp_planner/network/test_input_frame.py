"""The network's input frames."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_grasp_planner.network.input_frame import table_from_input


def test_table_frame_is_the_table_frame() -> None:
    np.testing.assert_array_equal(table_from_input("table", (1.0, 2.0, 3.0)), np.eye(4))


@pytest.mark.parametrize("position", [(0.47, 0.0, 0.88), (-0.3, 0.5, 0.7), (0.0, 0.0, 1.0)])
def test_camera_frame_looks_at_the_origin_and_is_level(position: tuple[float, float, float]) -> None:
    T_table_camera = table_from_input("camera", position)
    np.testing.assert_allclose(T_table_camera[:3, :3] @ T_table_camera[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T_table_camera[:3, :3]) == pytest.approx(1.0)
    origin = -T_table_camera[:3, :3].T @ T_table_camera[:3, 3]
    np.testing.assert_allclose(origin, [0, 0, np.linalg.norm(position)], atol=1e-12)
    assert T_table_camera[2, 0] == pytest.approx(0.0, abs=1e-12)
