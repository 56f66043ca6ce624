"""The bound of the force on the hand: what counts as met, and what the robot does then, against real contacts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dgs_arm_executor.execution import Execution, Report
from dgs_arm_executor.executor_parameters import ArmExecutorParameters
from dgs_arm_executor.force_guard import ForceGuard
from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.pick_plan import Wish
from dgs_arm_executor.pick_planner import PickPlanner
from dgs_arm_executor.situation import ArmSituation
from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_description.hand import HAND
from dgs_learning.evaluation.rehearsal import RehearsalRobot
from dgs_sim_bridge.render.object_model import from_parts
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.world import World
from tests.support.grasps import top_grasps
from tests.support.refused import refused

UP = np.array([0.0, 0.0, 1.0])


def felt(guard: ForceGuard, *forces: float, start: float = 0.0) -> ForceGuard:
    for number, force in enumerate(forces):
        guard.measured(force * UP, start + 0.008 * number)
    return guard


def test_a_force_that_lasts_ends_the_way_and_a_blow_does_not() -> None:
    felt(ForceGuard(), 0.0, 90.0, 90.0, 20.0, 90.0, 90.0, 20.0).check()
    with pytest.raises(DgsError, match="with 62 N, 50 N are allowed") as error:
        felt(ForceGuard(), 60.0, 60.0, 60.0, 62.0, 61.0, 0.0).check()
    assert error.value.code == ErrorCode.FORCE_LIMIT
    restarted = felt(felt(ForceGuard(), 90.0, start=100.0), 90.0, 90.0, 90.0, 90.0)
    with refused(ErrorCode.FORCE_LIMIT):
        restarted.check()


def test_forces_count_from_what_the_hand_weighs() -> None:
    guard = felt(ForceGuard(), 45.0)
    guard.tare()
    felt(guard, *[90.0] * 5, start=1.0).check()
    felt(guard, *[99.0] * 5, start=2.0)
    guard.forget()
    guard.check()
    guard.tare()
    assert guard.eased
    felt(guard, *[45.0] * 5, start=3.0)
    assert not guard.eased
    with pytest.raises(DgsError, match="54 N"):
        guard.check()


def test_an_arm_pushed_off_its_path_meets_something_whatever_the_wrist_has_told() -> None:
    guard = felt(ForceGuard(), 0.0, 0.0)
    guard.pushed_off()
    with pytest.raises(DgsError, match="pushed the arm off its path") as error:
        guard.check()
    assert error.value.code == ErrorCode.FORCE_LIMIT
    guard.forget()
    guard.check()


def test_without_a_sensor_or_a_bound_nothing_is_refused() -> None:
    ForceGuard().check()
    boundless = felt(ForceGuard(0.0), *[500.0] * 9)
    boundless.pushed_off()
    boundless.check()


class BlindRobot(RehearsalRobot):
    """Sees no cloud."""

    def look(self, fresh: bool) -> ArmSituation:
        self.cloud = ObstacleCloud()
        return self.situation()


HEIGHT = 0.12


@pytest.fixture
def world() -> Iterator[World]:
    """With a heavy block in the middle of the table."""
    corners = [[0.06 * a, 0.06 * b, HEIGHT / 2 * c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    block = from_parts("block", "cuboid", "box", [np.array(corners)], 20.0)
    place = transform(position=(*CELL.workspace_centre, CELL.table_height + HEIGHT / 2 + 0.001))
    world = World([PlacedObject(block, place)])
    yield world
    world.close()


class BrakingRobot(BlindRobot):
    """Still brakes while it plans the way off: the newest measurement is not where it stands then."""

    late = 1

    def situation(self) -> ArmSituation:
        now = super().situation()
        if self._stage != "back_off" or not self.late:
            return now
        self.late -= 1
        return replace(now, arm_joints=now.arm_joints + 0.1)


class Stuck(BrakingRobot):
    late = 1000


def pick(
    world: World, max_force: float, height: float = 0.08, kind: type[BlindRobot] = BlindRobot
) -> tuple[Report, BlindRobot]:
    """Without the force that ends the approach the TCP would come so high above the table [m]."""
    given = ArmExecutorParameters(max_force=max_force)
    robot = kind(world, given, 0, "raw")
    grasps = top_grasps(np.array([*CELL.workspace_centre, CELL.table_height + height]))
    report = Execution(robot, PickPlanner(settings=given, scene_settings=given), given).pick(grasps, Wish())
    return report, robot


@pytest.mark.parametrize("kind", [BlindRobot, BrakingRobot])
def test_an_arm_that_comes_down_on_what_nobody_saw_stops_and_backs_off(
    world: World, kind: type[BlindRobot]
) -> None:
    report, robot = pick(world, 50.0, kind=kind)
    assert report.code == ErrorCode.FORCE_LIMIT and report.message.startswith("approach: the hand meets")
    assert report.message.endswith("the arm holds and the hand is open")
    assert np.abs(world.wrench()).max() < 1.0, "it touches nothing any more"
    block = world.object_states()[0].pose[2, 3] + HEIGHT / 2
    fingers = [world.link_pose(f"{finger}_distal")[2, 3] for finger in ("index", "middle", "ring")]
    assert min(fingers) > block + 0.02, "above what it met"
    again = Execution(robot, PickPlanner(), ArmExecutorParameters()).go_home()
    assert again.code == ErrorCode.SUCCESS


def test_an_arm_that_cannot_back_off_says_so(world: World) -> None:
    report, _ = pick(world, 50.0, kind=Stuck)
    assert report.code == ErrorCode.FORCE_LIMIT
    assert "the arm holds, but could not back off (back_off: the arm is 0.1" in report.message


def test_near_the_grasp_the_hand_closes_on_what_it_has_met(world: World) -> None:
    report, _ = pick(world, 50.0, height=0.17)
    assert report.code == ErrorCode.NOTHING_HELD, "a block of 20 kg and 12 cm stays"
    stages = list(report.stage_times)
    assert stages[stages.index("approach") :][:4] == ["approach", "back_off", "close", "lift"]


def test_fingers_that_come_down_on_what_they_push_go_on_with_less_force_and_leave_it_upwards(
    world: World,
) -> None:
    given = ArmExecutorParameters()
    straight = top_grasps(np.array([*CELL.workspace_centre, CELL.table_height + 0.175]), final=np.zeros(20))
    motion, none = np.array([[0.0, 0.1, 0.0]]), np.zeros((1, HAND.finger_count), dtype=bool)
    robot, planner = BlindRobot(world, given, 0, "raw"), PickPlanner(settings=given, scene_settings=given)
    push = replace(straight, active_fingers=none, motion=motion)
    report = Execution(robot, planner, given).pick(push, Wish())
    assert report.code == ErrorCode.SUCCESS and "pushed over 100 mm" in report.message
    assert list(report.stage_times)[-5:] == ["approach", "back_off", "advance", "lift", "home"]


def test_without_the_bound_it_would_press_on(world: World) -> None:
    pressed = list[float]()
    step = world.step

    def record() -> None:
        step()
        pressed.append(float(np.linalg.norm(world.wrench()[:3])))

    world.step = record  # type: ignore[method-assign]
    pick(world, 0.0)
    unbounded = max(np.convolve(pressed, np.ones(12) / 12, "valid"))
    assert unbounded > 100.0
