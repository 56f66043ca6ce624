"""1. Ask the running suite for grasps of what its camera sees.

bash ros2_ws/src/dgs_bringup/scripts/start_suite.sh -- python3 examples/1_ask_for_grasps.py
"""

import sys
import time

import rclpy
from dgs_interfaces.srv import PredictGrasps

NO_CLOUD_YET = 104

rclpy.init()
node = rclpy.create_node("asker")
client = node.create_client(PredictGrasps, "/predict_grasps")
if not client.wait_for_service(timeout_sec=10.0):
    sys.exit("nobody serves /predict_grasps: start the suite, with the command at the top of this file")
end = time.monotonic() + 60.0
while True:
    future = client.call_async(PredictGrasps.Request(max_grasps=5, seed=1))
    rclpy.spin_until_future_complete(node, future, timeout_sec=60.0)
    answer = future.result()
    if answer is None:
        sys.exit("/predict_grasps gave no answer within 60 s")
    if answer.error_code != NO_CLOUD_YET or time.monotonic() > end:
        break
    time.sleep(0.5)

if answer.error_code:
    sys.exit(f"{answer.error_code}: {answer.message}")
print(f"{len(answer.grasps)} grasps in {answer.header.frame_id} by {answer.model_id}")
for grasp in answer.grasps:
    p = grasp.tcp_pose.position
    print(f"score {grasp.score:.2f} at ({p.x:.3f}, {p.y:.3f}, {p.z:.3f}) m, proposed by {grasp.source}")
