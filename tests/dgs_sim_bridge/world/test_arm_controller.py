import numpy as np
import pytest

from dgs_description.joints import JointPath
from dgs_sim_bridge.world.arm_controller import ArmController, ArmGoal, Outcome
from dgs_sim_bridge.world.trajectory import ArmState, FollowCode, Tolerances

DT = 1 / 240


class Arm:
    """An ideal arm: it is where the controller wants it, unless it is held."""

    def __init__(self) -> None:
        self.controller = ArmController(np.zeros(6))
        self.state = ArmState(np.zeros(6), np.zeros(6), np.zeros(6))
        self.held = False
        self.outcomes: list[Outcome] = []
        self.now = 0.0

    def goal(self, times: list[float], ends: list[float], **options: object) -> ArmGoal:
        positions = np.array(ends)[:, None] * np.ones(6)
        return ArmGoal(JointPath(np.array(times), positions), self.outcomes.append, **options)  # type: ignore[arg-type]

    def start(self, goal: ArmGoal) -> ArmGoal:
        self.controller.start(goal, self.state, self.now)
        return goal

    def run(self, seconds: float) -> np.ndarray:
        track = []
        for _ in range(round(seconds / DT)):
            point = self.controller.step(DT, self.state)
            if not self.held:
                self.state = ArmState(point.positions, point.velocities, np.zeros(6))
            self.now += DT
            track.append(point.positions[0])
        return np.array(track)


@pytest.fixture
def arm() -> Arm:
    return Arm()


def test_goal_is_reached_and_held(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 1.0], [0.0, 0.5]))
    arm.run(0.9)
    assert not arm.outcomes and arm.controller.busy
    arm.run(0.2)
    assert [(o.status, o.code) for o in arm.outcomes] == [("succeeded", FollowCode.SUCCESSFUL)]
    np.testing.assert_allclose(arm.run(0.5), 0.5)
    assert not arm.controller.busy


def test_leaving_the_path_aborts_and_names_the_joint(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 1.0], [0.0, 0.9]))
    arm.held = True
    arm.run(0.5)
    assert [(o.status, o.code) for o in arm.outcomes] == [("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)]
    assert "shoulder_pan_joint is off by 0.2" in arm.outcomes[0].message


def test_goal_missed_after_the_allowed_time_aborts(arm: Arm) -> None:
    tolerances = Tolerances(path=np.full(6, np.inf), goal=np.full(6, 0.05), goal_time=0.3)
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.1], tolerances=tolerances))
    arm.held = True
    arm.run(0.75)
    assert not arm.outcomes
    arm.run(0.1)
    assert [(o.status, o.code) for o in arm.outcomes] == [("aborted", FollowCode.GOAL_TOLERANCE_VIOLATED)]


def test_goal_is_not_reached_while_the_arm_still_moves(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.1]))
    arm.held = True
    arm.state = ArmState(np.full(6, 0.1), np.full(6, 0.5), np.zeros(6))
    arm.run(0.7)
    assert not arm.outcomes
    arm.state = ArmState(np.full(6, 0.1), np.zeros(6), np.zeros(6))
    arm.run(0.1)
    assert arm.outcomes[0].status == "succeeded"


def test_cancel_brakes_and_holds(arm: Arm) -> None:
    goal = arm.start(arm.goal([0.0, 1.0], [0.0, 1.0]))
    arm.run(0.5)
    arm.controller.cancel(goal)
    track = arm.run(1.0)
    assert arm.outcomes[0].status == "canceled"
    assert 0.5 < track[-1] < 0.65
    assert np.abs(np.diff(track)).max() <= 1.0 * DT * 1.01
    np.testing.assert_allclose(track[-100:], track[-1])


def test_cancel_of_another_goal_does_nothing(arm: Arm) -> None:
    other = arm.goal([0.0, 1.0], [0.0, 1.0])
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.2]))
    arm.controller.cancel(other)
    arm.run(0.6)
    assert [o.status for o in arm.outcomes] == ["succeeded"]


def test_new_goal_takes_the_place_of_the_old_one(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 1.0], [0.0, 0.5]))
    arm.run(0.5)
    arm.start(arm.goal([1.0], [0.0]))
    assert [(o.status, o.code) for o in arm.outcomes] == [("aborted", FollowCode.INVALID_GOAL)]
    arm.run(1.1)
    assert arm.outcomes[1].status == "succeeded"
    assert arm.state.positions[0] == pytest.approx(0)


def test_start_away_from_the_measured_state_aborts_without_motion(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 1.0], [0.5, 1.0]))
    assert [(o.status, o.code) for o in arm.outcomes] == [("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)]
    np.testing.assert_allclose(arm.run(0.5), 0)


def test_time_stands_still_at_speed_zero_and_goes_on(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 1.0], [0.0, 0.5]))
    arm.run(0.5)
    arm.controller.speed_scaling = 0.0
    track = arm.run(1.0)
    assert track[0] == pytest.approx(track[-1]) and not arm.outcomes
    arm.controller.speed_scaling = 0.5
    arm.run(0.9)
    assert not arm.outcomes
    arm.run(0.2)
    assert arm.outcomes[0].status == "succeeded"


def test_start_time_in_the_future_is_waited_for(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.3], start_time=0.5))
    np.testing.assert_allclose(arm.run(0.49), 0)
    arm.run(0.6)
    assert arm.outcomes[0].status == "succeeded"


def test_abort_without_a_goal_does_nothing(arm: Arm) -> None:
    arm.controller.abort(FollowCode.INVALID_GOAL, "nothing runs")
    assert not arm.outcomes
    np.testing.assert_allclose(arm.run(0.1), 0)


def test_progress_tells_wanted_and_measured(arm: Arm) -> None:
    seen: list[tuple[float, float]] = []
    arm.start(
        arm.goal(
            [0.0, 0.5], [0.0, 0.5], on_progress=lambda w, m: seen.append((w.positions[0], m.positions[0]))
        )
    )
    arm.run(0.6)
    wanted, measured = np.array(seen).T
    assert len(seen) > 100
    np.testing.assert_allclose(wanted - measured, DT, atol=1e-9)  # at 1 rad/s the arm is one step behind
