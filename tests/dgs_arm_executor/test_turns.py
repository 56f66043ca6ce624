"""One goal drives, one may follow."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from dgs_arm_executor.situation import ArmSituation
from dgs_arm_executor.turns import Turns
from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from tests.support.refused import refused

BIN = ArmSituation(np.arange(6.0), HAND.open_hand)


@pytest.fixture
def turns() -> Turns:
    """Of a goal that drives and has offered to be followed."""
    turns = Turns()
    turns.take()
    turns.offer(BIN)
    return turns


def test_one_goal_drives_at_a_time_and_nobody_follows_one_that_offers_nothing() -> None:
    turns = Turns()
    assert turns.take() and not turns.take()
    assert turns.follow() is None
    turns.end(kept=True)
    assert turns.take()


def test_one_goal_follows_a_goal_that_offers_where_it_will_end_and_drives_when_it_has(turns: Turns) -> None:
    assert turns.follow() is BIN
    assert turns.follow() is None, "one is enough"
    assert not turns.succeed(0.0)
    turns.end(kept=True)
    assert not turns.take(), "the follower comes first"
    assert turns.succeed(0.0)
    assert not turns.take() and turns.follow() is None
    turns.offer(BIN)
    turns.end(kept=True)
    assert turns.follow() is None, "there is nobody to follow"
    assert turns.take() and turns.follow() is None


def test_a_follower_waits_for_the_end(turns: Turns) -> None:
    turns.follow()
    begun = time.monotonic()
    threading.Timer(0.1, turns.end, [True]).start()
    assert turns.succeed(10.0) and time.monotonic() - begun < 5.0, "it is told, it does not ask"


def test_a_follower_of_a_goal_that_broke_its_word_does_not_drive(turns: Turns) -> None:
    turns.follow()
    turns.end(kept=False)
    with refused(ErrorCode.SCENE_CHANGED):
        turns.succeed(0.0)
    turns.leave()
    assert turns.take()


def test_a_follower_that_leaves_makes_room_for_another(turns: Turns) -> None:
    turns.follow()
    turns.leave()
    assert turns.follow() is BIN
