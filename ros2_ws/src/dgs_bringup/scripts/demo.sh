#!/usr/bin/env bash
# Clear a table in the headless simulation and write a run folder.
#   demo.sh [--seed 0] [--objects 5] [--out FOLDER] [--catalogue novel] [--max-attempts N] [--time-limit 270] [--no-bag]
#           [--params FILE] [--timeout 120] [--view]
# SEED, OBJECTS, OUT and VIEW may be variables, too. With the live page (--view) the suite stays when the table is clear,
# until Ctrl-C.
# Exit code: 0 carried through, 1 planner, arm, hand or camera failed, 2 an option is wrong, 3 a node died, 4 not all nodes
# were ready in time, 5 the demo gave up
set -euo pipefail
here=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd -P)
repo=$(cd "$here/../../../.." && pwd -P)

seed=${SEED:-0} objects=${OBJECTS:-5} out=${OUT:-}
view=${VIEW:-} suite=() rest=()
while [[ $# -gt 0 ]]; do
  if [[ $1 =~ ^(--[a-z-]+)=(.*)$ ]]; then set -- "${BASH_REMATCH[1]}" "${BASH_REMATCH[2]}" "${@:2}"; fi
  if [[ $1 =~ ^--(seed|objects|out|params|timeout)$ && $# -lt 2 ]]; then echo "demo.sh: $1 needs a value" >&2; exit 2; fi
  case $1 in
    --seed) seed=$2; shift 2 ;;
    --objects) objects=$2; shift 2 ;;
    --out) out=$2; shift 2 ;;
    --params) suite+=(--params "$2"); shift 2 ;;
    --timeout) suite+=(--timeout "$2"); shift 2 ;;
    --view) view=yes; shift ;;
    -h | --help) sed -n '2,8s/^# //p' "$0"; exit 0 ;;
    *) rest+=("$1"); shift ;;
  esac
done
if [[ -n $view ]]; then suite+=(--view) rest=(--stay "${rest[@]}"); fi
if [[ -f $repo/ros2_ws/setup_env.sh ]]; then source "$repo/ros2_ws/setup_env.sh"; fi
if [[ -z $out ]]; then out=$repo/runs/$(date +%Y%m%d_%H%M%S)_seed$seed; fi
out=$(realpath -m "$out")
rest=(--seed "$seed" --objects "$objects" --out "$out" "${rest[@]}")
python3 -m dgs_bringup.demo --check "${rest[@]}"

# A domain of its own, so that two demos, or a demo and the tests, do not hear each other; the lock ends with this process.
if [[ -z ${ROS_DOMAIN_ID-} ]]; then
  locks=${TMPDIR:-/tmp}/dgs_ros_domains_$(id -u)
  mkdir -p "$locks"
  for ((step = 0; step < 100; step++)); do
    id=$(((step + $$) % 100 + 1))
    # Another suite is there: it has bound one of the domain's ports.
    first=$((7400 + 250 * id))
    if grep -qE ":($(printf '%04X|' $(seq $first $((first + 249))))-) " /proc/net/udp; then continue; fi
    exec {lock}>"$locks/$id.lock"
    if flock --nonblock "$lock"; then
      export ROS_DOMAIN_ID=$id
      break
    fi
    exec {lock}>&-
  done
  : "${ROS_DOMAIN_ID:?all ROS domain ids of 1 to 100 are in use}"
fi

echo "run folder: $out (ROS_DOMAIN_ID=$ROS_DOMAIN_ID)"
exec bash "$here/start_suite.sh" --mode simulation --log "$out/logs" "${suite[@]}" -- \
  python3 -m dgs_bringup.demo "${rest[@]}"
