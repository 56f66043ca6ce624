"""Rollouts: grasps are done in MuJoCo on what is believed to stand there, and the order follows what was seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.contact.fit import fit
from dgs_grasp_planner.planner import DOUBTFUL, in_turn
from dgs_grasp_planner.propose.level_pinch import level_pinches
from dgs_grasp_planner.rank import rank
from dgs_grasp_planner.rollout import BelievedScene, roll_out
from tests.dgs_grasp_planner.contact.test_closing import bar
from tests.dgs_grasp_planner.scenes import field_of

FIELD = field_of(bar(half_width=0.012, height=0.025))
NONE = np.zeros((0, 4, 4))
PUSH = replace(
    level_pinches(FIELD)[:1],
    motion=np.array([[0.1, 0.0, 0.0]]),
    active_fingers=np.zeros((1, 5), bool),
    score=np.array([0.5]),
)


@pytest.fixture(scope="module")
def pinches() -> GraspSet:
    """The best pinch of the bar, and the same beside the bar with a better score."""
    best = rank(fit(level_pinches(FIELD), FIELD), FIELD, NONE)[:1]
    beside = replace(best, position=best.position + [0.0, 0.0, 0.06], score=best.score + 0.05)
    return joined([beside, best])


def test_a_pinch_of_the_bar_holds_again_and_again_and_one_above_it_does_not(pinches: GraspSet) -> None:
    with BelievedScene(FIELD.separated, [1], None) as scene:
        assert [scene.holds(pinches[k]) for k in (1, 0, 1)] == [True, False, True]


def test_nothing_is_held_where_the_table_has_ended_and_the_bar_has_fallen(pinches: GraspSet) -> None:
    with BelievedScene(FIELD.separated, [1], 0.2) as scene:
        assert not scene.holds(pinches[1])


def test_what_lets_go_comes_later_and_after_a_push_if_it_is_doubtful_then(pinches: GraspSet) -> None:
    both = roll_out(pinches, in_turn, FIELD, None, 8)
    assert both.score[0] < pinches.score[0] and both.score[1] > pinches.score[1]
    assert in_turn(pinches).tolist() == [0, 1] and in_turn(both).tolist() == [1, 0]
    beside = joined([replace(pinches[:1], score=np.array([DOUBTFUL + 0.05])), PUSH])
    assert in_turn(beside).tolist() == [0, 1]
    assert in_turn(roll_out(beside, in_turn, FIELD, None, 8)).tolist() == [1, 0]


@pytest.mark.parametrize("tries", [0, 1])
def test_no_more_rollouts_than_asked_for(pinches: GraspSet, tries: int) -> None:
    changed = roll_out(pinches, in_turn, FIELD, None, tries).score != pinches.score
    assert changed.tolist() == [tries > 0, False]


def test_a_push_in_front_needs_no_rollout_and_neither_does_an_empty_table(pinches: GraspSet) -> None:
    both = joined([PUSH, replace(pinches[1:], score=np.array([DOUBTFUL - 0.05]))])
    np.testing.assert_array_equal(roll_out(both, in_turn, FIELD, None, 8).score, both.score)
    assert roll_out(pinches, in_turn, None, None, 8) is pinches
    assert len(roll_out(GraspSet.empty(), in_turn, FIELD, None, 8)) == 0
