"""The check finds what it must find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_arm_executor.pick_plan import PickPlan
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.timing import Trajectory
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import transform
from dgs_learning.planning.bullet_check import BulletCell, check_pick, interpolate
from tests.dgs_learning.planning.cells import AT_HOME, PLACE, TARGET, box, grasps_at, standing

STEP = 0.01
"""Coarser than the measurement's: the tests look for gross contacts [s]."""


@pytest.fixture(scope="module")
def plan() -> PickPlan:
    found = PickPlanner().plan(AT_HOME, grasps_at((*PLACE, -0.09))).plan
    assert found is not None
    return found


def test_a_pick_of_the_only_object_touches_nothing_else(plan: PickPlan) -> None:
    found = check_pick([TARGET], plan, HOME_ARM, STEP)
    assert found.collisions == {}
    assert found.position_violations == found.velocity_violations == 0
    assert found.states > plan.duration / STEP
    assert 0.1 < found.velocity_ratio < 1.0 and found.gap < 1e-6


def test_what_the_planner_did_not_see_is_found_by_the_check(plan: PickPlan) -> None:
    transfer = plan.trajectories["transfer"].positions
    tool = PickPlanner().ik.forward(transfer[len(transfer) // 2])
    floating = box("unseen", (0.05, 0.05, 0.05), *tool[:3, 3])
    beside = standing("neighbour", (0.10, 0.16, 0.11), PLACE[0] + 0.075, PLACE[1])
    found = check_pick([TARGET, floating, beside], plan, HOME_ARM, STEP).collisions
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
    """The same motion, at its end 8 cm lower."""
    ik, positions = PickPlanner().ik, trajectory.positions.copy()
    for k, share in enumerate(np.linspace(0.0, 1.0, len(positions))):
        low = transform(position=(0.0, 0.0, -0.08 * share)) @ ik.tcp(positions[k])
        states = ik.states(low, positions[k])
        positions[k] = states[np.abs(states - positions[k]).max(axis=1).argmin()]
    return replace(trajectory, positions=positions)


def test_a_motion_that_is_too_fast_or_jumps_is_found(plan: PickPlan) -> None:
    transfer = plan.trajectories["transfer"]
    fast = Trajectory(
        transfer.times / 3, transfer.positions, transfer.velocities * 3, transfer.accelerations * 9
    )
    found = check_pick(
        [TARGET], replace(plan, trajectories=plan.trajectories | {"transfer": fast}), HOME_ARM, STEP
    )
    assert found.velocity_violations > 0 and found.velocity_ratio > 1.0 and found.acceleration_ratio > 2.0
    off = check_pick([TARGET], plan, HOME_ARM + [0.1, 0, 0, 0, 0, 0], STEP)
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


def test_the_target_is_the_object_at_the_reference_point() -> None:
    other = standing("long", (0.02, 0.30, 0.03), 0.2, 0.0)
    cell = BulletCell([TARGET, other])
    assert cell.nearest_object(np.array([0.2, 0.14, -0.18])) == cell.objects[1]
    assert cell.nearest_object(np.array([0.29, 0.09, -0.13])) == cell.objects[0]
