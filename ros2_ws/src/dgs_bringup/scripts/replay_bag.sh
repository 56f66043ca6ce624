#!/usr/bin/env bash
# Replay a recorded bag without camera and without simulator: camera_node plays it as /dgs/cloud, grasp_planner_node answers
# /predict_grasps. Runs until Ctrl-C, or until COMMAND ends.
#
# usage: replay_bag.sh BAG [--params FILE]... [--log FOLDER] [--timeout S] [-- COMMAND ...]
#   BAG   rosbag2 folder, .db3 or .mcap with PointCloud2, or with depth images and their camera info;
#         topics in the bag, pace and looping are the parameters bag_* of camera_node, for --params
#   The other options are those of start_suite.sh, which does the work.
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd -P)

if [[ $# -eq 0 || $1 == -* ]]; then
  sed -n '2,9s/^# \{0,1\}//p' "$0"
  if [[ ${1-} =~ ^(-h|--help)$ ]]; then exit 0; fi
  exit 2
fi
exec bash "$here/start_suite.sh" --mode replay --bag "$1" "${@:2}"
