"""Requests and replies of /predict_grasps, and the parameters they fall back on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dgs_interfaces.msg import TargetRegion
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import Point, PointStamped, Pose, PoseStamped, Quaternion, Vector3
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from dgs_description.cell import CELL
from dgs_description.errors import ErrorCode
from dgs_description.frame_tree import FrameTree
from dgs_description.frames import transform
from dgs_grasp_planner.network.decode import grasps_from_outputs
from dgs_grasp_planner.predict_msgs import brings_cloud, fill_success, read_request
from dgs_grasp_planner.scene import Prediction
from dgs_ros.cloud_msgs import numpy_to_cloud
from tests.support.refused import refused


def _region(frame: str = "base_link", size: float = 0.2, pose: Pose | None = None) -> TargetRegion:
    centre = pose or Pose(position=Point(x=0.3, y=0.1, z=-0.1))
    return TargetRegion(header=Header(frame_id=frame), center=centre, size=Vector3(x=size, y=size, z=size))


def _target(frame: str = "base_link", x: float = 0.3) -> PointStamped:
    return PointStamped(header=Header(frame_id=frame), point=Point(x=x, y=0.1, z=-0.1))


def _failed(frame: str = "base_link", w: float = 1.0) -> PoseStamped:
    pose = Pose(position=Point(x=0.3, y=0.1, z=-0.1), orientation=Quaternion(w=w))
    return PoseStamped(header=Header(frame_id=frame), pose=pose)


def test_an_empty_request_means_the_defaults() -> None:
    wishes = read_request(PredictGrasps.Request(), FrameTree())
    assert (wishes.targets, wishes.keep_out) == (None, ())
    assert (wishes.max_grasps, wishes.min_score, wishes.region) == (None, None, None)
    assert wishes.failed.shape == (0, 4, 4)
    assert not brings_cloud(PredictGrasps.Request())


def test_a_cloud_without_points_is_still_a_cloud() -> None:
    assert brings_cloud(PredictGrasps.Request(cloud=numpy_to_cloud(np.zeros((0, 3)), "base_link")))
    assert brings_cloud(PredictGrasps.Request(cloud=numpy_to_cloud(np.zeros((1, 3)), "")))
    assert brings_cloud(PredictGrasps.Request(cloud=PointCloud2(width=5, height=1))), (
        "though it lacks its data"
    )


def test_region_is_turned_into_the_table_frame() -> None:
    frames = FrameTree()
    frames.set("base_link", "shelf", transform(((0, -1, 0), (1, 0, 0), (0, 0, 1)), CELL.T_base_table[:3, 3]))
    pose = Pose(position=Point(x=0.1, y=0.0, z=0.0))
    region = read_request(PredictGrasps.Request(target_region=_region("shelf", 0.05, pose)), frames).region
    assert region is not None
    inside = region.contains(np.array([[0.0, 0.1, 0.0], [0.1, 0.0, 0.0]]))
    assert inside.tolist() == [True, False]


def test_targets_and_boxes_are_turned_into_the_table_frame() -> None:
    frames = FrameTree()
    frames.set("base_link", "camera", transform(position=(0.0, 0.0, 1.0)))
    request = PredictGrasps.Request(
        target_points=[_target(), _target("camera")], keep_out=[_region(size=0.1)]
    )
    wishes = read_request(request, frames)
    assert wishes.targets is not None
    here = np.array([0.3, 0.1, -0.1]) - CELL.T_base_table[:3, 3]
    np.testing.assert_allclose(wishes.targets, [here, here + (0, 0, 1)], atol=1e-12)
    assert wishes.keep_out[0].contains(here[None]).all()


def test_failed_grasps_are_turned_into_the_table_frame() -> None:
    (failed,) = read_request(PredictGrasps.Request(failed=[_failed()]), FrameTree()).failed
    np.testing.assert_allclose(CELL.T_base_table @ failed, transform(position=(0.3, 0.1, -0.1)), atol=1e-12)


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (PredictGrasps.Request(max_grasps=257), ErrorCode.REQUEST_INVALID),
        (PredictGrasps.Request(min_score=1.5), ErrorCode.REQUEST_INVALID),
        (PredictGrasps.Request(min_score=-0.1), ErrorCode.REQUEST_INVALID),
        (PredictGrasps.Request(min_score=math.nan), ErrorCode.REQUEST_INVALID),
        (PredictGrasps.Request(target_region=_region("moon")), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(target_region=_region(size=0.0)), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(target_region=_region(size=math.inf)), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(target_points=[_target(frame="moon")]), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(target_points=[_target(x=math.nan)]), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(keep_out=[TargetRegion()]), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(keep_out=[_region(size=100.0)]), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(keep_out=[_region()] * 33), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(failed=[_failed("moon")]), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(failed=[_failed(w=0.0)]), ErrorCode.REGION_INVALID),
        (PredictGrasps.Request(failed=[_failed()] * 257), ErrorCode.REQUEST_INVALID),
        (
            PredictGrasps.Request(target_region=_region(pose=Pose(orientation=Quaternion(w=0.0)))),
            ErrorCode.REGION_INVALID,
        ),
    ],
)
def test_invalid_wishes(request_: PredictGrasps.Request, code: ErrorCode) -> None:
    with refused(code):
        read_request(request_, FrameTree())


def test_what_is_wrong_with_a_box_is_said_of_that_box() -> None:
    for bad in (_region("moon"), _region(size=0.0), _region(pose=Pose(orientation=Quaternion(w=0.0)))):
        with refused(ErrorCode.REGION_INVALID, "keep-out box 1"):
            read_request(PredictGrasps.Request(keep_out=[_region(), bad]), FrameTree())


def test_reply() -> None:
    zeros = np.zeros((2, 15))
    sixd = np.tile([1.0, 0, 0, 0, 1, 0], (2, 1))
    grasps = grasps_from_outputs(
        np.ones((2, 3)), np.array([0.4, 0.9]), sixd, np.full((2, 3), 0.01), zeros, zeros
    )
    response = PredictGrasps.Response()
    header = Header(frame_id="camera_depth_optical_frame")
    header.stamp.sec = 7
    fill_success(response, Prediction(grasps, 123, {"network": 0.1, "total": 0.2}), header)
    assert (response.error_code, response.points_used) == (0, 123)
    assert (response.header.frame_id, response.header.stamp.sec) == ("base_link", 7)
    assert [round(g.score, 3) for g in response.grasps] == [0.9, 0.4]
    assert response.grasps[0].tcp_pose.position.x == pytest.approx(1.01)
    assert [stage.stage for stage in response.stage_times] == ["network", "total"]
