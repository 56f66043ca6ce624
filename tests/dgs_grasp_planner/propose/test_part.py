"""Partings: of what is told apart alone, past the others until there is a gap, and not to where things fall."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_grasp_planner.check import check
from dgs_grasp_planner.planner import DOUBTFUL, HOPELESS, UNPROMISING, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose.level_pinch import LevelPinch
from dgs_grasp_planner.propose.part import BEHIND, GRAZING, HEIGHT, LEAST, OUTWARDS, TOWARDS, Part, partings
from dgs_grasp_planner.propose.push import Push, pushes
from tests.dgs_grasp_planner.contact.test_things import STEP, block
from tests.dgs_grasp_planner.propose.test_edge_pinch import EDGE, case
from tests.dgs_grasp_planner.scenes import CAMERA, apart, field_of, on_table
from tests.support.hands import in_process_of

LOW, HIGH = block(0.0, 0.04, (0.07, 0.07), 0.03), block(0.0, -0.032, (0.07, 0.07), 0.07)


def test_a_thing_is_pushed_past_the_other_until_there_is_a_gap() -> None:
    field = apart(LOW, HIGH)
    things, found = field.separated, partings(apart(LOW, HIGH))
    assert len(found) and not found.holds.any() and set(found.source) == {"part"}
    assert check(found, np.concatenate([LOW, HIGH])[::7]).accepted.all()
    for push in found:
        (pushed,) = things.nearest(push.reference_point[None], 0.05)
        assert abs(push.motion[1]) < abs(push.motion[0]), "past it, not against it"
        way = push.motion * (1 - BEHIND / np.linalg.norm(push.motion))
        moved = things.shapes[int(pushed)].points + way[:2]
        rest = things.middles(np.argwhere((things.owner > 0) & (things.owner != pushed)))
        gap = np.linalg.norm(moved[:, None] - rest, axis=-1).min(axis=1)
        assert np.quantile(gap, 2 * GRAZING) > LEAST


def test_the_fingers_stand_behind_the_thing_and_beside_the_other() -> None:
    upright = partings(apart(LOW, HIGH)).best_first()[0]
    spheres = HAND.finger_spheres(upright.pre_grasp_joints) @ upright.rotation.T + upright.position
    both = np.concatenate([LOW, HIGH])
    away = np.linalg.norm(spheres[:, :, None, :2] - both[::5, :2], axis=-1)
    low = (spheres[..., 2] - HAND.sphere_radii) < both[:, 2].min()
    assert (away.min(axis=2) - HAND.sphere_radii)[low].min() > 0.002


@pytest.mark.parametrize("blocks", [(case(),), (LOW, HIGH + (0.0, -0.05, 0.0)), (LOW, HIGH * (1, 1, 3))])
def test_one_thing_things_apart_and_high_things_stay(blocks: tuple[np.ndarray, ...]) -> None:
    found = partings(apart(*blocks))
    assert not len(found) or (found.reference_point[:, 2] < HEIGHT).all()
    if len(blocks) == 1 or blocks[1][:, 2].max() < 0.1:
        assert not len(found)


@pytest.mark.parametrize("place", [(0.1, 0.2), (-0.3, 0.1), (-0.1, -0.3)])
def test_nothing_is_pushed_away_from_the_middle_of_the_workspace(place: tuple[float, float]) -> None:
    found = partings(apart(LOW + (*place, 0.0), HIGH + (*place, 0.0)))
    ways = found.motion * (1 - BEHIND / np.linalg.norm(found.motion, axis=1, keepdims=True))
    before, after = (
        np.linalg.norm(where[:, :2], axis=1)
        for where in (found.reference_point, found.reference_point + ways)
    )
    assert len(found) and (after <= np.maximum(before, TOWARDS) + 2 * OUTWARDS).all()


def test_the_planner_parts_after_pushes_and_likely_grasps() -> None:
    planner = GraspPlanner([LevelPinch(), Push(), Part()], PlannerSettings(edge=EDGE, max_grasps=500))
    rod = block(0.05, 0.3, (0.02, 0.15), 0.02)
    scene = on_table(*STEP, rod, case(-0.05, y=-0.3))
    grasps = planner(scene, CAMERA, np.random.default_rng(0)).grasps
    kinds = np.select(
        [grasps.source == "part", ~grasps.holds, grasps.score < HOPELESS, grasps.score < DOUBTFUL],
        [3, 1, 4, 2],
        0,
    )
    assert {1, 3} <= set(kinds.tolist()) and (np.diff(kinds) >= 0).all()


def test_what_touches_is_parted_before_it_is_pushed_to_the_edge() -> None:
    wide = block(0.0, 0.0, (0.12, 0.12), 0.03), block(0.12, 0.0, (0.12, 0.12), 0.06)
    together, alone = pushes(apart(*wide), EDGE), pushes(field_of(wide[0]), EDGE)
    assert len(together) and (together.score < UNPROMISING).all() and alone.score.max() > 0.5
    planner = GraspPlanner([Push(), Part()], PlannerSettings(edge=EDGE, max_grasps=500))
    scene = on_table(*wide)
    grasps = planner(scene, CAMERA, np.random.default_rng(0)).grasps
    assert (grasps.source == "part").any() and grasps[0].source == "part"


def test_a_hand_that_leans_over_the_thing_without_meeting_it_pushes_nothing() -> None:
    code = """
import numpy as np
from dgs_grasp_planner.propose.part import partings
from tests.dgs_grasp_planner.contact.test_things import block
from tests.dgs_grasp_planner.scenes import apart
found = partings(apart(block(0.0, 0.04, (0.07, 0.07), 0.02), block(0.0, -0.032, (0.07, 0.07), 0.07)))
print(len(found), np.isfinite(found.position).all() and np.isfinite(found.motion).all())
"""
    count, sound = in_process_of("dexhand_021", code).split()[-2:]
    assert int(count) > 0 and sound == "True"
