# The environment of the suite: source ros2_ws/setup_env.sh   (bash, from any folder, as often as you like)
#
# Without an installed ROS 2 it takes ROS from the virtual environment .venv; with one, from /opt/ros/jazzy (.venv, if
# there is one, comes on top for the packages that ROS does not have). See tools/ros_mode.sh for how to decide by hand.

if [ -z "${BASH_VERSION-}" ]; then
  echo "setup_env.sh needs bash" >&2
  return 1
fi

# _dgs_prepend VARIABLE FOLDER: put the folder first unless it is in the list already
_dgs_prepend() {
  case ":${!1-}:" in
    *":$2:"*) ;;
    *) export "$1=$2${!1:+:${!1}}" ;;
  esac
}

_dgs_setup_env() {
  local workspace repo venv site dgs_ros_mode dgs_ros_setup folder shared_memory
  workspace=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd -P) || return 1
  repo=$(dirname "$workspace")
  venv=${DGS_VENV:-$repo/.venv}
  source "$workspace/tools/ros_mode.sh"
  # Where ROS_DISTRO alone is set, AMENT_PREFIX_PATH is empty, or holds what this script has put there.
  if [[ $dgs_ros_mode == wheels && ${ROS_DISTRO:-jazzy} != jazzy && ":${AMENT_PREFIX_PATH:-$venv}:" != *":$venv:"* ]]; then
    echo "setup_env.sh: ROS 2 $ROS_DISTRO is sourced in this shell and would be taken for Jazzy; use a shell without it" \
      "(is it sourced in ~/.bashrc?)" >&2
    return 1
  fi
  if [[ -n $dgs_ros_setup ]]; then source "$dgs_ros_setup" || return 1; fi

  if [[ -x $venv/bin/python ]]; then
    export VIRTUAL_ENV=$venv
    _dgs_prepend PATH "$venv/bin"
  elif [[ $dgs_ros_mode == wheels ]]; then
    echo "setup_env.sh: neither ROS 2 Jazzy nor $venv is here; run 'make setup' in $repo" >&2
    return 1
  fi
  if [[ $dgs_ros_mode == wheels ]]; then
    _dgs_prepend AMENT_PREFIX_PATH "$venv"
    site=$("$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    for folder in "$venv/lib" "$site"/ros_*.libs; do
      if [[ -d $folder ]]; then _dgs_prepend LD_LIBRARY_PATH "$folder"; fi
    done
    export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1  # or each python would start twice to find the libraries
  fi

  for folder in "$workspace/underlay_install" "$workspace/install"; do
    if [[ -f $folder/local_setup.bash ]]; then source "$folder/local_setup.bash"; fi
  done
  if [[ ! -f $workspace/install/local_setup.bash ]]; then
    echo "setup_env.sh: the workspace has not been built yet; run 'make setup' in $repo" >&2
  fi
  type -P ros2 >/dev/null || export PATH="$PATH:$workspace/shim"

  export RMW_IMPLEMENTATION=${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp}
  export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
  export FASTRTPS_DEFAULT_PROFILES_FILE=${FASTRTPS_DEFAULT_PROFILES_FILE:-$workspace/src/dgs_bringup/config/fastdds.xml}
  shared_memory=$(df --block-size=1M --output=size /dev/shm 2>/dev/null | tail -n 1)
  if [[ -n $shared_memory && $shared_memory -lt 700 ]]; then
    echo "setup_env.sh: /dev/shm has only $((shared_memory)) MiB, so large clouds go over UDP and some get lost;" \
      "a container wants --shm-size=1g" >&2
  fi

  # A list of the wrong length in a field of fixed size would otherwise be sent as whatever lies in memory behind it.
  export ROS_PYTHON_CHECK_FIELDS=${ROS_PYTHON_CHECK_FIELDS:-1}
  # Threads of torch that wait by spinning slow every other process on few cores down.
  export OMP_WAIT_POLICY=${OMP_WAIT_POLICY:-PASSIVE}
  # numpy would take a second thread for products of 3 x 3: a planner's call took 1.2 to 1.3 times as long.
  export OPENBLAS_NUM_THREADS=${OPENBLAS_NUM_THREADS:-1}
}

# The setup files of ROS read unset variables and failing commands, so the caller's strict modes pause meanwhile.
_dgs_modes=$-
set +eu
_dgs_setup_env
_dgs_status=$?
case $_dgs_modes in *e*) set -e ;; esac
case $_dgs_modes in *u*) set -u ;; esac
unset -f _dgs_prepend _dgs_setup_env
unset _dgs_modes
return "$_dgs_status"
