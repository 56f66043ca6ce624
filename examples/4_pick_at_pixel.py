"""4. Pick what is at a pixel of the depth image: the place for your own detector.

bash ros2_ws/src/dgs_bringup/scripts/start_suite.sh -- python3 examples/4_pick_at_pixel.py 424 240
A detector with a mask sends a point for some of its pixels; `keep_out` says where no hand may go.
"""

import argparse
import sys
import time
from typing import Any

import rclpy
from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import PointStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.wait_for_message import wait_for_message
from sensor_msgs.msg import CameraInfo, Image

from dgs_ros.image_msgs import camera_info_to_pinhole, depth_to_metres

DEPTH = "/camera/camera/depth"
NO_CLOUD_YET = 104
START = "start the suite, with the command at the top of this file"


def newest(node: Node, kind: Any, topic: str) -> Any:
    """The next message of a topic of the camera."""
    came, message = wait_for_message(
        kind, node, topic, qos_profile=qos_profile_sensor_data, time_to_wait=10.0
    )
    if not came:
        sys.exit(f"nothing came on {topic}: {START}")
    return message


def answer_of(node: Node, future: Any, name: str, limit: float = 60.0) -> Any:
    """What a server answers within a time limit [s]."""
    rclpy.spin_until_future_complete(node, future, timeout_sec=limit)
    if not future.done():
        sys.exit(f"{name} gave no answer within {limit:g} s")
    return future.result()


def point_at(node: Node, u: int, v: int) -> PointStamped:
    """What the depth camera sees at a pixel, in its own frame."""
    info = newest(node, CameraInfo, f"{DEPTH}/camera_info")
    image = newest(node, Image, f"{DEPTH}/image_rect_raw")
    if not (0 <= u < image.width and 0 <= v < image.height):
        sys.exit(f"pixel ({u}, {v}) is outside of the image of {image.width} x {image.height}")
    camera, z = camera_info_to_pinhole(info), float(depth_to_metres(image)[v, u])
    if z == 0.0:
        sys.exit(f"nothing was measured at pixel ({u}, {v})")
    seen = PointStamped(header=image.header)
    seen.point.x, seen.point.y, seen.point.z = (
        (u - camera.cx) / camera.fx * z,
        (v - camera.cy) / camera.fy * z,
        z,
    )
    return seen


def main(u: int, v: int) -> None:
    """Ask for grasps of that thing, and let the arm take the best that it can reach."""
    rclpy.init()
    node = rclpy.create_node("pick_at_pixel")
    planner = node.create_client(PredictGrasps, "/predict_grasps")
    arm = ActionClient(node, ExecuteGrasp, "/execute_grasp")
    if not (planner.wait_for_service(timeout_sec=10.0) and arm.wait_for_server(timeout_sec=10.0)):
        sys.exit(f"nobody serves /predict_grasps or /execute_grasp: {START}")
    request = PredictGrasps.Request(target_points=[point_at(node, u, v)], seed=1)
    end = time.monotonic() + 60.0
    while True:
        answer = answer_of(node, planner.call_async(request), "/predict_grasps")
        if answer.error_code != NO_CLOUD_YET or time.monotonic() > end:
            break
        time.sleep(0.5)
    if answer.error_code:
        sys.exit(f"{answer.error_code}: {answer.message}")
    goal = ExecuteGrasp.Goal(header=answer.header, grasps=answer.grasps)
    handle = answer_of(node, arm.send_goal_async(goal), "/execute_grasp")
    result = answer_of(node, handle.get_result_async(), "/execute_grasp", 300.0).result
    print(f"{result.error_code}: {result.message}")
    for refused in result.rejections:
        print(f"grasp {refused.index} was refused ({refused.code}): {refused.reason}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Pick what is at a pixel of the depth image.")
    parser.add_argument("u", type=int, help="column")
    parser.add_argument("v", type=int, help="row")
    main(**vars(parser.parse_args()))
