#!/usr/bin/env bash
# Build the workspace: underlay (only what is missing), then every package. Usage: ros2_ws/build.sh [colcon build arguments]
# A plain `colcon build` would take the system's Python, which lacks torch, pybullet, pin, ..., and leave out the underlay.
set -euo pipefail
unset MAKEFLAGS  # of a make that called this: colcon's own share no jobs with it
workspace=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P)
repo=$(dirname "$workspace")
venv=${DGS_VENV:-$repo/.venv}

# An environment in which an older build is sourced would make colcon see the packages as their own underlay.
source "$workspace/tools/ros_mode.sh"
if [[ -n $dgs_ros_setup ]]; then
  set +u
  source "$dgs_ros_setup"
  set -u
fi
if [[ -x $venv/bin/python ]]; then
  PATH=$venv/bin:$PATH
fi
python=$(type -P python3)
colcon=$(type -P colcon) || {
  echo "colcon is missing: run 'make setup' in $repo, or: sudo apt install python3-colcon-common-extensions" >&2
  exit 1
}

cmake_args=("-DPython3_EXECUTABLE=$python" -DBUILD_TESTING=OFF --no-warn-unused-cli)
if [[ $dgs_ros_mode == wheels ]]; then
  export AMENT_PREFIX_PATH=$venv CMAKE_PREFIX_PATH=$venv
  unset PYTHONPATH
  for shell in sh bash zsh; do  # colcon expects these in every prefix; there is nothing to set up here
    if [[ ! -e $venv/local_setup.$shell ]]; then touch "$venv/local_setup.$shell"; fi
  done
  cmake_args+=("-DCMAKE_PROJECT_INCLUDE=$workspace/cmake/fix_imported_includes.cmake")
fi

# colcon FOLDER-PREFIX ARGUMENTS...: build with the interpreter that the nodes are to run with
colcon_build() {
  "$python" "$colcon" --log-base "$workspace/log" build --build-base "$workspace/$1build" \
    --install-base "$workspace/$1install" "${@:2}" --cmake-args "${cmake_args[@]}"
}

# found PACKAGE: is it in a prefix other than the suite's own underlay?
found() {
  local prefix
  local -a prefixes
  IFS=: read -r -a prefixes <<<"${AMENT_PREFIX_PATH-}"
  for prefix in "${prefixes[@]}"; do
    if [[ $prefix != "$workspace"/* && -f $prefix/share/$1/package.xml ]]; then return 0; fi
  done
  return 1
}

missing=()
for folder in "$workspace"/underlay/*/; do
  name=$(basename "$folder")
  if ! found "$name"; then
    missing+=("${folder%/}")
  elif [[ -d $workspace/underlay_install/$name ]]; then  # the real one came later, and must not lie behind this one
    rm -rf "$workspace/underlay_install" "$workspace/underlay_build"
  fi
done
if [[ ${#missing[@]} -gt 0 ]]; then
  colcon_build underlay_ --base-paths "${missing[@]}"
  set +u
  source "$workspace/underlay_install/local_setup.bash"
  set -u
fi
cd "$workspace"
colcon_build "" --base-paths "$workspace/src" --symlink-install "$@"
touch "$workspace/install/.built"
