"""Ranking: the proposer's score, the contacts, and the way to the grasp."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.contact.height_field import height_field
from dgs_grasp_planner.rank import BLOCKED, free_way, rank
from tests.dgs_grasp_planner.contact.test_closing import grasp
from tests.dgs_grasp_planner.contact.test_fit import BAR


def test_a_hand_that_would_push_something_aside_on_its_way_comes_later() -> None:
    wall = np.random.default_rng(0).uniform((0.10, -0.07, 0.02), (0.14, 0.07, 0.13), (20_000, 3))
    turned = Rotation.from_euler("y", 35, degrees=True).as_matrix()
    straight = grasp(z=0.075, final=np.tile([0.0, 0.2, 0.2, 0.2], 5))[[0, 0]]
    hands = replace(straight, rotation=np.stack([turned @ straight.rotation[0], straight.rotation[0]]))
    field, alone = height_field(np.vstack([BAR, wall])), height_field(BAR)
    assert field is not None and alone is not None
    beside, above = free_way(hands, field)
    assert above == 1.0 and beside == BLOCKED
    np.testing.assert_array_equal(free_way(hands, alone), [1.0, 1.0])
    np.testing.assert_allclose(rank(hands, field).rotation[0], hands.rotation[1])


def test_better_contacts_come_first_and_without_a_field_the_score_decides() -> None:
    two = replace(joined([grasp(), grasp()]), score=np.array([0.8, 0.9]), quality=np.array([0.9, 0.3]))
    field = height_field(BAR)
    assert rank(two, field).score[0] == pytest.approx(0.8 * 0.9 * free_way(two, field)[0])
    assert rank(two, None).score.tolist() == [0.9, 0.8]
    assert len(rank(GraspSet.empty(), field)) == 0
