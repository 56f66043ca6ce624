"""4. Pick what is at a pixel of the depth image: the place for your own detector.

bash ros2_ws/src/dgs_bringup/scripts/start_suite.sh -- python3 examples/4_pick_at_pixel.py 424 240
A detector with a mask sends a point for some of its pixels; `keep_out` says where no hand may go.
"""

import sys

import rclpy
from dgs_interfaces.action import ExecuteGrasp
from dgs_interfaces.srv import PredictGrasps
from geometry_msgs.msg import PointStamped
from rclpy.action import ActionClient
from rclpy.qos import qos_profile_sensor_data
from rclpy.wait_for_message import wait_for_message
from sensor_msgs.msg import CameraInfo, Image

from dgs_ros.image_msgs import camera_info_to_pinhole, depth_to_numpy

DEPTH = "/camera/camera/depth"
NO_CLOUD_YET = 104


def point_at(node: rclpy.node.Node, u: int, v: int) -> PointStamped:
    """What the depth camera sees at a pixel, in its own frame."""
    _, info = wait_for_message(CameraInfo, node, f"{DEPTH}/camera_info", qos_profile=qos_profile_sensor_data)
    _, image = wait_for_message(Image, node, f"{DEPTH}/image_rect_raw", qos_profile=qos_profile_sensor_data)
    camera, z = camera_info_to_pinhole(info), float(depth_to_numpy(image)[v, u]) * 1e-3
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
    planner.wait_for_service()
    arm.wait_for_server()
    request = PredictGrasps.Request(target_points=[point_at(node, u, v)], seed=1)
    while True:
        future = planner.call_async(request)
        rclpy.spin_until_future_complete(node, future)
        answer = future.result()
        if answer.error_code != NO_CLOUD_YET:
            break
    if answer.error_code:
        sys.exit(f"{answer.error_code}: {answer.message}")
    sent = arm.send_goal_async(ExecuteGrasp.Goal(header=answer.header, grasps=answer.grasps))
    rclpy.spin_until_future_complete(node, sent)
    done = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, done)
    result = done.result().result
    print(f"{result.error_code}: {result.message}")
    for refused in result.rejections:
        print(f"grasp {refused.index} was refused ({refused.code}): {refused.reason}")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
