#!/usr/bin/env bash
# Start every node of the suite with `ros2 run`, wait until all are ready, end them all together.
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd -P)

usage() {
  cat <<TEXT
usage: start_suite.sh [--mode simulation|robot|replay] [--bag BAG] [--params FILE]... [--log FOLDER] [--timeout S] [--view] [-- COMMAND ...]

  --mode     simulation (default): all nodes and the simulator. robot: all nodes but the simulator; start the drivers of
             arm and camera before. replay: only camera_node on a recorded bag and grasp_planner_node.
  --bag      rosbag2 folder or file for --mode replay
  --params   further parameter file; its values win over those of config/suite.yaml
  --log      folder for one log file per node (default: a new one in the temporary folder)
  --timeout  how long the nodes may take to be ready [s] (default 120)
  --view     also serve the live page (dgs_viewer) and print its address, and publish /robot_description and /tf for RViz
             and Foxglove (robot_state; not in mode robot, where the driver does); their end does not end the suite
  COMMAND    is run when all nodes are ready; its end ends the nodes, its exit code is passed on. Without one the nodes
             run until Ctrl-C.
Exit code: that of COMMAND; 0 after Ctrl-C; 2 if an option is wrong or another suite runs in this ROS domain; 3 if a node
ended by itself; 4 if the nodes were not ready in time.
TEXT
}

# refuse WHY: for what is wrong before anything starts
refuse() { echo "start_suite.sh: $1" >&2; exit 2; }

mode=simulation bag='' log='' timeout=120 view=
params=()
command=()
while [[ $# -gt 0 ]]; do
  if [[ $1 =~ ^--(mode|bag|params|log|timeout)$ && $# -lt 2 ]]; then refuse "$1 needs a value"; fi
  case $1 in
    --mode) mode=$2; shift 2 ;;
    --bag) bag=$(realpath -m "$2"); shift 2 ;;
    --params) params+=("$(realpath -m "$2")"); shift 2 ;;
    --log) log=$2; shift 2 ;;
    --timeout) timeout=$2; shift 2 ;;
    --view) view=yes; shift ;;
    --) shift; command=("$@"); break ;;
    -h | --help) usage; exit 0 ;;
    *) refuse "unknown argument '$1'; --help lists the options" ;;
  esac
done
[[ $mode =~ ^(simulation|robot|replay)$ ]] || refuse "--mode is simulation, robot or replay, not '$mode'"
domain=${ROS_DOMAIN_ID:-0}
[[ $domain =~ ^(0|[1-9][0-9]{0,2})$ && $domain -le 232 ]] || refuse "ROS_DOMAIN_ID is a number from 0 to 232, not '$domain'"
[[ $timeout =~ ^0*[1-9][0-9]*(\.[0-9]+)?$ ]] || refuse "--timeout is a number of seconds, not '$timeout'"
for file in "${params[@]}"; do [[ -f $file ]] || refuse "there is no parameter file $file"; done
[[ $mode != replay || -n $bag ]] || refuse "--mode replay needs --bag"
[[ -z $bag || -e $bag ]] || refuse "there is no bag at $bag"

setup=$here/../../../setup_env.sh
if [[ -f $setup ]]; then
  source "$setup"
elif ! type -P ros2 >/dev/null; then
  refuse "no ros2 on PATH; source the workspace first"
fi
for file in "${params[@]}"; do python3 -m dgs_bringup.suite_file --check "$file" || refuse "nothing was started"; done
# Whoever is in the ROS domain has bound one of its ports.
first=$((7400 + 250 * domain))
if grep -qE ":($(printf '%04X|' $(seq $first $((first + 249))))-) " /proc/net/udp; then
  python3 -m dgs_bringup.wait_ready --mode "$mode" --before || refuse "nothing was started"
fi
if [[ -z $log ]]; then log=$(mktemp -d -t dgs_suite_XXXXXX) || refuse "the nodes' logs have no folder"; fi
{ mkdir -p "$log" && touch "$log/wait_ready.log"; } || refuse "the nodes' logs cannot be written to $log"

names=() pids=() command_pid='' view_pid='' extras=() waiting=''

# Every node gets its own process group (setsid), so Ctrl-C reaches them only through the handler below.

# launch PACKAGE EXECUTABLE [PARAMETER:=VALUE ...]: start a node; its process is $!
launch() {
  local package=$1 executable=$2 file value
  shift 2
  local -a arguments=(--params-file "$here/../config/suite.yaml")
  # What comes later wins, but a value without the node's name would lose against the node's section of a file.
  for value in "$@"; do arguments+=(-p "$executable:$value"); done
  for file in "${params[@]}"; do arguments+=(--params-file "$file"); done
  setsid ros2 run "$package" "$executable" --ros-args "${arguments[@]}" >"$log/$executable.log" 2>&1 </dev/null &
}

# start PACKAGE EXECUTABLE [PARAMETER:=VALUE ...]: a node that the suite cannot do without
start() {
  launch "$@"
  names+=("$2")
  pids+=($!)
}

# alive PID: does the process or one of its group still run?
alive() { kill -0 -- "-$1" 2>/dev/null; }

stop_all() {
  trap '' INT TERM HUP
  set +e  # a terminal that has gone takes no messages
  local pid k deadline
  if [[ -n $waiting ]]; then kill -KILL -- "-$waiting" 2>/dev/null; fi
  if [[ -n $command_pid ]] && alive "$command_pid"; then
    # The command writes what it has so far; a second signal would cut that short.
    kill -TERM -- "-$command_pid" 2>/dev/null
    deadline=$((SECONDS + 40))
    while alive "$command_pid" && ((SECONDS < deadline)); do sleep 0.1; done
    kill -KILL -- "-$command_pid" 2>/dev/null
  fi
  for pid in "${extras[@]}"; do
    names+=("a node of --view")
    pids+=("$pid")
  done
  # Not INT, to which what a script starts in the background is deaf until the node listens.
  for pid in "${pids[@]}"; do kill -TERM -- "-$pid" 2>/dev/null; done
  deadline=$((SECONDS + 6))
  for k in "${!pids[@]}"; do
    while alive "${pids[k]}" && ((SECONDS < deadline)); do sleep 0.05; done
    if alive "${pids[k]}"; then
      echo "start_suite.sh: ${names[k]} did not end and was killed" >&2
      kill -KILL -- "-${pids[k]}" 2>/dev/null
      wait "${pids[k]}" 2>/dev/null
    fi
  done
}
trap stop_all EXIT
trap 'exit 0' INT
trap 'exit 143' TERM
trap 'exit 129' HUP

# report_dead: name the node that ended and show the end of its log; 1 if all run
report_dead() {
  local k
  for k in "${!pids[@]}"; do
    if ! kill -0 "${pids[k]}" 2>/dev/null; then
      local status=0
      wait "${pids[k]}" || status=$?
      echo "start_suite.sh: ${names[k]} ended with exit code $status. The end of $log/${names[k]}.log:" >&2
      tail -n 8 "$log/${names[k]}.log" >&2
      return 0
    fi
  done
  return 1
}

clock=() camera=() hand=()
if [[ $mode != simulation ]]; then clock=(use_sim_time:=false); fi
case $mode in
  simulation) start dgs_sim_bridge sim_bridge_node ;;
  robot) camera=(source:=depth_topics) hand=(interface:=socketcan channel:=can0) ;;
  replay) camera=(source:=rosbag "bag_path:='${bag//\'/\'\'}'" bag_restamp:=true) ;;
esac
start dgs_perception camera_node "${clock[@]}" "${camera[@]}"
if [[ $mode != replay ]]; then start dgs_hand_driver hand_driver_node "${clock[@]}" "${hand[@]}"; fi
start dgs_grasp_planner grasp_planner_node "${clock[@]}"
if [[ $mode != replay ]]; then
  start dgs_arm_executor arm_executor_node "${clock[@]}"
  start dgs_bringup clear_table "${clock[@]}"
fi

if [[ -n $view ]]; then
  simulated=$([[ $mode == simulation ]] && echo true || echo false)
  launch dgs_viewer viewer_node "simulated:=$simulated" "${clock[@]}"
  view_pid=$!
  extras+=("$view_pid")
  if [[ $mode != robot ]]; then  # whose driver has a robot_state_publisher
    launch dgs_bringup robot_state "${clock[@]}"
    extras+=($!)
  fi
fi

setsid python3 -m dgs_bringup.wait_ready --mode "$mode" --timeout "$timeout" >"$log/wait_ready.log" 2>&1 &
waiting=$!
while kill -0 "$waiting" 2>/dev/null; do
  if report_dead; then
    kill -KILL -- "-$waiting" 2>/dev/null || true
    { wait "$waiting" || true; } 2>/dev/null
    exit 3
  fi
  sleep 0.1
done
if ! wait "$waiting"; then
  cat "$log/wait_ready.log" >&2
  exit 4
fi
waiting=''
grep '^ready, but' "$log/wait_ready.log" || true
echo "all nodes are ready; their logs are in $log"
if [[ -n $view_pid ]]; then
  for ((step = 0; step < 300; step++)); do
    if grep -o 'live page: .*' "$log/viewer_node.log"; then break; fi
    if ! alive "$view_pid"; then
      echo "start_suite.sh: no live page; the end of $log/viewer_node.log:" >&2
      tail -n 3 "$log/viewer_node.log" >&2
      break
    fi
    sleep 0.1
  done
fi

if [[ ${#command[@]} -gt 0 ]]; then
  setsid "${command[@]}" &
  command_pid=$!
fi
while true; do
  if [[ -n $command_pid ]] && ! kill -0 "$command_pid" 2>/dev/null; then
    status=0
    wait "$command_pid" || status=$?
    exit "$status"
  fi
  if report_dead; then exit 3; fi
  sleep 0.2
done
