"""Hidden sides: what a one-sided view lacks comes back, and nothing appears where the camera saw the table."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_grasp_planner.contact.height_field import height_field

CAMERA = np.array([-0.8, 0.0, 0.55])
TOWARDS = CAMERA / np.linalg.norm(CAMERA)


def can(radius: float, height: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Surface points and normals of a lying can (axis y) of `radius`, or where `height` > 0 of a standing one."""
    angle, along = np.meshgrid(np.linspace(-np.pi, np.pi, 181), np.linspace(-0.5, 0.5, 61))
    around = np.stack([np.cos(angle), np.sin(angle)], -1).reshape(-1, 2)
    along = along.reshape(-1)
    if height == 0:
        normal = np.column_stack([around[:, 0], np.zeros(len(along)), around[:, 1]])
        return radius * normal + np.column_stack(
            [np.zeros(len(along)), length * along, np.full(len(along), radius)]
        ), normal
    normal = np.column_stack([around, np.zeros(len(along))])
    return radius * normal + np.column_stack([np.zeros((len(along), 2)), height * (along + 0.5)]), normal


def seen(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Those that face the camera."""
    return points[(normal * (CAMERA - points)).sum(axis=1) > 0]


def covered(cloud: np.ndarray, camera: np.ndarray | None, at: list[tuple[float, float]]) -> np.ndarray:
    field = height_field(cloud, camera)
    assert field is not None
    return field.top(np.array(at)) > 0


@pytest.mark.parametrize("radius", [0.03, 0.04])
def test_the_far_side_of_a_lying_can(radius: float) -> None:
    cloud = seen(*can(radius, 0.0, 0.14))
    behind = [(0.85 * radius, y) for y in (-0.04, 0.0, 0.04)]
    assert not covered(cloud, None, behind).any(), "the camera did not see it"
    assert covered(cloud, CAMERA, behind).all()
    assert not covered(cloud, CAMERA, [(1.6 * radius, 0.0), (0.0, 0.11)]).any()


def test_a_box_that_was_seen_whole_stays_as_it_is() -> None:
    x, y = np.meshgrid(np.arange(-0.03, 0.03, 0.0015), np.arange(-0.05, 0.05, 0.0015))
    cloud = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.06)])
    open_, done = height_field(cloud), height_field(cloud, CAMERA)
    assert open_ is not None and done is not None
    assert (done.heights > 0).sum() <= (open_.heights > 0).sum() * 1.05


def test_nothing_is_guessed_where_the_camera_saw_the_table() -> None:
    """An L-shaped block: its mirror image would stand in the open, in full view."""
    x, y = np.meshgrid(np.arange(-0.05, 0.05, 0.0015), np.arange(-0.05, 0.05, 0.0015))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.02)])
    block = points[(points[:, 0] > 0.02) | (points[:, 1] < -0.02)]
    assert not covered(block, CAMERA, [(-0.03, 0.03), (-0.03, 0.0)]).any()
