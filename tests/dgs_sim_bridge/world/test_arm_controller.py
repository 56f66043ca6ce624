import numpy as np
import pytest

from dgs_description.joints import JointPath
from dgs_sim_bridge.world.arm_controller import ArmController, ArmGoal, Outcome
from dgs_sim_bridge.world.trajectory import ArmState, FollowCode, SetPoint, Tolerances

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
    np.testing.assert_allclose(arm.run(0.2), 0)  # it holds where it is, not where it should have been


def test_an_arm_pressed_off_where_it_is_to_hold_may_set_out(arm: Arm) -> None:
    arm.state = ArmState(np.full(6, 0.25), np.zeros(6), np.zeros(6))  # more than the path allows
    arm.start(arm.goal([0.0, 1.0], [0.25, 0.5]))
    arm.run(1.1)
    assert [outcome.status for outcome in arm.outcomes] == ["succeeded"]


def test_goal_missed_after_the_allowed_time_aborts(arm: Arm) -> None:
    tolerances = Tolerances(path=np.full(6, np.inf), goal=np.full(6, 0.05), goal_time=0.3)
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.1], tolerances=tolerances))
    arm.held = True
    arm.run(0.75)
    assert not arm.outcomes
    arm.run(0.1)
    assert [(o.status, o.code) for o in arm.outcomes] == [("aborted", FollowCode.GOAL_TOLERANCE_VIOLATED)]
    np.testing.assert_allclose(arm.run(0.2), 0)


def test_without_a_limit_the_goal_is_waited_for(arm: Arm) -> None:
    tolerances = Tolerances(path=np.full(6, np.inf), goal_time=np.inf)
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.2], tolerances=tolerances))
    arm.held = True
    arm.run(8.0)
    assert not arm.outcomes
    arm.held = False
    arm.run(0.1)
    assert arm.outcomes[0].status == "succeeded"


def test_leaving_the_paths_speed_aborts_and_names_the_joint(arm: Arm) -> None:
    tolerances = Tolerances(path_velocity=np.full(6, 0.5))
    arm.start(arm.goal([0.0, 1.0], [0.0, 0.4], tolerances=tolerances))
    arm.run(0.5)
    assert not arm.outcomes
    arm.start(arm.goal([0.5], [1.0], tolerances=tolerances))
    arm.held = True
    arm.run(0.1)
    assert arm.outcomes[-1].code == FollowCode.PATH_TOLERANCE_VIOLATED
    assert "shoulder_pan_joint is off by 1." in arm.outcomes[-1].message


@pytest.mark.parametrize("ends", [[0.5], [0.5, 1.0]])
def test_a_point_at_time_zero_that_is_elsewhere_aborts_without_motion(arm: Arm, ends: list[float]) -> None:
    arm.start(arm.goal([0.0, 1.0][: len(ends)], ends))
    assert [(o.status, o.code) for o in arm.outcomes] == [("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)]
    np.testing.assert_allclose(arm.run(0.5), 0)


def test_points_that_are_over_are_left_out(arm: Arm) -> None:
    arm.now = 1.0
    arm.start(arm.goal([0.0, 0.5, 1.5], [0.6, 0.7, 0.3], start_time=0.0))
    track = arm.run(0.6)
    # From where the arm is, in the 0.5 s that are left.
    assert np.abs(np.diff(track, prepend=0.0)).max() <= 0.6 * DT * 1.01
    assert arm.outcomes[0].status == "succeeded" and track[-1] == pytest.approx(0.3)


@pytest.mark.parametrize(("times", "now"), [([0.0], 0.0), ([0.0, 0.5], 1.0)])
def test_an_end_that_is_over_or_due_is_taken_if_it_is_near(arm: Arm, times: list[float], now: float) -> None:
    arm.now = now
    arm.start(arm.goal(times, [0.1] * len(times), start_time=0.0))
    assert arm.run(0.1)[-1] == pytest.approx(0.1) and arm.outcomes[0].status == "succeeded"


def test_a_goal_that_is_refused_stops_the_one_before(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 1.0], [0.0, 1.0]))
    arm.run(0.5)
    arm.start(arm.goal([0.0], [3.0]))
    assert [outcome.status for outcome in arm.outcomes] == ["aborted"] * 2
    assert 0.5 < arm.run(1.0)[-1] < 0.65


def test_it_holds_from_the_start() -> None:
    controller = ArmController(np.full(6, 0.3))
    point = controller.step(DT, ArmState(np.full(6, 0.3), np.zeros(6), np.zeros(6)))
    np.testing.assert_array_equal(point.positions, 0.3)
    np.testing.assert_array_equal(point.velocities, 0)


def test_braking_is_the_same_in_both_directions(arm: Arm) -> None:
    ends = []
    for sign in (1.0, -1.0):
        other = Arm()
        goal = other.start(other.goal([0.0, 1.0], [0.0, sign]))
        other.run(0.5)
        other.controller.cancel(goal)
        ends.append(sign * other.run(1.0)[-1])
    assert ends[0] == pytest.approx(ends[1]) and ends[0] > 0.5


@pytest.mark.parametrize("scaling", [0.25, 0.87, 1.0])
def test_scaled_time_takes_longer_along_the_same_path(arm: Arm, scaling: float) -> None:
    seen: list[tuple[float, ...]] = []
    arm.controller.speed_scaling = scaling

    def progress(wanted: SetPoint, measured: ArmState, passed: float) -> None:
        seen.append((wanted.positions[0], wanted.velocities[0], wanted.time, passed))

    arm.start(arm.goal([0.4, 0.8], [0.3, 0.1], on_progress=progress))
    arm.run(0.8 / scaling + 0.1)
    assert arm.outcomes[0].status == "succeeded"
    positions, velocities, planned, passed = np.array(seen).T
    np.testing.assert_allclose(velocities, scaling * np.where(planned < 0.4, 0.75, -0.5), rtol=1e-6)
    np.testing.assert_allclose(planned, scaling * passed, rtol=1e-3)
    np.testing.assert_allclose(positions, np.interp(planned, [0.0, 0.4, 0.8], [0.0, 0.3, 0.1]), atol=1e-9)


def test_goal_is_not_reached_while_the_arm_still_moves(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 0.5], [0.0, 0.1]))
    arm.held = True
    arm.state = ArmState(np.full(6, 0.1), np.full(6, 0.5), np.zeros(6))
    arm.run(0.7)
    assert not arm.outcomes
    arm.state = ArmState(np.full(6, 0.1), np.zeros(6), np.zeros(6))
    arm.run(0.1)
    assert arm.outcomes[0].status == "succeeded"


@pytest.mark.parametrize("scaling", [1.0, 0.0])
def test_cancel_brakes_and_holds(arm: Arm, scaling: float) -> None:
    goal = arm.start(arm.goal([0.0, 1.0], [0.0, 1.0]))
    arm.run(0.5)
    arm.controller.cancel(goal)
    arm.controller.speed_scaling = scaling
    track = arm.run(1.0)
    assert arm.outcomes[0].status == "canceled"
    assert 0.55 < track[-1] < 0.65 and not arm.state.velocities.any()
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


def test_a_moving_arm_stands_until_a_later_goal_begins_and_when_that_is_cancelled(arm: Arm) -> None:
    arm.start(arm.goal([0.0, 2.0], [0.0, 2.0]))
    reached = arm.run(0.5)[-1]
    later = arm.start(arm.goal([0.5], [reached + 0.1], start_time=1.5))
    np.testing.assert_allclose(arm.run(0.5), reached)
    np.testing.assert_array_equal(arm.state.velocities, 0)
    arm.controller.cancel(later)
    np.testing.assert_allclose(arm.run(0.5), reached)


def test_abort_without_a_goal_does_nothing(arm: Arm) -> None:
    arm.controller.abort(FollowCode.INVALID_GOAL, "nothing runs")
    assert not arm.outcomes
    np.testing.assert_allclose(arm.run(0.1), 0)


def test_progress_tells_wanted_and_measured(arm: Arm) -> None:
    seen: list[tuple[float, float]] = []
    arm.start(
        arm.goal(
            [0.0, 0.5], [0.0, 0.5], on_progress=lambda w, m, _: seen.append((w.positions[0], m.positions[0]))
        )
    )
    arm.run(0.6)
    wanted, measured = np.array(seen).T
    assert len(seen) > 100
    np.testing.assert_allclose(wanted - measured, DT, atol=1e-9)  # at 1 rad/s the arm is one step behind
