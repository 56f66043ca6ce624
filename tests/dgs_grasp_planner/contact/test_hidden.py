"""Hidden sides: what a one-sided view lacks comes back, and nothing appears where the camera saw the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import label

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.contact.hidden import NOTHING, HiddenSides, seen
from dgs_grasp_planner.contact.things import CELL
from tests.dgs_grasp_planner.scenes import field_of

CAMERA = np.array([-0.8, 0.0, 0.55])


def can(radius: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Surface points and normals of a lying can (axis y)."""
    angle, along = np.meshgrid(np.linspace(-np.pi, np.pi, 181), np.linspace(-0.5, 0.5, 61))
    angle, along = angle.ravel(), along.ravel()
    normal = np.column_stack([np.cos(angle), np.zeros(len(along)), np.sin(angle)])
    place = np.column_stack([np.zeros(len(along)), length * along, np.full(len(along), radius)])
    return radius * normal + place, normal


def facing(points: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Those that face the camera."""
    return points[(normal * (CAMERA - points)).sum(axis=1) > 0]


def covered(cloud: np.ndarray, camera: np.ndarray | None, at: list[tuple[float, float]]) -> np.ndarray:
    field = field_of(cloud, camera=camera)
    return field.top(np.array(at)) > 0


@pytest.mark.parametrize("radius", [0.03, 0.04])
def test_the_far_side_of_a_lying_can(radius: float) -> None:
    cloud = facing(*can(radius, 0.14))
    behind = [(0.85 * radius, y) for y in (-0.04, 0.0, 0.04)]
    assert not covered(cloud, None, behind).any(), "the camera did not see it"
    assert covered(cloud, CAMERA, behind).all()
    assert not covered(cloud, CAMERA, [(1.6 * radius, 0.0), (0.0, 0.11)]).any()


def test_more_is_feared_than_believed() -> None:
    field = field_of(facing(*can(0.04, 0.14)), camera=CAMERA)
    assert (field.feared >= field.floors).all()
    more = (field.feared > field.floors + 0.01).any(axis=0)
    x = field.low[0] + CELL * (np.argwhere(more)[:, 0] + 0.5)
    assert more.any() and np.median(x) > 0.02, "behind the can, not in front of it"


def test_a_box_that_was_seen_whole_stays_as_it_is() -> None:
    x, y = np.meshgrid(np.arange(-0.03, 0.03, 0.0015), np.arange(-0.05, 0.05, 0.0015))
    cloud = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.06)])
    open_, done = field_of(cloud), field_of(cloud, camera=CAMERA)
    assert (done.heights > 0).sum() <= (open_.heights > 0).sum() * 1.15, "a cell or so behind it"


def test_nothing_is_guessed_where_the_camera_saw_the_table() -> None:
    """An L-shaped block: the rest of the square is open, in full view."""
    x, y = np.meshgrid(np.arange(-0.05, 0.05, 0.0015), np.arange(-0.05, 0.05, 0.0015))
    points = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 0.02)])
    block = points[(points[:, 0] > 0.02) | (points[:, 1] < -0.02)]
    assert not covered(block, CAMERA, [(-0.03, 0.03), (-0.03, 0.0)]).any()


def test_what_is_filled_in_hangs_together_with_its_thing() -> None:
    heights, owner = np.full((120, 80), NOTHING, np.float32), np.zeros((120, 80), np.int32)
    heights[30:45, 30:50], owner[30:45, 30:50] = 0.10, 7
    HiddenSides()(heights, owner, np.array([-0.6, 0.12, 0.25]), np.zeros(2))
    assert ((heights > 0) == (owner == 7)).all() and (owner == 7).sum() > 320
    assert label(owner == 7, structure=np.ones((3, 3)))[1] == 1


def test_where_nothing_stands_nothing_is_made() -> None:
    heights = np.full((30, 30), NOTHING, np.float32)
    HiddenSides()(heights, np.zeros((30, 30), np.int32), CAMERA, np.zeros(2))
    assert (heights == NOTHING).all()


def test_from_right_above_nothing_is_hidden() -> None:
    heights, owner = np.full((60, 60), NOTHING, np.float32), np.zeros((60, 60), np.int32)
    heights[20:40, 20:40], owner[20:40, 20:40] = 0.05, 1
    above = np.array([0.09, 0.09, 1.0])
    assert seen(heights, above, np.zeros(2)).shadow[heights == NOTHING].max() < 0.05
    before = heights.copy()
    HiddenSides()(heights, owner, above, np.zeros(2))
    assert (heights != before).sum() < 20


def test_missing_weights_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DgsError, match="dgs train-hidden-sides") as refused:
        HiddenSides(tmp_path / "none.pt")
    assert refused.value.code == ErrorCode.WEIGHTS_MISSING
