"""1. Ask the running suite for grasps of what its camera sees.

bash ros2_ws/src/dgs_bringup/scripts/start_suite.sh -- python3 examples/1_ask_for_grasps.py
"""

import sys

import rclpy
from dgs_interfaces.srv import PredictGrasps

NO_CLOUD_YET = 104

rclpy.init()
node = rclpy.create_node("asker")
client = node.create_client(PredictGrasps, "/predict_grasps")
client.wait_for_service()
while True:
    future = client.call_async(PredictGrasps.Request(max_grasps=5, seed=1))
    rclpy.spin_until_future_complete(node, future)
    answer = future.result()
    if answer.error_code != NO_CLOUD_YET:
        break

if answer.error_code:
    sys.exit(f"{answer.error_code}: {answer.message}")
print(f"{len(answer.grasps)} grasps in {answer.header.frame_id} by {answer.model_id}")
for grasp in answer.grasps:
    p = grasp.tcp_pose.position
    print(f"score {grasp.score:.2f} at ({p.x:.3f}, {p.y:.3f}, {p.z:.3f}) m, proposed by {grasp.source}")
