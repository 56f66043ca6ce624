"""Messages that anybody may send: read, or refused with a code; never another exception."""

from __future__ import annotations

import can
import numpy as np
import trimesh
from control_msgs.action import FollowJointTrajectory
from dgs_interfaces.action import ExecuteGrasp, MoveHand
from dgs_interfaces.msg import TargetRegion
from dgs_interfaces.srv import InjectFault, PredictGrasps, SimReset
from geometry_msgs.msg import Point, PointStamped, Pose, Quaternion, Transform, Vector3
from hypothesis import given
from hypothesis import strategies as st
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Header

from dgs_arm_executor.executor_msgs import grasps_from_goal
from dgs_arm_executor.watch import RobotWatch
from dgs_description.cell import CELL
from dgs_description.errors import DgsError
from dgs_description.frame_tree import FrameTree
from dgs_description.frames import BASE_LINK
from dgs_description.hand import HAND
from dgs_description.joints import ARM_JOINTS, JointPath
from dgs_grasp_planner.predict_msgs import brings_cloud, read_request
from dgs_hand_driver.dbc_codec import DbcCodec
from dgs_hand_driver.move_goal import parse_goal
from dgs_ros.cloud_msgs import cloud_to_numpy, numpy_to_cloud
from dgs_ros.grasp_msgs import grasps_to_msgs
from dgs_ros.image_msgs import (
    camera_info_to_pinhole,
    colour_to_numpy,
    depth_to_numpy,
    numpy_to_image,
    pinhole_to_camera_info,
)
from dgs_ros.joint_msgs import efforts_of, has_joints, positions_of, to_joint_state
from dgs_ros.pose_msgs import transform_to_matrix
from dgs_ros.trajectory_msgs import path_to_trajectory
from dgs_sim_bridge.hand.socketcand_server import parse_send
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.object_model import from_parts
from dgs_sim_bridge.sim_msgs import goal_from_message
from dgs_sim_bridge.world.faults import Faults
from dgs_sim_bridge.world.scenes import choose_models
from dgs_sim_bridge.world.trajectory import TrajectoryRefused
from tests.fuzz.cases import fuzz, hostile
from tests.support.grasps import top_grasps

CLOUD = numpy_to_cloud(np.zeros((20, 3)), BASE_LINK)
DEPTH = numpy_to_image(np.ones((4, 6), np.uint16), "camera")
STATE = to_joint_state(HAND.joints, np.zeros(20), efforts=np.zeros(HAND.joint_count))
PATH = JointPath(np.array([0.0, 1.0]), np.zeros((2, 6)), np.zeros((2, 6)), np.zeros((2, 6)))
FRAMES = FrameTree()
FRAMES.set(BASE_LINK, "camera", CELL.T_base_camera_optical)


@fuzz
@given(hostile(CLOUD))
def test_clouds(message: PointCloud2) -> None:
    try:
        points = cloud_to_numpy(message)
    except DgsError:
        return
    assert points.dtype == np.float32 and points.shape == (message.width * message.height, 3)


@fuzz
@given(hostile(DEPTH))
def test_images(message: Image) -> None:
    for read in (depth_to_numpy, colour_to_numpy):
        try:
            pixels = read(message)
        except DgsError:
            continue
        assert pixels.shape[:2] == (message.height, message.width)


@fuzz
@given(hostile(pinhole_to_camera_info(D455, "camera")))
def test_camera_infos(message: CameraInfo) -> None:
    try:
        camera = camera_info_to_pinhole(message)
    except DgsError:
        return
    assert np.isfinite([camera.fx, camera.fy, camera.cx, camera.cy]).all()


@fuzz
@given(hostile(STATE))
def test_joint_states(message: JointState) -> None:
    has_joints(message, HAND.joints)
    for read in (positions_of, efforts_of):
        try:
            assert np.isfinite(read(message, HAND.joints)).all()
        except DgsError:
            continue


@fuzz
@given(hostile(Transform(translation=Vector3(), rotation=Quaternion(w=1.0))))
def test_transforms(message: Transform) -> None:
    try:
        T_a_b = transform_to_matrix(message)
    except DgsError:
        return
    assert np.isfinite(T_a_b).all() and np.allclose(T_a_b[:3, :3] @ T_a_b[:3, :3].T, np.eye(3), atol=1e-6)


BOX = TargetRegion(
    header=Header(frame_id="camera"),
    center=Pose(position=Point(), orientation=Quaternion(w=1.0)),
    size=Vector3(x=0.1, y=0.1, z=0.1),
)
TARGET = PointStamped(header=Header(frame_id=BASE_LINK))


@fuzz
@given(
    hostile(
        PredictGrasps.Request(
            cloud=CLOUD, target_region=BOX, target_points=[TARGET, TARGET], keep_out=[BOX, BOX]
        )
    )
)
def test_requests_for_grasps(request: PredictGrasps.Request) -> None:
    brings_cloud(request)
    try:
        read_request(request, FRAMES)
    except DgsError:
        return


GOAL = ExecuteGrasp.Goal(
    header=Header(frame_id=BASE_LINK), grasps=grasps_to_msgs(top_grasps(np.array([[0.3, 0.0, -0.1]] * 3)))
)


@fuzz
@given(hostile(GOAL))
def test_goals_of_the_arm(goal: ExecuteGrasp.Goal) -> None:
    try:
        grasps = grasps_from_goal(goal)
    except DgsError:
        return
    assert np.isfinite(grasps.pose).all() and np.isfinite(grasps.grasp_joints).all()


@fuzz
@given(hostile(MoveHand.Goal(joint_names=list(HAND.joints), positions=[0.1] * 20, speed=1.0)))
def test_goals_of_the_hand(goal: MoveHand.Goal) -> None:
    try:
        parsed = parse_goal(goal.joint_names, goal.positions, goal.speed, goal.mode, goal.active_fingers)
    except DgsError:
        return
    assert np.isfinite(parsed.target).all() and 0 < parsed.speed < 4


@fuzz
@given(hostile(FollowJointTrajectory.Goal(trajectory=path_to_trajectory(ARM_JOINTS, PATH))))
def test_trajectories(goal: FollowJointTrajectory.Goal) -> None:
    try:
        goal_from_message(goal, now=1.0)
    except TrajectoryRefused:
        return


@fuzz
@given(hostile(InjectFault.Request(fault="jam_finger", target="thumb")))
def test_faults(request: InjectFault.Request) -> None:
    try:
        Faults.check(request.fault, request.target, request.duration)
    except DgsError:
        return
    Faults().inject(request.fault, request.target, request.duration, now=1.0)


TWO_OBJECTS = [
    from_parts(name, "cuboid", "box", [trimesh.creation.box((0.05,) * 3).vertices], 0.1)
    for name in ("a", "b")
]


@fuzz
@given(hostile(SimReset.Request(seed=1, objects=3)))
def test_numbers_of_objects(request: SimReset.Request) -> None:
    try:
        chosen = choose_models(TWO_OBJECTS, request.objects, np.random.default_rng(request.seed))
    except DgsError:
        return
    assert len({model.name for model in chosen}) == len(chosen) == request.objects


@fuzz
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["program", "safety", "speed", "force", "tick"]), st.floats(), st.integers(0, 255)
        )
    )
)
def test_states_of_the_robot(news: list[tuple[str, float, int]]) -> None:
    watch = RobotWatch(lambda: 0.0)
    for kind, number, mode in news:
        if kind == "program":
            watch.program_state(bool(mode % 2))
        elif kind == "safety":
            watch.safety_state(mode)
        elif kind == "speed":
            watch.speed_state(number)
        elif kind == "force":
            watch.force.measured(np.full(3, np.clip(np.nan_to_num(number), -1e100, 1e100)), float(mode))
        else:
            watch.tick()
        assert 0.0 <= watch.speed_scaling <= 1.0
        try:
            watch.force.check()
            watch.check_motion()
        except DgsError:
            continue


@fuzz
@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_can_frames(identifier: int, data: bytes, own: bool) -> None:
    protocol = DbcCodec()
    if own:
        known = sorted(
            frame.arbitration_id
            for frame in protocol.encode_command("position", np.zeros(20), 1.0, [True] * 5, 0)
        )
        identifier = known[identifier % len(known)]
    protocol.decode(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))


@fuzz
@given(st.lists(st.one_of(st.text("0123456789abcdefXYZ -", max_size=9), st.text(max_size=4)), max_size=12))
def test_lines_of_the_bus(fields: list[str]) -> None:
    try:
        assert len(parse_send(fields).data) <= 8
    except ValueError:
        return
