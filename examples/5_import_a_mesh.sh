#!/usr/bin/env bash
# 5. Bring a mesh of your own onto the simulated table. Meshes are in metres unless --scale says otherwise.
#    bash examples/5_import_a_mesh.sh [MESH] [OUT]       then: make demo ARGS="--catalogue OUT"
set -euo pipefail
repo=$(realpath "$(dirname "${BASH_SOURCE[0]}")/..")
source "$repo/ros2_ws/setup_env.sh"
out=$(realpath -m "${2:-$repo/data/my_objects}")
mesh=${1:-$out.ply}
if [[ -z ${1-} ]]; then
  mkdir -p "$(dirname "$mesh")"
  python -c "import sys, trimesh; trimesh.creation.annulus(0.02, 0.035, 0.08).export(sys.argv[1])" "$mesh"
fi
dgs import "$mesh" --out "$out"
echo "now: bash $repo/ros2_ws/src/dgs_bringup/scripts/demo.sh --catalogue $out --objects 1"
