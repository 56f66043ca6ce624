"""What the planner node's parameters and the cell make of the stages' settings."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dgs_description.cell import CELL
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.propose.edge_pinch import HAND_WIDTH


def test_pushes_end_half_a_hand_farther_from_the_robot_than_the_edge_is_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (low, high), (near, far) = CELL.free_edge, CELL.turning_edge
    ours = PlannerParameters().push()
    assert ours.free == (low + HAND_WIDTH / 2, high) and ours.turning == (near, far)
    mirrored = replace(CELL, free_edge=(-high, -low), turning_edge=(-far, -near))
    monkeypatch.setattr("dgs_grasp_planner.planner_parameters.CELL", mirrored)
    theirs = PlannerParameters().push()
    assert theirs.free == (-high, -low - HAND_WIDTH / 2) and theirs.turning == (-far, -near)
