from __future__ import annotations

import numpy as np

from dgs_arm_executor.joint_history import JointHistory


def test_joints_are_known_between_the_first_and_the_last_measurement() -> None:
    history = JointHistory()
    assert history.at(1.0) is None
    history.add(1.0, np.zeros(6))
    history.add(2.0, np.full(6, 0.4))
    np.testing.assert_allclose(history.at(1.25), 0.1)
    np.testing.assert_allclose(history.at(2.0), 0.4)
    assert history.at(0.9) is None and history.at(2.1) is None


def test_time_that_goes_back_forgets_what_was() -> None:
    history = JointHistory()
    for stamp in (5.0, 5.1, 5.2):
        history.add(stamp, np.ones(6))
    history.add(1.0, np.zeros(6))
    assert history.at(5.0) is None
    np.testing.assert_allclose(history.at(1.0), 0.0)


def test_what_has_moved_lately() -> None:
    history = JointHistory()
    assert history.moved(0.1) == np.inf
    for step in range(5):
        history.add(0.05 * step, np.array([0.0, min(step, 2)]))
    assert history.moved(0.08) == 0.0
    assert history.moved(0.14) == 1.0
    assert history.moved(0.3) == np.inf, "nothing is known of so long ago"
    history.add(1.2, np.array([0.5, 2.0]))
    assert history.moved(0.1) == 0.5, "also over a silence"
