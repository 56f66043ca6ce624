"""What `dgs bench-planning` measures: the check finds what it must find, the records survive a kill, sums are right."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_arm_executor.pick_plan import PickPlan
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.situation import ArmSituation
from dgs_arm_executor.timing import Trajectory
from dgs_description.frames import CELL, HOME_ARM, transform
from dgs_description.grasp import GraspSet
from dgs_description.pick import OPEN_HAND
from dgs_learning import paths
from dgs_learning.objects import shapes
from dgs_learning.planning.baseline import Baseline
from dgs_learning.planning.bullet_check import BulletCell, check_pick, interpolate
from dgs_learning.planning.cases import PickCase
from dgs_learning.planning.measure import load_records, measure_missing, summarise
from dgs_learning.planning.table import fill, table
from dgs_sim_bridge.render.object_model import from_parts
from dgs_sim_bridge.world.scenes import PlacedObject
from tests.support.grasps import top_grasps

STEP = 0.01
"""Coarser than the measurement's: the tests look for gross contacts [s]."""
PLACE = np.array([0.30, 0.10])
AT_HOME = ArmSituation(HOME_ARM, OPEN_HAND)


def grasps_at(*places: tuple[float, ...]) -> GraspSet:
    """From above, aimed 4 cm below the TCP."""
    grasps = top_grasps(np.array(places))
    return replace(grasps, reference_point=grasps.position - (0, 0, 0.04))


def box(name: str, size: tuple[float, float, float], x: float, y: float, z: float) -> PlacedObject:
    return PlacedObject(
        from_parts(name, "cuboid", name, shapes.box(list(size)), 0.2), transform(position=(x, y, z))
    )


def standing(name: str, size: tuple[float, float, float], x: float, y: float) -> PlacedObject:
    item = box(name, size, x, y, 0.0)
    lowest = float(item.model.vertices[:, 2].min())
    return replace(item, pose=transform(position=(x, y, CELL.table_height - lowest)))


@pytest.fixture(scope="module")
def target() -> PlacedObject:
    return standing("target", (0.04, 0.04, 0.08), *PLACE)


@pytest.fixture(scope="module")
def plan() -> PickPlan:
    found = PickPlanner().plan(AT_HOME, grasps_at((*PLACE, -0.09))).plan
    assert found is not None
    return found


def test_a_pick_of_the_only_object_touches_nothing_else(target: PlacedObject, plan: PickPlan) -> None:
    found = check_pick([target], plan, HOME_ARM, STEP)
    assert found.collisions == {}
    assert found.position_violations == found.velocity_violations == 0
    assert found.states > plan.duration / STEP
    assert 0.1 < found.velocity_ratio < 1.0 and found.gap < 1e-6


def test_what_the_planner_did_not_see_is_found_by_the_check(target: PlacedObject, plan: PickPlan) -> None:
    transfer = plan.trajectories["transfer"].positions
    tool = PickPlanner().ik.forward(transfer[len(transfer) // 2])
    floating = box("unseen", (0.05, 0.05, 0.05), *tool[:3, 3])
    beside = standing("neighbour", (0.10, 0.16, 0.11), PLACE[0] + 0.075, PLACE[1])
    found = check_pick([target, floating, beside], plan, HOME_ARM, STEP).collisions
    assert any(key.startswith("transfer") and key.endswith("object unseen") for key in found), found
    assert any(key.startswith("approach: hand") and key.endswith("object neighbour") for key in found), found


def test_the_carried_object_counts_and_so_does_the_table(plan: PickPlan) -> None:
    # A rod that hangs down 25 cm from the hand cannot pass the bin's wall; the planner saw an empty table.
    rod = box("rod", (0.03, 0.03, 0.30), *PLACE, CELL.table_height + 0.08 - 0.15)
    found = check_pick([rod], plan, HOME_ARM, STEP).collisions
    assert any("carried object - bin" in key for key in found), found
    low = replace(plan, load=replace(plan.load, grasp=grasps_at((*PLACE, -0.16))[0]))
    sunk = {
        name: shifted(trajectory) if name == "approach" else trajectory
        for name, trajectory in plan.trajectories.items()
    }
    found = check_pick(
        [standing("t", (0.02,) * 3, *PLACE)], replace(low, trajectories=sunk), HOME_ARM, STEP
    ).collisions
    assert any(key.startswith("approach") and "table" in key for key in found), found


def shifted(trajectory: Trajectory) -> Trajectory:
    """The same motion with the shoulder lowered by 15 degrees at its end."""
    down = np.zeros_like(trajectory.positions)
    down[:, 1] = np.linspace(0.0, np.deg2rad(15.0), len(down))
    return replace(
        trajectory, positions=trajectory.positions + np.sign(np.cos(trajectory.positions[0, 1])) * down
    )


def test_a_motion_that_is_too_fast_or_jumps_is_found(target: PlacedObject, plan: PickPlan) -> None:
    transfer = plan.trajectories["transfer"]
    fast = Trajectory(
        transfer.times / 3, transfer.positions, transfer.velocities * 3, transfer.accelerations * 9
    )
    found = check_pick(
        [target], replace(plan, trajectories=plan.trajectories | {"transfer": fast}), HOME_ARM, STEP
    )
    assert found.velocity_violations > 0 and found.velocity_ratio > 1.0 and found.acceleration_ratio > 2.0
    off = check_pick([target], plan, HOME_ARM + [0.1, 0, 0, 0, 0, 0], STEP)
    assert off.gap == pytest.approx(0.1)


def test_interpolation_is_exact_for_quintics_and_ends_with_the_trajectory() -> None:
    rng = np.random.default_rng(0)
    times = np.array([0.0, 0.3, 0.4, 1.0])
    polynomials = [np.polynomial.Polynomial(rng.normal(size=6)) for _ in range(6)]

    def states(t: np.ndarray) -> list[np.ndarray]:
        return [np.stack([p.deriv(k)(t) if k else p(t) for p in polynomials], axis=1) for k in range(3)]

    found = interpolate(Trajectory(times, *states(times)), 0.007)
    t = np.append(np.arange(0.0, 1.0, 0.007), 1.0)
    for values, expected in zip(found, states(t), strict=True):
        np.testing.assert_allclose(values, expected, atol=1e-9)


def test_the_target_is_the_object_at_the_reference_point(target: PlacedObject) -> None:
    other = standing("long", (0.02, 0.30, 0.03), 0.2, 0.0)
    cell = BulletCell([target, other])
    assert cell.nearest_object(np.array([0.2, 0.14, -0.18])) == cell.objects[1]
    assert cell.nearest_object(np.array([0.29, 0.09, -0.13])) == cell.objects[0]


def test_baseline_takes_the_first_grasp_that_it_reaches() -> None:
    grasps = grasps_at((0.9, 0.0, -0.09), (*PLACE, -0.09))
    baseline = Baseline(PickPlanner(), AT_HOME)
    assert baseline.to_stand_off(grasps) == 1
    assert baseline.whole_pick(grasps) == 1
    assert baseline.whole_pick(grasps[:1]) is None


def test_a_run_that_was_stopped_goes_on_with_the_scenes_that_are_left(tmp_path: Path) -> None:
    assert load_records(tmp_path) == []
    (tmp_path / "scene_0001.json").write_text('{"scene": 1, "candidates": 7}')
    (tmp_path / "scene_0000.partial").write_text('{"scene": 0, "candi')
    made: list[int] = []

    def case_of(number: int) -> PickCase:
        made.append(number)
        return PickCase(number, (), np.zeros((0, 3), np.float32), GraspSet.empty())

    measure_missing(tmp_path, range(3), case_of)
    assert made == [0, 2]
    assert [(record["scene"], record["candidates"]) for record in load_records(tmp_path)] == [
        (0, 0),
        (1, 7),
        (2, 0),
    ]


def test_a_scene_is_measured_whole(tmp_path: Path, target: PlacedObject) -> None:
    grasps = grasps_at((0.9, 0.0, -0.09), (*PLACE, -0.09))
    measure_missing(tmp_path, [4], lambda k: PickCase(k, (target,), np.zeros((0, 3), np.float32), grasps))
    (found,) = load_records(tmp_path)
    assert found["plan"]["index"] == found["best_reachable"] == 1
    assert found["plan"]["rejections"] == {"OUT_OF_REACH": 1}
    assert found["baseline"]["whole_pick"]["index"] == 1 and found["plan"]["processor_ms"] > 0
    assert found["check"]["states"] > 1000 and found["check"]["collisions"] == {}
    assert summarise([found])["share_best_scored"] == 1.0


def record(scene: int, index: int | None, best: int | None, contact: dict | None = None) -> dict:
    row = {"index": index, "wall_ms": 10.0 * scene, "processor_ms": 5.0 * scene}
    checked = {
        "states": 100, "collisions": contact or {}, "position_violations": 0, "velocity_violations": scene,
        "velocity_ratio": 0.5, "acceleration_ratio": 1.0, "gap": 0.0,
    }  # fmt: skip
    return {
        "revision": "abc", "scene": scene, "objects": 4, "candidates": 60, "best_reachable": best,
        "plan": row | {"duration_s": 8.0 if index is not None else None, "rejections": {"OUT_OF_REACH": scene}},
        "baseline": {"to_stand_off": row, "whole_pick": row},
    } | ({"check": checked} if index is not None else {})  # fmt: skip


def test_summary_counts_what_it_says() -> None:
    hit = {"carry: carried object - object cup_3": [4, 0.002]}
    measured = summarise(
        [
            {"scene": 0, "candidates": 0},
            record(1, 0, 0),
            record(2, 3, 1, hit),
            record(3, None, 5),
            record(4, None, None),
        ]
    )
    assert measured["scenes"] == 5 and measured["scenes_without_candidates"] == 1
    assert measured["reachable_scenes"] == 3 and measured["found"] == 2
    assert measured["share_found"] == pytest.approx(2 / 3, abs=1e-3)
    assert measured["share_best_scored"] == pytest.approx(1 / 3, abs=1e-3)
    assert measured["rejected_candidates"] == {"OUT_OF_REACH": 10}
    assert measured["planning"]["processor_ms"]["median"] == 12.5
    assert measured["check"]["picks"] == 2 and measured["check"]["picks_with_collision"] == 1
    assert measured["check"]["collisions"] == {"carry: carried object - object": 1}
    assert measured["check"]["deepest_mm"] == 2.0 and measured["check"]["velocity_violations"] == 3


def test_the_documents_table_is_that_of_the_measured_file() -> None:
    measured = json.loads((paths.repository() / "docs/results/arm_planning.json").read_text())
    assert table(measured) in (paths.repository() / "docs/arm_executor.md").read_text()


def test_a_document_without_marks_is_refused(tmp_path: Path) -> None:
    document = tmp_path / "d.md"
    document.write_text("nothing here")
    measured = summarise([record(1, 0, 0)]) | {
        "command": "", "date": "", "machine": {"processor": "", "load_average": 0.0, "cores": 1},
    }  # fmt: skip
    with pytest.raises(ValueError, match="planning:start"):
        fill(document, measured)
    document.write_text("before <!-- planning:start -->old<!-- planning:end --> after")
    fill(document, measured)
    assert "| 1, 100 |" in document.read_text() and "old" not in document.read_text()
