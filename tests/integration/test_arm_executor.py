"""The arm executor with the real hand driver and the simulated arm: picks, refusals, faults, stop and reset."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from action_msgs.msg import GoalStatus
from dgs_interfaces.action import ExecuteGrasp, MoveHand
from dgs_interfaces.msg import Grasp, PickPlan
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.parameter import Parameter
from tf2_msgs.msg import TFMessage

from dgs_arm_executor.arm_executor_node import ArmExecutorNode
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.errors import ErrorCode
from dgs_description.frames import BASE_LINK, CAMERA_OPTICAL, apply, inverse
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS
from dgs_grasp_planner.contact.height_field import height_field
from dgs_grasp_planner.planner_parameters import PlannerParameters
from dgs_grasp_planner.propose.drag import drags
from dgs_grasp_planner.propose.edge_pinch import edge_pinches
from dgs_grasp_planner.propose.push import pushes
from dgs_learning.objects.catalogue import make_catalogue
from dgs_ros.cloud_msgs import numpy_to_cloud
from dgs_ros.grasp_msgs import grasps_to_msgs
from dgs_ros.pose_msgs import matrix_to_transform, pose_to_matrix
from dgs_ros.trajectory_msgs import trajectory_to_path
from dgs_sim_bridge.render.object_model import find_catalogue, from_parts, save_catalogue
from tests.support.arm_cell import FIST, LATCHED, TABLE, Cell, Run, top_grasp
from tests.support.environment import free_port, reserved_domain_id, wait_until
from tests.support.processes import suite_node
from tests.support.refused import refused
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration

NEAR = (0.2, -0.25, -0.08)
"""A place next to the home posture: short ways."""
TO_LIFT = ("planning", "transfer", "approach", "close", "lift")
WRENCH = "/force_torque_sensor_broadcaster/wrench"
SEEDS = (2, 0, 1)
"""Scenes of one object that a grasp across it lifts: hex_box_014, spool_007, hex_box_006."""
BOOK = 96
"""Seed of a scene with one household thing, a book."""
DRAGGED = range(8)
"""Seeds of a scene with one spanner, of which the arm can drag some."""
PARAMETERS = {
    "max_cloud_age": 4.0,
    "joint_state_timeout": 0.5,  # a busy machine's simulator pauses for a moment
    # Long enough for what is to happen meanwhile, also on a busy machine.
    "carry_speed": 0.05,
}


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    logs = tmp_path_factory.mktemp("logs")
    port = free_port()
    with reserved_domain_id() as domain, RosClient(domain) as client:
        world = {"hand_port": port, "objects": 0, "real_time_factor": 2.0}
        sim = suite_node("sim_bridge_node", domain, logs, world)
        hand = suite_node("hand_driver_node", domain, logs, {"port": port, "use_sim_time": True})
        arm = suite_node("arm_executor_node", domain, logs, {"use_sim_time": True, **PARAMETERS})
        with sim, hand, arm:
            cell = Cell(arm, sim, client)
            arm.wait_ready(cell.action.server_is_ready)
            hand.wait_ready(lambda: client.node.count_publishers("/dexhand/joint_states") > 0)
            yield cell


@pytest.fixture
def bench(cell: Cell) -> Iterator[Cell]:
    """The cell without objects, faults or stops, the arm at home."""
    cell.fault("clear")
    cell.reset_scene(0)
    cell.trigger("/reset")
    cell.show_cloud(np.zeros((0, 3)))
    cell.sim.wait_ready(lambda: np.abs(cell.arm() - HOME_ARM).max() < 0.02)
    yield cell
    cell.fault("clear")


@pytest.mark.parametrize(
    ("name", "value"),
    [("controller_name", "my arm"), ("controller_name", ""), ("payload_service", "/set-payload")],
)
def test_names_that_ros_does_not_take_are_refused(ros_client: RosClient, name: str, value: str) -> None:
    with refused(ErrorCode.PARAMETER_INVALID, f"'{name}': .*must not contain"):
        ArmExecutorNode(
            context=ros_client.node.context, parameter_overrides=[Parameter(name, value=value)]
        ).destroy_node()


def test_pick_of_an_empty_place_ends_at_home_with_nothing_held(bench: Cell) -> None:
    far = top_grasp(1.2, 0.0, -0.1)
    under = top_grasp(0.3, 0.1, -0.24)
    status, result, stages = bench.pick([far, under, top_grasp(*NEAR)])
    assert result.error_code == ErrorCode.NOTHING_HELD, result.message
    assert status == GoalStatus.STATUS_ABORTED
    assert result.executed_index == 2 and not result.object_held
    assert [(r.index, r.code) for r in result.rejections][0] == (0, ErrorCode.OUT_OF_REACH)
    assert (
        result.rejections[1].code == ErrorCode.COLLISION_APPROACH and "table" in result.rejections[1].reason
    )
    assert stages == [*TO_LIFT, "release", "home"]
    assert np.abs(bench.arm() - HOME_ARM).max() < 0.02
    assert np.abs(bench.hand() - HAND.open_hand).max() < 0.1
    assert {stage.stage for stage in result.stage_times} == set(stages)


def test_the_hand_closes_the_fingers_that_the_grasp_states(bench: Cell) -> None:
    grasp = top_grasp(*NEAR)
    grasp.active_fingers = [True, True, True, True, False]
    run = bench.start([grasp])
    beyond = np.full(2, -np.inf)
    while not run.done():  # a busy machine hears too late that the lift has begun
        beyond = np.maximum(beyond, bench.hand()[13::4] - FIST[13::4])
        time.sleep(0.02)
    _, result, _ = run.end()
    assert result.error_code == ErrorCode.NOTHING_HELD, result.message
    assert beyond[0] > 0.5 * HAND.grasp.beyond[1] and abs(beyond[1]) < 0.05


def grasp_across(vertices: np.ndarray, T_base_object: np.ndarray) -> Grasp:
    """A grasp from above across the narrowest side of an object, the hand wide open before."""
    points = apply(T_base_object, vertices)
    yaws = np.arange(0.0, np.pi, 0.1)
    yaw = float(min(yaws, key=lambda yaw: np.ptp(points[:, :2] @ (np.cos(yaw), np.sin(yaw)))))
    turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    local = points[:, :2] @ turn.T
    x, y = turn.T @ (local.min(0) + local.max(0)) / 2
    grasp = top_grasp(float(x), float(y), max(float(points[:, 2].max()) - 0.02, -0.13), yaw)
    grasp.pre_grasp_joints = [0.0, 0.05, 0.05, 0.05] * 5
    return grasp


def object_on_the_table(bench: Cell, seed: int) -> tuple[str, Grasp]:
    """A scene of one object that the executor sees: its name, and a grasp for it."""
    models = {model.name: model for model in find_catalogue("novel", "")}
    bench.reset_scene(1, seed)
    state = bench.objects()
    T_base_object = pose_to_matrix(state.poses[0])
    model = models[state.names[0]]
    surface = trimesh.Trimesh(model.vertices, model.faces).sample(6000, seed=seed)
    bench.show_cloud(apply(T_base_object, np.asarray(surface)))
    return state.names[0], grasp_across(model.vertices.astype(float), T_base_object)


def test_pick_of_an_object_puts_it_into_the_bin(bench: Cell) -> None:
    attempts = []
    for seed in SEEDS:
        name, grasp = object_on_the_table(bench, seed)
        _, result, stages = bench.pick([grasp])
        attempts.append((name, result.message, [r.reason for r in result.rejections]))
        if result.error_code == ErrorCode.SUCCESS:
            assert result.object_held
            assert stages == [*TO_LIFT, "carry", "release", "home"]
            assert result.object_released and bench.objects().places[0] == "bin"
            payloads = re.findall(r"payload ([\d.]+) kg", bench.sim.log())
            assert [float(mass) for mass in payloads[-3:]] == pytest.approx([1.507, 1.707, 1.507])
            return
        bench.trigger("/reset")
    pytest.fail(f"no object was picked: {attempts}")


def at_the_edge(bench: Cell) -> tuple[bool, list[Grasp]]:
    """Pinches of the book as it lies over the table's edge, or pushes that take it there; whether they are pinches."""
    (name,), (pose,) = bench.objects().names, bench.objects().poses
    book = next(model for model in find_catalogue("household", "") if model.name == name)
    surface = np.asarray(trimesh.Trimesh(book.vertices, book.faces).sample(20_000, seed=BOOK))
    seen = apply(pose_to_matrix(pose), surface)
    bench.show_cloud(seen)
    field = height_field(apply(inverse(CELL.T_base_table), seen))
    assert name == "book_001"
    edge = CELL.table_edge - CELL.workspace_centre[0]
    pinches = edge_pinches(field, edge)
    grasps = pinches if len(pinches) else pushes(field, edge, PlannerParameters().push())
    return len(pinches) > 0, grasps_to_msgs(grasps.best_first().moved(CELL.T_base_table))


def test_a_book_is_pushed_over_the_edge_and_pinched_there(bench: Cell) -> None:
    bench.reset_scene(1, BOOK, "household")
    ends = []
    for _ in range(5):
        pinches, grasps = at_the_edge(bench)
        _, result, _ = bench.pick(grasps)
        ends.append((pinches, result.error_code, result.message))
        if pinches and result.error_code == ErrorCode.SUCCESS:
            assert bench.objects().places[0] == "bin", ends
            return
    pytest.fail(f"it is not in the bin: {ends}")


def test_what_nobody_saw_is_pressed_on_no_harder_than_the_bound(bench: Cell, tmp_path: Path) -> None:
    block = trimesh.creation.box((0.12, 0.12, 0.12)).vertices
    save_catalogue(tmp_path / "block.npz", [from_parts("block", "cuboid", "box", [block], 3.0)])
    bench.reset_scene(1, 0, str(tmp_path / "block.npz"))
    middle = bench.objects().poses[0].position
    felt: list[float] = []
    note: Callable[[WrenchStamped], None] = lambda msg: felt.append(msg.wrench.force.z)  # noqa: E731
    listener = bench.client.node.create_subscription(WrenchStamped, WRENCH, note, 5000)
    _, result, stages = bench.pick([top_grasp(middle.x, middle.y, CELL.table_height + 0.08)])
    assert result.error_code == ErrorCode.FORCE_LIMIT, result.message
    assert result.message.startswith("approach: ") and result.message.endswith("the hand is open")
    assert stages[-2:] == ["approach", "back_off"]
    wait_until(lambda: min(felt, default=0.0) < -50.0 and abs(felt[-1]) < 1.0)  # its z points down
    bench.client.node.destroy_subscription(listener)
    assert bench.go_home().error_code == ErrorCode.SUCCESS


def wait_told(bench: Cell, word: str) -> None:
    """Until a node's report says it."""
    said: list[str] = []
    subscription = bench.client.node.create_subscription(
        DiagnosticArray, "/diagnostics", lambda report: said.extend(s.message for s in report.status), 10
    )
    bench.executor.wait_ready(lambda: any(word in message for message in said))
    bench.client.node.destroy_subscription(subscription)


def test_a_wrist_that_says_nothing_is_told(bench: Cell) -> None:
    wait_told(bench, "the hand feels")
    bench.fault("drop_joint_states")
    wait_told(bench, "no force comes on")
    bench.fault("clear")
    wait_told(bench, "the hand feels")


def test_a_camera_that_stands_elsewhere_is_told(bench: Cell) -> None:
    publisher = bench.client.node.create_publisher(TFMessage, "/tf_static", LATCHED)
    there = CELL.T_base_camera_optical.copy()
    there[2, 3] += 0.3
    for pose, words in (
        (there, "the camera stands 0.30 m from where the arm takes it"),
        (CELL.T_base_camera_optical, "the camera stands where the arm takes it to be"),
    ):
        publisher.publish(TFMessage(transforms=[matrix_to_transform(pose, BASE_LINK, CAMERA_OPTICAL)]))
        wait_told(bench, words)


def test_a_spanner_is_dragged_along_the_table_with_the_hand_closed(bench: Cell, tmp_path: Path) -> None:
    spanner = next(model for model in make_catalogue("everyday") if model.family == "spanner")
    save_catalogue(tmp_path / "one.npz", [spanner])
    surface = np.asarray(trimesh.Trimesh(spanner.vertices, spanner.faces).sample(20_000, seed=0))
    edge, ends = CELL.table_edge - CELL.workspace_centre[0], []
    for seed in DRAGGED:
        bench.reset_scene(1, seed, str(tmp_path / "one.npz"))
        before = pose_to_matrix(bench.objects().poses[0])
        seen = apply(before, surface)
        bench.show_cloud(seen)
        field = height_field(apply(inverse(CELL.T_base_table), seen))
        found = drags(field, edge, PlannerParameters().push()).best_first().moved(CELL.T_base_table)
        _, result, stages = bench.pick(grasps_to_msgs(found))
        ends.append((seed, before[:2, 3].round(2).tolist(), len(found), result.message))
        if result.error_code == ErrorCode.SUCCESS:
            assert stages == [
                "planning",
                "transfer",
                "approach",
                "close",
                "advance",
                "release",
                "lift",
                "home",
            ]
            moved = pose_to_matrix(bench.objects().poses[0])[:3, 3] - before[:3, 3]
            motion = found[result.executed_index].motion
            assert not result.object_held and bench.objects().places[0] == "table"
            assert moved @ motion > 0.3 * motion @ motion and abs(moved[2]) < 0.01, ends
            return
    pytest.fail(f"none was dragged: {ends}")


def test_the_next_pick_is_planned_while_the_arm_goes_home_from_a_push(bench: Cell) -> None:
    bench.reset_scene(1, BOOK, "household")
    pinches, grasps = at_the_edge(bench)
    assert not pinches
    first = bench.start(grasps, stay_over_bin=True)
    first.wait_for("home")
    following = bench.start([top_grasp(*NEAR)])
    following.wait_for("planning")
    result = first.end()[1]
    assert result.error_code == ErrorCode.SUCCESS, result.message
    assert first.out_of_view
    _, result, stages = following.end()
    assert result.error_code == ErrorCode.NOTHING_HELD, result.message
    assert stages[:3] == ["planning", "waiting", "look_again"]


def carrying(bench: Cell) -> Run:
    """A pick that is to stay over the bin, on its way there."""
    attempts = []
    for seed in SEEDS * 3:
        name, grasp = object_on_the_table(bench, seed)
        run = bench.start([grasp], stay_over_bin=True)
        wait_until(lambda run=run: "carry" in run.stages or run.done())
        if not run.done():
            return run
        # Not held, or over before a busy machine let this process hear of it.
        attempts.append((name, run.end()[1].message))
    pytest.fail(f"no object was met while it was carried: {attempts}")


def test_the_next_pick_is_planned_while_one_carries_and_starts_over_the_bin(bench: Cell) -> None:
    first = carrying(bench)
    following = bench.start([top_grasp(*NEAR)])
    following.wait_for("planning")
    assert not first.done()
    assert bench.pick([top_grasp(*NEAR)])[1].error_code == ErrorCode.EXECUTOR_BUSY, "one may follow"
    _, result, _ = first.end()
    assert result.error_code == ErrorCode.SUCCESS, result.message
    # Of its feedback a stalled client may find the follower's in place: both come on one topic.
    assert [timed.stage for timed in result.stage_times][-2:] == ["carry", "release"] and first.out_of_view
    _, result, stages = following.end()
    # The cloud still shows the object, which is not around the other grasp.
    assert result.error_code == ErrorCode.NOTHING_HELD, result.message
    assert stages[:3] == ["planning", "waiting", "look_again"]


def test_a_stop_ends_the_pick_that_carries_and_the_one_behind_it(bench: Cell) -> None:
    for _ in range(3):
        first = carrying(bench)
        following = bench.start([top_grasp(*NEAR)])
        following.wait_for("planning")
        assert bench.trigger("/stop").success
        _, result, stages = following.end()
        if first.end()[1].error_code == ErrorCode.STOPPED:
            break
        # A busy machine let this process hear of the planning when the object was in the bin.
        bench.trigger("/reset")
        bench.go_home()
    else:
        pytest.fail("no pick was stopped while it carried")
    assert result.error_code in (ErrorCode.STOPPED, ErrorCode.SCENE_CHANGED), result.message
    assert set(stages) <= {"planning", "waiting"} and result.executed_index == -1
    held = bench.arm_at_rest()
    assert bench.pick([top_grasp(*NEAR)])[1].error_code == ErrorCode.STOPPED
    assert np.abs(bench.arm() - held).max() < 5e-3
    bench.trigger("/reset")
    assert bench.go_home().error_code == ErrorCode.SUCCESS


def test_plan_only_moves_nothing(bench: Cell) -> None:
    before = bench.arm()
    status, result, stages = bench.pick([top_grasp(0.3, -0.1, -0.08)], plan_only=True)
    assert (status, result.error_code, stages) == (GoalStatus.STATUS_SUCCEEDED, 0, ["planning"])
    assert np.abs(bench.arm() - before).max() < 1e-3


def test_what_was_planned_is_told_before_anything_moves(bench: Cell) -> None:
    far, near = top_grasp(1.2, 0.0, -0.1), top_grasp(0.3, -0.1, -0.08)
    bench.pick([far, near], plan_only=True)
    (plan,) = bench.client.collect(PickPlan, "/dgs/pick_plan", 1, qos=LATCHED)
    assert (plan.header.frame_id, plan.chosen) == (BASE_LINK, 1)
    assert [grasp.tcp_pose for grasp in plan.grasps] == [far.tcp_pose, near.tcp_pose]
    assert [(refused.index, refused.code) for refused in plan.rejections] == [(0, ErrorCode.OUT_OF_REACH)]
    assert plan.stages == ["transfer", "approach", "lift", "carry", "home"]
    ways = [trajectory_to_path(motion, ARM_JOINTS).positions for motion in plan.motions]
    np.testing.assert_allclose(ways[0][0], HOME_ARM, atol=0.02)
    for way, following in pairwise(ways):
        np.testing.assert_allclose(way[-1], following[0], atol=1e-6)
    bench.pick([far], plan_only=True)
    (plan,) = bench.client.collect(PickPlan, "/dgs/pick_plan", 1, qos=LATCHED)
    assert (plan.chosen, plan.stages, len(plan.rejections)) == (-1, [], 1)


@pytest.mark.parametrize(
    ("grasps", "frame", "code"),
    [
        ([], BASE_LINK, ErrorCode.NO_CANDIDATES),
        ([top_grasp(0.3, 0.0, -0.1)], "camera_link", ErrorCode.FRAME_UNKNOWN),
        ([top_grasp(0.3, 0.0, float("nan"))], BASE_LINK, ErrorCode.GRASP_INVALID),
        ([top_grasp(1.5, 0.0, -0.1)], BASE_LINK, ErrorCode.NO_FEASIBLE_GRASP),
    ],
)
def test_goals_that_cannot_be_executed_get_a_code_and_a_sentence(
    bench: Cell, grasps: list[Grasp], frame: str, code: ErrorCode
) -> None:
    status, result, _ = bench.pick(grasps, frame=frame)
    assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, code)
    assert len(result.message) > 20 and result.executed_index == -1


def test_a_cloud_in_the_way_is_a_reason(bench: Cell) -> None:
    wall = np.random.default_rng(0).uniform((0.16, -0.22, -0.2), (0.24, -0.19, 0.05), (8000, 3))
    bench.show_cloud(wall)
    results: list[ExecuteGrasp.Result] = []

    def refused() -> bool:
        results.append(bench.pick([top_grasp(*NEAR)], plan_only=True)[1])
        return results[-1].error_code == ErrorCode.NO_FEASIBLE_GRASP

    bench.executor.wait_ready(refused)
    assert "observed cloud" in results[-1].rejections[0].reason


def test_no_pick_is_planned_on_an_old_cloud_but_the_way_home_is(bench: Cell) -> None:
    bench.camera_works = False
    results: list[ExecuteGrasp.Result] = []

    def refused() -> bool:
        results.append(bench.pick([top_grasp(*NEAR)], plan_only=True)[1])
        return results[-1].error_code == ErrorCode.OBSTACLES_STALE

    try:
        bench.executor.wait_ready(refused)
        assert "/dgs/cloud" in results[-1].message
        assert bench.go_home().error_code == ErrorCode.SUCCESS
    finally:
        bench.camera_works = True


def test_stop_latches_until_reset(bench: Cell) -> None:
    run = bench.start([top_grasp(*NEAR)])
    run.wait_for("transfer")
    assert bench.trigger("/stop").success
    _, result, _ = run.end()
    assert result.error_code == ErrorCode.STOPPED and "/reset" in result.message
    held = bench.arm_at_rest()
    _, result, _ = bench.pick([top_grasp(*NEAR)])
    assert result.error_code == ErrorCode.STOPPED
    hand = bench.hand()

    def move_hand(shape: np.ndarray) -> int:
        goal = MoveHand.Goal(joint_names=list(HAND.joints), positions=shape.tolist())
        return int(bench.client.run_action(MoveHand, "/dexhand/move", goal).result.error_code)

    assert move_hand(FIST) == ErrorCode.STOPPED
    assert np.abs(bench.arm() - held).max() < 5e-3 and np.abs(bench.hand() - hand).max() < 0.02
    assert bench.trigger("/reset").success
    assert move_hand(HAND.open_hand) == ErrorCode.SUCCESS
    _, result, _ = bench.pick([top_grasp(*NEAR)], plan_only=True)
    assert result.error_code == ErrorCode.SUCCESS, result.message


@pytest.mark.parametrize("stage", ["transfer", "approach", "close"])
def test_cancel_before_the_lift_leaves_the_hand_open(bench: Cell, stage: str) -> None:
    status, result, _ = bench.start([top_grasp(*NEAR)], cancel_at=stage).end()
    assert (status, result.error_code) == (GoalStatus.STATUS_CANCELED, ErrorCode.EXECUTION_CANCELLED), (
        result.message
    )
    # On a busy machine the stage may be over when the request arrives: the rule is that of the stage that it met.
    met = result.message.partition(":")[0]
    assert met in TO_LIFT[TO_LIFT.index(stage) :]
    assert ("the hand keeps holding" if met == "lift" else "the hand is open") in result.message
    held = bench.arm_at_rest()
    if met != "lift":
        assert np.abs(bench.hand() - HAND.open_hand).max() < 0.1
    assert np.abs(bench.arm() - held).max() < 5e-3


def test_second_goal_is_told_that_the_arm_is_busy(bench: Cell) -> None:
    run = bench.start([top_grasp(*NEAR)])
    run.wait_for("transfer")
    _, result, _ = bench.pick([top_grasp(*NEAR)])
    assert result.error_code == ErrorCode.EXECUTOR_BUSY
    run.cancel()
    run.end()


@pytest.mark.parametrize(
    ("fault", "code", "end"),
    [
        ("abort_arm_goal", ErrorCode.TRAJECTORY_ABORTED, "the hand is open"),
        ("protective_stop", ErrorCode.PROTECTIVE_STOP, "/reset"),
        ("emergency_stop", ErrorCode.PROTECTIVE_STOP, "/reset"),
        ("drop_joint_states", ErrorCode.JOINT_STATES_SILENT, "the hand is open"),
    ],
)
def test_faults_of_the_arm_end_the_pick_with_their_code(
    bench: Cell, fault: str, code: ErrorCode, end: str
) -> None:
    run = bench.start([top_grasp(*NEAR)])
    run.wait_for("transfer")
    wait_until(lambda: np.abs(bench.arm() - HOME_ARM).max() > 0.1)  # at home, what follows is another story
    bench.fault(fault)
    _, result, _ = run.end()
    assert result.error_code == code, result.message
    assert end in result.message
    stopped = code == ErrorCode.PROTECTIVE_STOP
    if stopped:
        assert not bench.trigger("/reset").success
    bench.fault("clear")
    if stopped:  # also a pause that is over is no leave to go on
        held = bench.arm_at_rest()
        assert bench.go_home().error_code == ErrorCode.PROTECTIVE_STOP
        assert np.abs(bench.arm() - held).max() < 5e-3
    reset_works: Callable[[], bool] = lambda: bench.trigger("/reset").success  # noqa: E731
    bench.executor.wait_ready(reset_works)
    way_home = bench.go_home()
    assert way_home.error_code == ErrorCode.SUCCESS, way_home.message
    assert np.abs(bench.arm() - HOME_ARM).max() < 0.02
    assert np.abs(bench.hand() - HAND.open_hand).max() < 0.1


def test_table_in_the_wrong_place_forbids_motion(bench: Cell) -> None:
    results: list[ExecuteGrasp.Result] = []
    bench.cloud = numpy_to_cloud(TABLE + (0.0, 0.0, 0.015), BASE_LINK)

    def refused() -> bool:
        results.append(bench.pick([top_grasp(*NEAR)], plan_only=True)[1])
        return results[-1].error_code == ErrorCode.EXTRINSICS_OFF

    bench.executor.wait_ready(refused)
    assert "+15" in results[-1].message


def test_interrupt_in_the_middle_of_a_motion_ends_the_node_with_exit_code_0(bench: Cell) -> None:
    plans: Callable[[], ExecuteGrasp.Result] = lambda: bench.pick([top_grasp(*NEAR)], plan_only=True)[1]  # noqa: E731
    bench.executor.wait_ready(
        lambda: plans().error_code == ErrorCode.SUCCESS
    )  # the last test's cloud is gone
    run = bench.start([top_grasp(*NEAR)])
    run.wait_for("transfer")
    assert bench.executor.interrupt() == 0
    held = bench.arm_at_rest()
    assert np.abs(bench.arm() - held).max() < 5e-3
