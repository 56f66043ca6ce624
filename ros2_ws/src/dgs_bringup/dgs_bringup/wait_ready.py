"""Waits until the nodes of a mode offer what they should: python -m dgs_bringup.wait_ready --mode simulation."""

from __future__ import annotations

import argparse
import sys
import time

from rclpy.node import Node

from dgs_bringup.ros_session import RosSession

SERVICES = {
    "planner": ("/predict_grasps",),
    "arm": ("/execute_grasp/_action/send_goal", "/stop", "/reset"),
    "hand": ("/dexhand/move/_action/send_goal",),
    "task": ("/clear_table/_action/send_goal",),
    "simulator": ("/sim/reset", "/sim/inject_fault"),
}
CLOUD = "/dgs/cloud"
MODES = {
    "simulation": ("simulator", "hand", "planner", "arm", "task"),
    "robot": ("hand", "planner", "arm", "task"),
    "replay": ("planner",),
}


def missing(node: Node, mode: str) -> list[str]:
    """What nobody offers yet: services by name, and the topic of clouds."""
    wanted = [service for part in MODES[mode] for service in SERVICES[part]]
    absent = [name.removesuffix("/_action/send_goal") for name in wanted if not node.count_services(name)]
    return absent + ([] if node.count_publishers(CLOUD) else [CLOUD])


def main() -> int:
    """0 when everything is there, 1 with a list of what is missing after the time limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mode", choices=sorted(MODES), default="simulation")
    parser.add_argument("--timeout", type=float, default=60.0, help="time limit [s]")
    arguments = parser.parse_args()
    end = time.monotonic() + arguments.timeout
    with RosSession("wait_ready") as session:
        while absent := missing(session.node, arguments.mode):
            if time.monotonic() > end:
                print(f"not there after {arguments.timeout:g} s: {', '.join(absent)}", file=sys.stderr)
                return 1
            time.sleep(0.1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
