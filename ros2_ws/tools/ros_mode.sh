# Sourced by setup_env.sh and build.sh: sets dgs_ros_mode to `installed` (a ROS 2 Jazzy is on this machine) or `wheels`
# (ROS comes from the Python packages in .venv), and dgs_ros_setup to the installed ROS's setup file, if one must be sourced.
# DGS_ROS=wheels or DGS_ROS=installed decides it by hand; DGS_ROS_SETUP names a setup file elsewhere.
dgs_ros_setup=${DGS_ROS_SETUP:-/opt/ros/jazzy/setup.bash}
if [[ -n ${DGS_ROS-} ]]; then
  dgs_ros_mode=$DGS_ROS
elif [[ ${ROS_DISTRO-} == jazzy || -f $dgs_ros_setup ]]; then
  dgs_ros_mode=installed
else
  dgs_ros_mode=wheels
fi
# An image of ROS may set ROS_DISTRO and yet have sourced nothing.
if [[ $dgs_ros_mode == wheels || (${ROS_DISTRO-} == jazzy && -n ${AMENT_PREFIX_PATH-}) ]]; then
  dgs_ros_setup=""
fi
