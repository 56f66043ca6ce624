"""Shape completion: what a one-sided view lacks comes back, and nothing appears where the camera saw the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import label

from dgs_description.errors import ErrorCode
from dgs_grasp_planner.contact.height_field import HeightField, height_field, seen_heights
from dgs_grasp_planner.contact.shape_completion import NOTHING, REACH, complete, loaded_net, seen
from dgs_grasp_planner.contact.things import CELL
from tests.dgs_grasp_planner.scenes import field_of, top
from tests.support.refused import refused

CAMERA = np.array([-0.8, 0.0, 0.55])
EMPTY = np.zeros((0, 3), np.float32)


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


def table_around(cloud: np.ndarray) -> np.ndarray:
    """Points of the table that the camera sees around a cloud: not below it, and not behind what it throws."""
    table = top((-0.15, 0.25), (-0.15, 0.15), 0.0, step=0.002)
    high = cloud[cloud[:, 2] > 0.01]
    shadow = CAMERA + (high - CAMERA) * (CAMERA[2] / (CAMERA[2] - high[:, 2]))[:, None]
    dark = np.zeros((134, 100), bool)
    for way in np.linspace(0.0, 1.0, 40):
        points = high + way * (shadow - high)
        i, j = np.floor((points[:, :2] + 0.15) / CELL).astype(int).T
        inside = (i >= 0) & (i < 134) & (j >= 0) & (j < 100)
        dark[i[inside], j[inside]] = True
    i, j = np.floor((table[:, :2] + 0.15) / CELL).astype(int).T
    return table[~dark[np.minimum(i, 133), np.minimum(j, 99)]]


def completed(cloud: np.ndarray) -> HeightField:
    return height_field(cloud, CAMERA, table_around(cloud))


def covered(field: HeightField, at: list[tuple[float, float]]) -> np.ndarray:
    return field.top(np.array(at)) > 0


@pytest.mark.parametrize("radius", [0.03, 0.04])
def test_the_far_side_of_a_lying_can(radius: float) -> None:
    cloud = facing(*can(radius, 0.14))
    behind = [(0.85 * radius, y) for y in (-0.04, 0.0, 0.04)]
    assert not covered(field_of(cloud), behind).any(), "the camera did not see it"
    field = completed(cloud)
    assert covered(field, behind).all()
    assert not covered(field, [(1.6 * radius, 0.0), (0.0, 0.11)]).any()


def test_more_is_feared_than_believed() -> None:
    field = completed(facing(*can(0.04, 0.14)))
    assert (field.feared >= field.floors).all()
    more = (field.feared > field.floors + 0.01).any(axis=0)
    x = field.low[0] + CELL * (np.argwhere(more)[:, 0] + 0.5)
    assert more.any() and np.median(x) > 0.02, "behind the can, not in front of it"


def test_a_box_that_was_seen_whole_stays_as_it_is() -> None:
    cloud = top((-0.03, 0.03), (-0.05, 0.05), 0.06)
    open_, done = field_of(cloud), completed(cloud)
    assert (done.heights > 0).sum() == pytest.approx((open_.heights > 0).sum(), rel=0.15), "a cell or so"
    there = covered(done, [(0.0, 0.0), (0.02, 0.04), (-0.02, -0.04)])
    assert there.all() and done.heights.max() == pytest.approx(0.06, abs=0.006)


def test_nothing_is_guessed_where_the_camera_saw_the_table() -> None:
    """An L-shaped block: the rest of the square is open, in full view."""
    square = top((-0.05, 0.05), (-0.05, 0.05), 0.02)
    block = square[(square[:, 0] > 0.02) | (square[:, 1] < -0.02)]
    assert not covered(completed(block), [(-0.03, 0.03), (-0.03, 0.0)]).any()


def test_what_is_made_hangs_together_with_what_is_seen() -> None:
    cloud = np.concatenate([facing(*can(0.04, 0.1)), [[0.2, 0.1, 0.03]]])
    field = completed(cloud)
    assert ((field.heights > 0) == (field.owner > 0)).all() and (field.owner > 0).sum() > 600
    assert label(field.owner > 0, structure=np.ones((3, 3)))[1] == 1, "a single point is noise"
    assert ((field.things > 0) == (field.owner > 0)).all()


def test_where_nothing_stands_nothing_is_made() -> None:
    heights, owner = np.full((30, 30), NOTHING, np.float32), np.zeros((30, 30), np.int32)
    whole, feared, _, things = complete(heights, owner, EMPTY, EMPTY, CAMERA, np.zeros(2))
    assert (whole == NOTHING).all() and (feared == NOTHING).all() and not things.any()


def test_features_say_what_was_seen_of_things_and_table() -> None:
    cloud, table = top((0.0, 0.06), (0.0, 0.06), 0.05), np.array([[-0.0207, 0.0307, 0.001]])
    below = np.array([[0.0307, 0.0307, 0.01]])
    high = np.concatenate([cloud, below]).astype(np.float32)
    heights, _, low = seen_heights(high, REACH) or pytest.fail("nothing was seen")
    features = seen(heights, high, table.astype(np.float32), np.array([0.03, 0.03, 1.0]), low).features
    at = tuple(np.floor((below[0, :2] - low) / CELL).astype(int))
    np.testing.assert_allclose(features[[0, 1, 6, 7], at[0], at[1]], (0.5, 1.0, 0.5, 0.1), atol=1e-5)
    assert (
        features[8].sum() == 1 and features[8][tuple(np.floor((table[0, :2] - low) / CELL).astype(int))] == 1
    )


def test_from_right_above_little_is_hidden() -> None:
    heights = np.full((60, 60), NOTHING, np.float32)
    heights[20:40, 20:40] = 0.05
    shadow = seen(heights, EMPTY, EMPTY, np.array([0.09, 0.09, 1.0]), np.zeros(2)).shadow
    assert shadow[heights == NOTHING].max() < 0.05


def test_missing_weights_are_refused(tmp_path: Path) -> None:
    with refused(ErrorCode.WEIGHTS_MISSING, "dgs train-shape-completion"):
        loaded_net(tmp_path / "none.pt")
