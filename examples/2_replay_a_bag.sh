#!/usr/bin/env bash
# 2. Replay a recorded bag, of depth images or clouds, into the planner, and ask for grasps. No robot, no simulator.
#    bash examples/2_replay_a_bag.sh [BAG]
set -euo pipefail
repo=$(realpath "$(dirname "${BASH_SOURCE[0]}")/..")
bash "$repo/ros2_ws/src/dgs_bringup/scripts/replay_bag.sh" "${1:-$repo/tests/data/table_depth}" -- \
  python3 "$repo/examples/1_ask_for_grasps.py"
