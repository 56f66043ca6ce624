"""The board of statuses: one per component, over when nobody reports it any more."""

from __future__ import annotations

import time

from diagnostic_msgs.msg import DiagnosticStatus

from dgs_ros.diagnostics import Level, StatusBoard


def by_name(board: StatusBoard) -> dict[str, DiagnosticStatus]:
    return {status.name: status for status in board.statuses()}


def test_the_newest_status_of_each_component() -> None:
    board = StatusBoard("/arm/executor")
    board.put(Level.OK, "ready", "", 60.0, {})
    board.put(Level.ERROR, "silent", "bus", 60.0, {"last": 3})
    board.put(Level.WARN, "late", "bus", 60.0, {"last": 4})
    statuses = by_name(board)
    assert statuses.keys() == {"/arm/executor", "/arm/executor: bus"}
    bus = statuses["/arm/executor: bus"]
    assert (bus.level, bus.message, bus.hardware_id) == (bytes([Level.WARN]), "late", "executor")
    assert [(value.key, value.value) for value in bus.values] == [("last", "4")]


def test_only_a_new_level_is_news() -> None:
    board = StatusBoard("/node")
    news = [
        board.put(level, "text", "part", 60.0, {})
        for level in (Level.OK, Level.OK, Level.WARN, Level.WARN, Level.OK)
    ]
    assert news == [True, False, True, False, True]


def test_a_status_that_is_over_says_what_it_was() -> None:
    board = StatusBoard("/node")
    board.put(Level.ERROR, "jammed", "finger", 0.02, {"joint": 7})
    board.put(Level.ERROR, "hot", "motor", 60.0, {})
    assert by_name(board)["/node: finger"].level == bytes([Level.ERROR])
    time.sleep(0.03)
    statuses = by_name(board)
    finger, motor = statuses["/node: finger"], statuses["/node: motor"]
    assert finger.level == bytes([Level.OK]) and "jammed" in finger.message and not finger.values
    assert (motor.level, motor.message) == (bytes([Level.ERROR]), "hot")
    assert by_name(board)["/node: finger"].message == finger.message
