"""Pushes: of what is too wide alone, towards the edge and not over it, with nothing else in the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.frames import OBJECT_HEIGHT
from dgs_description.hand import HAND
from dgs_grasp_planner.check import check
from dgs_grasp_planner.planner import DOUBTFUL, GraspPlanner, PlannerSettings
from dgs_grasp_planner.propose.edge_pinch import BALANCE, EdgePinch, edge_pinches
from dgs_grasp_planner.propose.push import (
    ASIDE,
    CLEARANCE,
    GAPS,
    LEANS,
    OUTSIDE,
    OVERHANG,
    SHORT,
    Push,
    PushSettings,
    heights_beside,
    pushes,
)
from tests.dgs_grasp_planner.contact.test_closing import bar
from tests.dgs_grasp_planner.propose.test_edge_pinch import EDGE, case
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, table_scene, top

FRONT, BACK = -0.05, 0.08


def limit(monkeypatch: pytest.MonkeyPatch, turn: float, *leans: float) -> None:
    """To pushes that are turned, with hands that lean so much [deg], and with the wider gap."""
    for name, values in (("TURNS", np.deg2rad([turn])), ("GAPS", GAPS[:1]), ("LEANS", np.deg2rad(leans))):
        monkeypatch.setattr(f"dgs_grasp_planner.propose.push.{name}", tuple(values))


def test_the_backs_of_two_fingers_push_the_far_side_towards_the_edge() -> None:
    field = field_of(case(FRONT))
    best = pushes(field, EDGE).best_first()[:1]
    straight = best[0]
    assert straight.source == "push" and not straight.holds
    np.testing.assert_array_equal(straight.pre_grasp_joints, straight.grasp_joints)
    np.testing.assert_allclose(straight.motion[1:], 0.0, atol=1e-12)
    balls = HAND.end_balls(straight.grasp_joints)[[1, 3]] @ straight.rotation.T + straight.position
    np.testing.assert_allclose(balls[0, [0, 2]], balls[1, [0, 2]], atol=0.002)
    np.testing.assert_allclose(balls[:, 0] - HAND.ball_radius, BACK + GAPS[0], atol=0.006)
    np.testing.assert_allclose(balls[:, 1].mean(), 0.0, atol=0.004)
    spheres = HAND.finger_spheres(straight.grasp_joints) @ straight.rotation.T + straight.position
    assert (spheres[..., 2] - HAND.sphere_radii).min() == pytest.approx(CLEARANCE)
    middle = (FRONT + BACK) / 2 + straight.motion[0] + GAPS[0]
    assert EDGE < middle < EDGE + 0.05, "it does not tip"
    assert check(best, case(FRONT)[::7], edge=EDGE).accepted.all()


@pytest.mark.parametrize("thickness", [0.02, 0.03])
def test_leaning_the_wrist_is_ahead_and_the_fingers_are_still_behind_the_thing(
    thickness: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit(monkeypatch, 0.0, 0.0, 45.0)
    upright, leans = pushes(field_of(case(FRONT, height=thickness)), EDGE)
    assert leans.score < upright.score and leans.rotation[2, 2] == pytest.approx(-np.cos(np.pi / 4), abs=0.02)
    np.testing.assert_allclose(leans.motion, upright.motion)
    spheres = HAND.finger_spheres(leans.grasp_joints) @ leans.rotation.T + leans.position
    above = np.maximum(spheres[..., 2] - thickness, 0.0)
    low, reach = above < HAND.sphere_radii, np.sqrt(np.maximum(HAND.sphere_radii**2 - above**2, 0.0))
    clear = (spheres[..., 0] - reach)[low].min() - BACK
    assert clear == pytest.approx(GAPS[0], abs=0.006), "from the thing to the fingers beside it"
    wrist = leans.position - 0.17 * leans.rotation[:, 2]
    assert wrist[0] < upright.position[0] - 0.05


@pytest.mark.parametrize(("lean", "leans"), [(25.0, True), (45.0, False)])
def test_the_palm_leans_over_nothing_that_it_would_press_down(
    lean: float, leans: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit(monkeypatch, 0.0, lean)
    assert bool(len(pushes(field_of(case(FRONT, height=0.055)), EDGE))) == leans


def test_what_is_ragged_or_turns_on_its_way_stays_farther_from_the_edge(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def way(cloud: np.ndarray, turn: float, short: float = SHORT) -> float:
        """How far towards the edge the push goes that is turned so much [deg]."""
        limit(monkeypatch, turn, 0.0)
        monkeypatch.setattr("dgs_grasp_planner.propose.push.SHORT", short)
        return -float(pushes(field_of(cloud), EDGE)[0].motion[0])

    full = case(FRONT)
    x, y = full[:, 0] - full[:, 0].min(), np.abs(full[:, 1])
    ragged = full[(y < 0.02) | (x < 0.02) | (x > 0.11)]
    assert way(ragged, 0.0) < way(full, 0.0) - 0.006
    assert way(full, 40.0) == pytest.approx(way(full, 40.0, short=0.0) - SHORT * np.tan(np.deg2rad(40.0)))
    assert way(full, 0.0) == way(full, 0.0, short=0.0)


def test_a_round_far_side_is_met_beside_its_middle() -> None:
    """The two fingers touch it later than one in the middle would, so they have to go farther."""
    disc = case(FRONT)
    disc = disc[np.hypot(disc[:, 0] - 0.015, disc[:, 1]) < 0.065]
    push, straight = (pushes(field_of(cloud), EDGE).best_first()[0] for cloud in (disc, case(FRONT)))
    balls = HAND.end_balls(push.grasp_joints)[[1, 3]] @ push.rotation.T + push.position
    away = np.linalg.norm(balls[:, :2] - (0.015, 0.0), axis=1) - 0.065 - HAND.ball_radius
    assert away.max() < GAPS[0] + 0.004
    assert push.position[0] < straight.position[0] - 0.004


@pytest.mark.parametrize("cloud", [bar(0.010, 0.02), case(-0.295), case(FRONT, height=0.09)])
def test_what_fits_the_hand_sticks_out_or_is_too_thick_stays(cloud: np.ndarray) -> None:
    assert not len(pushes(field_of(cloud), EDGE))


def test_what_lies_at_the_far_end_of_a_table_is_pushed_all_the_way() -> None:
    assert pushes(field_of(case(0.38)), EDGE).best_first()[0].motion[0] < -0.6
    assert not len(pushes(field_of(case(0.7)), EDGE)), "no arm reaches so far"


@pytest.mark.parametrize("depth", [0.095, 0.13, 0.2])
def test_at_the_edge_all_is_either_pinched_or_pushed_on(depth: float) -> None:
    """Pushes end a little early or late: whatever sticks out then must not be left there."""
    flat = case(EDGE)
    flat[:, 0] = EDGE + (flat[:, 0] - EDGE) * depth / 0.13
    for overhang in np.arange(0.0, depth / 2, 0.004):
        field = field_of(flat - (overhang, 0.0, 0.0))
        assert len(pushes(field, EDGE)) or len(edge_pinches(field, EDGE)), f"{overhang:.3f} m stick out"


@pytest.mark.parametrize(("height", "pushed"), [(0.03, True), (0.05, False)])
def test_what_lies_low_is_too_wide_sooner(height: float, pushed: bool) -> None:
    box = field_of(top((-0.04, 0.0415), (-0.07, 0.07), height))
    assert 0.075 < box.shapes[1].width < HAND.grasp.widest
    assert bool(len(pushes(box, EDGE))) == pushed


@pytest.mark.parametrize(("y", "way"), [(-0.2, 0.43), (0.1, 0.13), (0.25, 0.0), (0.45, -0.11)])
def test_what_lies_beside_the_free_edge_is_also_pushed_along_it(y: float, way: float) -> None:
    settings = PushSettings(free=(0.17, 0.40))
    found = pushes(field_of(case(FRONT, y=y)), EDGE, settings)
    along = found[np.abs(found.motion[:, 0]) < 1e-9]
    assert bool(len(along)) == bool(way)
    for push, gap in zip(along, np.repeat(GAPS, len(LEANS)), strict=False):
        assert push.motion[1] == pytest.approx(way + np.sign(way) * gap, abs=0.006)
        assert push.score < 0.5


def test_where_only_a_hand_s_breadth_of_the_edge_is_free_it_is_pushed_to_its_middle() -> None:
    found = pushes(field_of(case(FRONT, y=-0.2)), EDGE, PushSettings(free=(0.2, 0.25)))
    straight = found[(np.abs(found.motion[:, 0]) < 1e-9) & (found.motion[:, 1] > 0.3)]
    ends = straight.reference_point[:, 1] + straight.motion[:, 1]
    assert len(ends) and (ends > 0.225 - 0.006).all() and (ends < 0.25).all()


def test_where_the_free_edge_is_too_narrow_for_a_hand_nothing_is_pushed_there() -> None:
    assert not len(pushes(field_of(case(FRONT, y=-0.2)), EDGE, PushSettings(free=(0.25, 0.2))))


def test_along_the_edge_it_is_pushed_around_what_is_in_the_way_and_always_on() -> None:
    settings, beside = PushSettings(free=(0.17, 0.40)), case(FRONT, y=-0.2)
    found = pushes(field_of(beside, top((-0.12, 0.0), (0.0, 0.05), 0.03)), EDGE, settings)
    assert len(found) and (found.motion[:, 0] > 0.05).all(), "by, where there is room"
    ends = found.reference_point + found.motion
    assert (found.motion[:, 1] > 0.05).all() and (ends[:, 0] < OUTSIDE + 0.03).all()
    assert (found.score < ASIDE).all()


def test_a_way_that_is_blocked_is_not_taken() -> None:
    y, z = np.meshgrid(np.arange(-0.01, 0.01, 0.0015), np.arange(OBJECT_HEIGHT, 0.1, 0.003))
    post = np.column_stack([np.full(y.size, -0.12), y.ravel(), z.ravel()])
    posts = np.concatenate([post + (dx, 0.0, 0.0) for dx in np.arange(0.0, 0.02, 0.0015)])
    assert (np.abs(pushes(field_of(case(FRONT)), EDGE).motion[:, 1]) < 1e-9).any()
    assert not len(pushes(field_of(np.concatenate([case(FRONT), posts])), EDGE))
    behind = posts + (BACK + 0.15, 0.0, 0.0)
    blocked = pushes(field_of(np.concatenate([case(FRONT), behind])), EDGE)
    assert not (np.abs(blocked.motion[:, 1]) < 1e-9).any()


def test_the_planner_grasps_before_it_pushes() -> None:
    planner = GraspPlanner([EdgePinch(), Push()], PlannerSettings(edge=EDGE))
    table = table_scene(objects=0)
    for cloud, source in ((case(FRONT), "push"), (case(-0.31), "edge_pinch")):
        found = planner(
            np.concatenate([cloud[::5], table]).astype(np.float32), CAMERA, np.random.default_rng(0)
        )
        assert set(found.grasps.source) == {source} and not found.too_wide
    cases = case(FRONT + 0.1, y=0.25)[::5], case(-0.31, y=-0.2)[::5]
    both = np.concatenate([*cases, table]).astype(np.float32)
    answered = planner(both, CAMERA, np.random.default_rng(0)).grasps
    turns = np.where(answered.holds, np.where(answered.score >= DOUBTFUL, 0, 2), 1)
    assert (np.diff(turns) >= 0).all() and set(turns) >= {0, 1}
    unaware = GraspPlanner([EdgePinch(), Push()])
    assert unaware(both, CAMERA, np.random.default_rng(0)).too_wide


@pytest.mark.parametrize(("size", "in_the_way"), [(0.5, True), (0.2, False)])
def test_a_splinter_is_a_part_of_the_thing_and_a_large_piece_beside_it_is_not(
    size: float, in_the_way: bool
) -> None:
    field = field_of(case(FRONT), case(FRONT) * (size, size, 1.0) + (0.2, 0.0, 0.0))
    one_thing = replace(field, things=np.minimum(field.owner, 1))
    assert (heights_beside(one_thing, one_thing.shapes[1]).max() > 0) == in_the_way


BOX = top((-0.03, 0.03), (-0.045, 0.045), 0.03)
"""One that a level pinch can take."""


@pytest.mark.parametrize("thickness", [0.012, 0.05])
def test_ends_trail_behind_thin_things_and_lead_behind_thick_ones(thickness: float) -> None:
    push = pushes(field_of(case(FRONT, height=thickness)), EDGE).best_first()[0]
    wrist, ends = -push.rotation[0, 2], push.motion[0]
    assert (wrist * ends > 0) == (thickness < 0.02), "the wrist is ahead of the ends, or behind"


def test_a_push_goes_as_far_as_is_needed_and_the_middle_stays_on_the_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limit(monkeypatch, 0.0, 0.0)
    for front in (0.1, -0.22):
        field = field_of(case(front))
        (way,) = -pushes(field, EDGE).motion[:, 0] - GAPS[0]
        needed = front - EDGE + OVERHANG
        needed = min(needed, front + 0.065 - EDGE - BALANCE)
        assert way == pytest.approx(needed, abs=0.004)


def test_what_a_grasp_failed_on_is_pushed_to_the_edge_too() -> None:
    field, failed = field_of(BOX, BOX + (0.2, 0.2, 0.0)), np.eye(4)
    assert not len(pushes(field, EDGE))
    failed[:3, 3] = 0.03, 0.07, 0.05
    found = pushes(field, EDGE, failed=[failed])
    assert len(found) and (np.linalg.norm(found.reference_point[:, :2], axis=1) < 0.01).all()
    failed[1, 3] = 0.12
    assert not len(pushes(field, EDGE, failed=[failed])), "it failed on something else"


def test_what_slips_through_between_the_fingers_is_not_pushed() -> None:
    failed = np.eye(4)
    assert not len(pushes(field_of(BOX * (0.5, 0.4, 1.0)), EDGE, failed=[failed]))
