# To be sourced (bash): the venv, the built workspace and the settings every Megrasp process needs.
#
#   . launch_scripts/env.sh
#
# Variables that are set already are kept: ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE,
# FASTRTPS_DEFAULT_PROFILES_FILE.

_megrasp_root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
# The set-up files of colcon and ROS read unset variables and return non-zero in places.
_megrasp_options="$(set +o | grep -E 'nounset|errexit')"
set +eu

if [ -f /opt/ros/jazzy/setup.bash ]; then
  . /opt/ros/jazzy/setup.bash
fi
if [ -f "$_megrasp_root/.venv/bin/activate" ]; then
  . "$_megrasp_root/.venv/bin/activate"
fi
if [ -f "$_megrasp_root/ros2_ws/install/local_setup.bash" ]; then
  . "$_megrasp_root/ros2_ws/install/local_setup.bash"
fi

# Asking Fast DDS for larger UDP buffers than the kernel grants stops its discovery.
_megrasp_profile=fastdds.xml
for _megrasp_limit in /proc/sys/net/core/rmem_max /proc/sys/net/core/wmem_max; do
  if [ -r "$_megrasp_limit" ] && [ "$(cat "$_megrasp_limit")" -lt 4194304 ]; then
    _megrasp_profile=fastdds_small_buffers.xml
  fi
done
export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$_megrasp_root/launch_scripts/config/$_megrasp_profile}"
if [ -z "${ROS_AUTOMATIC_DISCOVERY_RANGE:-}" ]; then
  export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
  # Once a shell, and only to people: scripts read what is printed.
  if [ -t 2 ]; then
    echo "env.sh: ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, nodes of other machines are not seen; set SUBNET for them" >&2
  fi
fi

eval "$_megrasp_options"
unset _megrasp_root _megrasp_options _megrasp_profile _megrasp_limit
