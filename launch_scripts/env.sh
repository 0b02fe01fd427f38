# To be sourced: the venv, the built workspace and the settings every Megrasp process needs.
#
#   . launch_scripts/env.sh
#
# For bash and zsh from anywhere; for other POSIX shells from the root of the repository, or with MEGRASP_ROOT
# set to it. Variables that are set already are kept: ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE,
# FASTRTPS_DEFAULT_PROFILES_FILE. MEGRASP_VENV names another venv than .venv, as for setup.sh.

# In quotes: other shells would stumble over what they do not know.
_megrasp_shell=sh
if [ -n "${BASH_VERSION:-}" ]; then
  _megrasp_shell=bash
  eval '_megrasp_root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"'
elif [ -n "${ZSH_VERSION:-}" ]; then
  _megrasp_shell=zsh
  eval '_megrasp_root="$(cd "$(dirname "${(%):-%x}")/.." && pwd)"'
else
  _megrasp_root="${MEGRASP_ROOT:-$PWD}"
fi
if [ ! -f "$_megrasp_root/launch_scripts/env.sh" ]; then
  echo "env.sh: this shell does not say where a sourced file lies, and $_megrasp_root is not the root of Megrasp;" \
    "source it from there, set MEGRASP_ROOT, or use bash" >&2
  unset _megrasp_shell _megrasp_root
  return 1
fi

# The set-up files of colcon and ROS read unset variables and return non-zero in places.
_megrasp_options="$(set +o | grep -E 'nounset|errexit')"
set +eu

if [ -f "/opt/ros/jazzy/setup.$_megrasp_shell" ]; then
  . "/opt/ros/jazzy/setup.$_megrasp_shell"
fi
_megrasp_venv="${MEGRASP_VENV:-$_megrasp_root/.venv}"
if [ -f "$_megrasp_venv/bin/activate" ]; then
  . "$_megrasp_venv/bin/activate"
fi
if [ -f "$_megrasp_root/ros2_ws/install/local_setup.$_megrasp_shell" ]; then
  # local_setup.sh is the one that cannot find its own place.
  COLCON_CURRENT_PREFIX="$_megrasp_root/ros2_ws/install"
  . "$_megrasp_root/ros2_ws/install/local_setup.$_megrasp_shell"
  unset COLCON_CURRENT_PREFIX
fi
# Where there is no `ros2 run`: megrasp_call and the nodes by their names.
_megrasp_nodes="$_megrasp_root/ros2_ws/install/megrasp_ros/lib/megrasp_ros"
if [ -d "$_megrasp_nodes" ]; then
  case ":$PATH:" in
    *":$_megrasp_nodes:"*) ;;
    *) export PATH="$PATH:$_megrasp_nodes" ;;
  esac
fi

if [ -z "${FASTRTPS_DEFAULT_PROFILES_FILE:-}" ]; then
  # The one that fits shared memory and UDP buffers here; before the workspace is built, the one that fits most.
  FASTRTPS_DEFAULT_PROFILES_FILE="$(python -m megrasp_ros.fast_dds "$_megrasp_root/launch_scripts/config" \
    2>/dev/null || echo "$_megrasp_root/launch_scripts/config/fastdds_small_buffers.xml")"
  export FASTRTPS_DEFAULT_PROFILES_FILE
fi
if [ -z "${ROS_AUTOMATIC_DISCOVERY_RANGE:-}" ]; then
  export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
  # Once a shell; scripts that read what is printed read standard output.
  echo "env.sh: ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, nodes of other machines are not seen; set SUBNET for them" >&2
fi

eval "$_megrasp_options"
unset _megrasp_root _megrasp_venv _megrasp_nodes _megrasp_shell _megrasp_options
